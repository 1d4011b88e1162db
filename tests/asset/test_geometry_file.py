"""The geometry in a file: it comes back as it was, and nothing damaged gets in."""

import json
import struct
import zlib
from dataclasses import replace

import numpy as np
import pytest
import safetensors.numpy

from lumitree.asset.asset import light_field_asset
from lumitree.asset.file import _digest, load, save
from lumitree.asset.geometry import AssetGeometry
from lumitree.asset.geometry_bytes import geometry_tensors
from lumitree.asset.materials import check_material
from lumitree.asset.measured import CONDUCTORS, INDICES
from lumitree.core.frames import LocalFrame
from lumitree.errors import LumitreeError
from support.damage import refused
from support.fields import random_asset
from support.geometry_assets import small_geometry, with_geometry
from support.light_fields import random_light_field, with_inside
from support.stored_arrays import change_geometry_arrays

ROUNDS = 300
WORDS = (
    *(
        "-1",
        "0",
        "1e300",
        "NaN",
        "1e999",
        "true",
        "null",
        "[]",
        "{}",
        '"x"',
        "99999999999999999999",
    ),
    *('"../../etc/passwd"', '"/dev/zero"', '"mesh"', '"hair"', '"dielectric"', "[1,2,3]", "[[]]"),
    *("[" * 5000, '"\\u001b[2J"', '"ggx"', "0.5", "1000000"),
)


def equal(first, second):
    assert first.shapes == second.shapes
    assert first.materials == second.materials
    arrays = [*first.arrays.values(), *first.images]
    others = [*second.arrays.values(), *second.images]
    for one, other in zip(arrays, others, strict=True):
        assert one.dtype == other.dtype
        assert np.array_equal(one, other)


def rewrite(source, path, change, change_header=str):
    """Change the tensors and the description of a file, with a checksum that is right."""
    content = source.read_bytes()
    header = json.loads(content[8 : 8 + struct.unpack("<Q", content[:8])[0]])
    text = change_header(header["__metadata__"]["lumitree"].partition(" ")[2])
    tensors = dict(safetensors.numpy.load(content))
    change(tensors)
    metadata = {"lumitree": f"{_digest(text, tensors)} {text}"}
    path.write_bytes(safetensors.numpy.save(tensors, metadata))


def change_text(tensors, change):
    description = json.loads(tensors["geometry.shapes"].tobytes())
    change(description)
    tensors["geometry.shapes"] = np.frombuffer(json.dumps(description).encode(), np.uint8)


@pytest.fixture(scope="module")
def original(tmp_path_factory):
    path = tmp_path_factory.mktemp("geometry") / "lamp.lumitree"
    save(with_geometry(small_geometry()), path)
    return path


def test_it_comes_back_byte_for_byte(original, tmp_path):
    found = load(original)
    equal(found.geometry, small_geometry())
    save(found, tmp_path / "again.lumitree")
    assert (tmp_path / "again.lumitree").read_bytes() == original.read_bytes()


def test_parts_in_all_combinations(tmp_path):
    field = random_asset(0, tree_depth=3, l_max=1)
    light, geometry = random_light_field(0), small_geometry()
    cases = {
        ("field",): field,
        ("light",): light_field_asset(light, field.frame, "test"),
        ("light", "field"): replace(field, light_field=light),
        ("field", "geometry"): replace(field, geometry=geometry),
        ("light", "geometry"): with_geometry(geometry),
        ("light", "field", "geometry"): replace(field, light_field=light, geometry=geometry),
    }
    for parts, asset in cases.items():
        path = tmp_path / f"{'-'.join(parts)}.lumitree"
        save(asset, path)
        found = load(path)
        assert found.parts == found.info.parts == parts
        assert found.info.geometry_triangles == (8 if "geometry" in parts else 0)
        assert found.num_bytes == asset.num_bytes


def test_geometry_without_images(tmp_path):
    plain = {"type": "diffuse", "reflectance": 0.5}
    geometry = small_geometry(images=(), materials=(plain, *small_geometry().materials[1:]))
    path = tmp_path / "plain.lumitree"
    save(with_geometry(geometry), path)
    equal(load(path).geometry, geometry)


def test_media_that_absorb(tmp_path):
    shapes = [dict(shape) for shape in small_geometry().shapes]
    shapes[1]["exterior"], shapes[2]["interior"] = [0.0, 1, 2], [0.5, 0.25, 1e6]
    geometry = small_geometry(shapes=tuple(shapes))
    path = tmp_path / "media.lumitree"
    save(with_geometry(geometry), path)
    assert geometry.has_media
    equal(load(path).geometry, geometry)


MILK = {"absorption": [0.0, 1, 2], "scattering": [4.0, 0, 1e3], "anisotropy": -0.25}


@pytest.mark.parametrize("inside", [False, True])
def test_media_that_scatter(tmp_path, inside):
    """With light inside the box and without it."""
    shapes = [dict(shape) for shape in small_geometry().shapes]
    shapes[1]["exterior"], shapes[2]["interior"] = [0.0, 1, 2], MILK
    asset = with_geometry(small_geometry(shapes=tuple(shapes)))
    if inside:
        asset = replace(asset, light_field=with_inside(0, asset.light_field))
    path = tmp_path / "milk.lumitree"
    save(asset, path)
    assert asset.geometry.has_media
    equal(load(path).geometry, asset.geometry)
    assert (load(path).light_field.inside is not None) == inside


def test_smooth_images_are_compressed():
    y, x = np.mgrid[:64, :64]
    image = np.stack([2 * x + y, 255 - x, y], axis=-1).astype(np.uint8)
    geometry = replace(small_geometry(), images=(image,) * len(small_geometry().images))
    assert (
        len(geometry_tensors(geometry)["geometry.images"])
        < sum(i.nbytes for i in geometry.images) / 5
    )


@pytest.mark.parametrize(
    "images", [b"", b"no stream", zlib.compress(bytes(10)), zlib.compress(bytes(1 << 24))]
)
def test_wrong_streams_of_images_are_refused(original, tmp_path, images):
    def change(tensors):
        tensors["geometry.images"] = np.frombuffer(images, np.uint8)

    path = tmp_path / "bad.lumitree"
    rewrite(original, path, change)
    with pytest.raises(LumitreeError, match="images of the geometry"):
        load(path)


def test_geometry_that_could_not_be_read_again_is_not_made(monkeypatch):
    monkeypatch.setattr("lumitree.asset.geometry.MAX_IMAGE_BYTES", 40)
    with pytest.raises(LumitreeError, match="images of 42 bytes, at most 40"):
        small_geometry()


def test_geometry_alone_illuminates_nothing_and_is_refused():
    with pytest.raises(LumitreeError, match="geometry without anything that illuminates"):
        replace(with_geometry(small_geometry()), light_field=None)


def test_geometry_outside_the_box_is_refused():
    frame = LocalFrame(np.array([1.0, 0.3, 1.0]), np.eye(4))
    with pytest.raises(LumitreeError, match="outside the box"):
        with_geometry(small_geometry(), frame)
    far = [*small_geometry().shapes]
    far[2] = {**far[2], "to_world": (np.eye(4) * [1, 1, 1, 1] + np.eye(4, k=3)).tolist()}
    with pytest.raises(LumitreeError, match="outside the box"):
        with_geometry(small_geometry(shapes=tuple(far)))


def test_the_names_of_conductors_are_mitsubas(mi):
    from pathlib import Path

    folder = Path(mi.__file__).parent / "data" / "ior"
    found = {path.name.removesuffix(".eta.spd") for path in folder.glob("*.eta.spd")}
    assert (found | {"none"}) - CONDUCTORS == {"AlSb", "AlSb_palik"}
    assert found | {"none"} > CONDUCTORS


def test_the_indices_of_refraction_are_mitsubas(mi):
    for name, index in INDICES.items():
        made = mi.load_dict({"type": "dielectric", "int_ior": name, "ext_ior": 1.0})
        assert np.ravel(mi.traverse(made)["eta"])[0] == np.float32(index)


BROKEN = {
    "no shapes": (lambda d: d.update(shapes=[]), "0 shapes"),
    "an unknown key": (lambda d: d.update(scripts=[]), 'unknown key "scripts"'),
    "an unknown shape": (lambda d: d["shapes"][0].update(type="obj"), "type of a shape"),
    "a file": (lambda d: d["shapes"][0].update(filename="a.ply"), 'unknown key "filename"'),
    "an unknown plugin": (lambda d: d["materials"][1].update(type="hair"), "type of a material"),
    "a file of a plugin": (lambda d: d["materials"][1].update(filename="x"), "'filename' that is"),
    "a path as a conductor": (
        lambda d: d["materials"][1].update(material="../../../x"),
        "material of roughconductor is ../../../x; expected a name such as",
    ),
    "a rough number": (
        lambda d: d["materials"][1].update(alpha=-1),
        "alpha of roughconductor is -1",
    ),
    "an index": (lambda d: d["materials"][2].update(int_ior=0), "int_ior of dielectric is 0"),
    "a colour": (
        lambda d: d["materials"][0]["nested"][0]["nested"][0].update(reflectance=[1, 2, 0]),
        "reflectance of diffuse",
    ),
    "an image that is not there": (
        lambda d: d["materials"][0]["opacity"].update(image=2),
        "a texture has no image 2",
    ),
    "a count": (lambda d: d["shapes"][0].update(vertices=5), "vertices is float32"),
    "a negative count": (lambda d: d["shapes"][0].update(vertices=-4), "has -4 vertices"),
    "a flag": (
        lambda d: d["shapes"][0].update(normals=1),
        "normals of a mesh is not true or false",
    ),
    "radiance": (lambda d: d["shapes"][1].update(radiance=[1, 2, -3]), "radiance is"),
    "a material": (
        lambda d: d["shapes"][1].update(material=3),
        "shape 1: it has the material 3",
    ),
    "colours": (
        lambda d: d["materials"][1].update(specular_reflectance={"attribute": "vertex_color"}),
        "shape 1: it has no colours of vertices",
    ),
    "absorption": (
        lambda d: d["shapes"][2].update(interior=[1, -1, 0]),
        r"interior of a sphere is \[1.0, -1.0, 0.0\], expected 0 to 1e",
    ),
    "a medium": (lambda d: d["shapes"][0].update(exterior={"albedo": 1}), 'lacks "absorption"'),
    "scattering": (
        lambda d: d["shapes"][2].update(interior=MILK | {"scattering": [0, 0, 1e16]}),
        "scattering of the interior of a sphere is",
    ),
    "a number of scattering": (
        lambda d: d["shapes"][2].update(interior=MILK | {"scattering": [0, None, 1]}),
        "expected 3 numbers",
    ),
    "no scattering": (
        lambda d: d["shapes"][2].update(interior=MILK | {"scattering": [0, 0, 0]}),
        "the interior of a sphere scatters nothing; expected its absorption alone",
    ),
    "an anisotropy": (
        lambda d: d["shapes"][2].update(interior=MILK | {"anisotropy": 1}),
        r"anisotropy of the interior of a sphere is 1, expected -0.999 to 0.999",
    ),
    "a squeezed sphere": (
        lambda d: d["shapes"][2].update(to_world=np.diag([0.1, 0.2, 0.2, 1]).tolist()),
        "scaled non-uniformly",
    ),
    "a flat sphere": (
        lambda d: d["shapes"][2].update(to_world=np.diag([0.0, 0.0, 0.0, 1]).tolist()),
        "not affine",
    ),
    "an image's size": (lambda d: d["images"][0].update(shape=[1 << 40, 1, 1]), "has the shape"),
    "an image's bytes": (
        lambda d: d["images"][0].update(shape=[4, 4, 1]),
        "images of the geometry",
    ),
}


@pytest.mark.parametrize("name", BROKEN)
def test_broken_descriptions_are_refused(original, tmp_path, name):
    change, message = BROKEN[name]
    rewrite(original, tmp_path / "bad.lumitree", lambda t: change_text(t, change))
    with pytest.raises(LumitreeError, match=message) as caught:
        load(tmp_path / "bad.lumitree")
    assert str(caught.value).isprintable()


def set_to(name, index, value):
    def change(arrays):
        arrays[name][index] = value

    return lambda tensors: change_geometry_arrays(tensors, change)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (set_to("faces", (0, 0), 4), "a face has an unknown vertex"),
        (set_to("vertices", (0, 0), np.nan), "vertices hold NaN"),
        (set_to("vertices", (0, 0), 1.2), "outside the box"),
        (set_to("normals", (0, 0), np.inf), "normals hold NaN"),
        (
            set_to("texcoords", (0, 1), 1e12),
            r"shape 0: texture coordinates reach 3e\+12 pixels .* expected at most 1073741824",
        ),
        (lambda t: t.pop("geometry.stream"), "lacks"),
        (lambda t: t.update({"geometry.stream": np.zeros(2, np.uint8)}), "cannot be decompressed"),
        (lambda t: t.pop("geometry.shapes"), "unknown key"),
    ],
)
def test_broken_tensors_are_refused(original, tmp_path, change, message):
    rewrite(original, tmp_path / "bad.lumitree", change)
    with pytest.raises(LumitreeError, match=message):
        load(tmp_path / "bad.lumitree")


def test_mutated_geometries_load_soundly_or_are_refused_in_a_line(original, tmp_path):
    random = np.random.default_rng(4)
    path, refusals = tmp_path / "bad.lumitree", 0
    source = dict(safetensors.numpy.load(original.read_bytes()))
    text = source["geometry.shapes"].tobytes().decode()
    starts = [i for i, char in enumerate(text) if char in ":,["]
    for _ in range(ROUNDS):

        def mutate(tensors):
            name = random.choice([n for n in tensors if n.startswith("geometry.")])
            if random.random() < 0.7 or not tensors[name].size:
                at = int(random.choice(starts)) + 1
                end = at + min(text[at:].find(char) % (1 << 30) for char in ",]}")
                word = WORDS[random.integers(len(WORDS))]
                changed = (text[:at] + word + text[end:]).encode()
                tensors["geometry.shapes"] = np.frombuffer(changed, np.uint8)
            else:
                data = bytearray(tensors[name].tobytes())
                data[random.integers(len(data))] ^= 1 << random.integers(8)
                kind = tensors[name].dtype
                tensors[name] = np.frombuffer(bytes(data), kind).reshape(tensors[name].shape)

        rewrite(original, path, mutate)
        if refused(lambda: load(path)):
            refusals += 1
        else:
            # What is accepted can be made again.
            geometry = load(path).geometry
            equal(
                AssetGeometry(**{name: getattr(geometry, name) for name in vars(geometry)}),
                geometry,
            )
    assert refusals > ROUNDS / 3


def float_image(value):
    """Geometry whose float image, the opacity of material 0, holds a value."""
    image = np.full((2, 3, 1), 0.5, np.float32)
    image[1, 1] = value
    return small_geometry(images=(image, small_geometry().images[1]))


def coloured(value):
    """Geometry whose shape 0 reflects the colours of its vertices, one of which is a value."""
    colours = small_geometry().colours.copy()
    colours[2, 1] = value
    reflects = {"type": "diffuse", "reflectance": {"attribute": "vertex_color"}}
    return small_geometry(colours=colours, materials=(reflects, *small_geometry().materials[1:]))


@pytest.mark.parametrize("value", [-1e-3, 1.01, 1e12])
def test_values_of_images_and_of_vertices_have_the_range_of_their_parameter(value):
    with pytest.raises(
        LumitreeError,
        match=r"material 0 \(mask, of shape 0\): opacity of mask: an image of values from",
    ):
        float_image(value)
    with pytest.raises(LumitreeError, match=r"shape 0: its colours of vertices are .* 0 to 1"):
        coloured(value)
    # Rounding to 16 bits is not refused, and colours that no material uses are not looked at.
    assert float_image(1.0005).images
    assert coloured(1.0005).materials
    assert small_geometry(colours=np.full((4, 3), value, np.float32)).num_triangles == 8


def test_radiance_is_no_colour_of_vertices_and_not_negative():
    """Mitsuba cannot sample an emitter by the colours of its vertices."""
    shapes = list(small_geometry().shapes)
    texture = small_geometry().materials[0]["opacity"]
    for radiance, found in (
        ({"attribute": "vertex_color"}, "radiance: the colours of the vertices"),
        (texture, "radiance: an image of values from -2 to"),
    ):
        changed = ({**shapes[0], "radiance": radiance}, *shapes[1:])
        image = np.array([[[-2], [1], [0]]] * 2, np.float32)
        plain = ({"type": "diffuse"}, *small_geometry().materials[1:])
        with pytest.raises(LumitreeError, match=f"shape 0: {found}"):
            small_geometry(shapes=changed, materials=plain, images=(image, image))


def test_deep_materials_are_refused():
    material = {"type": "diffuse"}
    for _ in range(8):
        material = {"type": "twosided", "nested": [material]}
    with pytest.raises(LumitreeError, match="nested more than 8 deep"):
        check_material(material, [])
