"""The geometry in a file: it comes back as it was, and nothing damaged gets in."""

import json
import struct
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import safetensors.numpy

from lumitree.asset.asset import light_field_asset
from lumitree.asset.file import _digest, load, save
from lumitree.asset.geometry import Medium
from lumitree.asset.geometry_file import geometry_tensors
from lumitree.asset.materials import (
    CONDUCTORS,
    INDICES,
    Diffuse,
    TwoSided,
    VertexColours,
    check_material,
)
from lumitree.core.frames import LocalFrame, rows_of
from lumitree.errors import LumitreeError
from support.fields import random_asset
from support.geometry_assets import TEXTURE, small_geometry, with_geometry
from support.light_fields import random_light_field, with_inside
from support.stored_arrays import change_geometry_arrays


def equal(first, second):
    assert first.shapes == second.shapes
    assert first.materials == second.materials
    arrays = [*first.arrays.values(), *first.images]
    others = [*second.arrays.values(), *second.images]
    for one, other in zip(arrays, others, strict=True):
        assert one.dtype == other.dtype
        assert np.array_equal(one, other)


def rewrite(source, path, change):
    """Change the tensors of a file, with a checksum that is right."""
    content = source.read_bytes()
    header = json.loads(content[8 : 8 + struct.unpack("<Q", content[:8])[0]])
    text = header["__metadata__"]["lumitree"].partition(" ")[2]
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


def with_media(inside):
    first, second, third = small_geometry().shapes
    second = replace(second, exterior=Medium((0.0, 1.0, 2.0)))
    return small_geometry(shapes=(first, second, replace(third, interior=inside)))


@pytest.mark.parametrize(
    "geometry",
    [
        small_geometry(images=(), materials=(Diffuse(), *small_geometry().materials[1:])),
        with_media(Medium((0.5, 0.25, 1e6))),
        with_media(Medium((0.0, 1.0, 2.0), (4.0, 0.0, 1e3), -0.25)),
    ],
    ids=["no images", "absorption", "scattering"],
)
@pytest.mark.parametrize("inside", [False, True], ids=["outside", "inside"])
def test_other_geometries_come_back(tmp_path, geometry, inside):
    """With light inside the box and without it."""
    asset = with_geometry(geometry)
    assert asset.light_field is not None
    if inside:
        asset = replace(asset, light_field=with_inside(0, asset.light_field))
    save(asset, tmp_path / "lamp.lumitree")
    found = load(tmp_path / "lamp.lumitree")
    equal(found.geometry, geometry)
    assert found.geometry is not None
    assert found.light_field is not None
    assert found.geometry.has_media == bool(geometry.images)
    assert (found.light_field.inside is not None) == inside


def test_smooth_images_are_compressed():
    y, x = np.mgrid[:64, :64]
    image = np.stack([2 * x + y, 255 - x, y], axis=-1).astype(np.uint8)
    geometry = replace(small_geometry(), images=(image,) * len(small_geometry().images))
    size = sum(each.nbytes for each in geometry.images)
    assert len(geometry_tensors(geometry)["geometry.images"]) < size / 5


def test_the_names_of_conductors_and_indices_are_mitsubas(mi):
    folder = Path(mi.__file__).parent / "data" / "ior"
    found = {path.name.removesuffix(".eta.spd") for path in folder.glob("*.eta.spd")}
    assert (found | {"none"}) - CONDUCTORS == {"AlSb", "AlSb_palik"}
    assert found | {"none"} > CONDUCTORS
    for name, index in INDICES.items():
        made = mi.load_dict({"type": "dielectric", "int_ior": name, "ext_ior": 1.0})
        assert np.ravel(mi.traverse(made)["eta"])[0] == np.float32(index)


MILK = {"absorption": [0.0, 1, 2], "scattering": [4.0, 0, 1e3], "anisotropy": -0.25}


def shape(index, **members):
    return lambda d: d["shapes"][index].update(members)


def material(index, **members):
    return lambda d: d["materials"][index].update(members)


def nested(**members):
    return lambda d: d["materials"][0]["nested"][0]["nested"][0].update(members)


# Changes of the description, and a word of the refusal.
BROKEN = {
    "no shapes": (lambda d: d.update(shapes=[]), "0 shapes"),
    "an unknown key": (lambda d: d.update(scripts=[]), "unknown key"),
    "an unknown shape": (shape(0, type="obj"), "shapes.0.type is"),
    "a file": (shape(0, filename="a.ply"), "unknown key"),
    "an unknown plugin": (material(1, type="hair"), "hair"),
    "a file of a plugin": (material(1, filename="x"), "filename"),
    "a path as a conductor": (material(1, material="../../../x"), "a name such as"),
    "a rough number": (material(1, alpha=-1), "alpha"),
    "no number": (material(1, alpha="x"), "alpha"),
    "an index": (material(2, int_ior=0), "int_ior"),
    "a colour": (nested(reflectance=[1, 2, 0]), "reflectance"),
    "two numbers": (nested(reflectance=[1, 0]), "reflectance"),
    "no image": (lambda d: d["materials"][0]["opacity"].update(image=2), "image 2 of 2"),
    "a filter": (lambda d: d["materials"][0]["opacity"].update(filter_type="x"), "filter_type"),
    "a map": (lambda d: d["materials"][0]["opacity"].update(to_uv=[1]), "to_uv"),
    "a count": (shape(0, vertices=5), "vertices"),
    "a negative count": (shape(0, vertices=-4), "-4 vertices"),
    "a flag": (shape(0, normals=1), "normals"),
    "radiance": (shape(1, radiance=[1, 2, -3]), "radiance"),
    "a name as radiance": (shape(1, radiance="sun"), "radiance"),
    "a material": (shape(1, material=3), "material 3"),
    "colours": (material(1, specular_reflectance={"attribute": "vertex_color"}), "colours"),
    "absorption": (shape(2, interior=[1, -1, 0]), "interior"),
    "a medium": (shape(0, exterior={"albedo": 1}), "absorption"),
    "scattering": (shape(2, interior=MILK | {"scattering": [0, 0, 1e16]}), "scattering"),
    "a number of it": (shape(2, interior=MILK | {"scattering": [0, None, 1]}), "3 numbers"),
    "no scattering": (shape(2, interior=MILK | {"scattering": [0, 0, 0]}), "scatters nothing"),
    "an anisotropy": (shape(2, interior=MILK | {"anisotropy": 1}), "anisotropy"),
    "a squeezed sphere": (
        shape(2, to_world=np.diag([0.1, 0.2, 0.2, 1]).tolist()),
        "non-uniformly",
    ),
    "a flat sphere": (shape(2, to_world=np.diag([0.0, 0.0, 0.0, 1]).tolist()), "not affine"),
    "an image's size": (lambda d: d["images"][0].update(shape=[1 << 40, 1, 1]), "shape"),
    "an image's bytes": (lambda d: d["images"][0].update(shape=[4, 4, 1]), "images"),
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


def set_bytes(name, content):
    return lambda tensors: tensors.update({name: np.frombuffer(content, np.uint8)})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (set_to("faces", (0, 0), 4), "unknown vertex"),
        (set_to("vertices", (0, 0), np.nan), "NaN"),
        (set_to("vertices", (0, 0), 1.2), "outside the box"),
        (set_to("normals", (0, 0), np.inf), "NaN"),
        (set_to("texcoords", (0, 1), 1e12), "shape 0: texture coordinates"),
        (lambda t: t.pop("geometry.stream"), "is missing"),
        (set_bytes("geometry.stream", b"ab"), "cannot be decompressed"),
        (lambda t: t.pop("geometry.shapes"), "no such tensor"),
        (set_bytes("geometry.images", b""), "images of the geometry"),
        (set_bytes("geometry.images", b"no stream"), "images of the geometry"),
        (set_bytes("geometry.images", zlib.compress(bytes(10))), "images of the geometry"),
        (set_bytes("geometry.images", zlib.compress(bytes(1 << 24))), "images of the geometry"),
    ],
)
def test_broken_tensors_are_refused(original, tmp_path, change, message):
    rewrite(original, tmp_path / "bad.lumitree", change)
    with pytest.raises(LumitreeError, match=message):
        load(tmp_path / "bad.lumitree")


def float_image(value):
    """Geometry whose float image, the opacity of material 0, has a value."""
    image = np.full((2, 3, 1), 0.5, np.float32)
    image[1, 1] = value
    return small_geometry(images=(image, small_geometry().images[1]))


def coloured(value):
    """Geometry whose shape 0 reflects the colours of its vertices, one of which is a value."""
    colours = small_geometry().colours.copy()
    colours[2, 1] = value
    reflects = Diffuse(reflectance=VertexColours())
    return small_geometry(colours=colours, materials=(reflects, *small_geometry().materials[1:]))


@pytest.mark.parametrize("value", [-1e-3, 1.01, 1e12])
def test_values_of_images_and_of_vertices_have_the_range_of_their_parameter(value):
    with pytest.raises(LumitreeError, match=r"material 0 \(mask, of shape 0\): opacity"):
        float_image(value)
    with pytest.raises(LumitreeError, match="shape 0: its colours of vertices"):
        coloured(value)
    # Rounding to 16 bits is not refused, and colours that no material uses are not looked at.
    assert float_image(1.0005).images
    assert coloured(1.0005).materials
    assert small_geometry(colours=np.full((4, 3), value, np.float32)).num_triangles == 8


@pytest.mark.parametrize("radiance", [VertexColours(), replace(TEXTURE, image=0)], ids=str)
def test_radiance_is_no_colour_of_vertices_and_not_negative(radiance):
    """Mitsuba cannot sample an emitter by the colours of its vertices."""
    first, *others = small_geometry().shapes
    image = np.array([[[-2], [1], [0]]] * 2, np.float32)
    plain = (Diffuse(), *small_geometry().materials[1:])
    shapes = (replace(first, radiance=radiance), *others)
    with pytest.raises(LumitreeError, match="shape 0: radiance"):
        small_geometry(shapes=shapes, materials=plain, images=(image, image))


def test_geometry_that_is_too_deep_or_too_large_is_not_made(monkeypatch):
    material = Diffuse()
    for _ in range(8):
        material = TwoSided(nested=(material,))
    with pytest.raises(LumitreeError, match="nested more than 8 deep"):
        check_material(material, [])
    monkeypatch.setattr("lumitree.asset.geometry.MAX_IMAGE_BYTES", 40)
    with pytest.raises(LumitreeError, match="images of 42 bytes"):
        small_geometry()


def test_geometry_needs_light_and_is_inside_the_box():
    with pytest.raises(LumitreeError, match="geometry without anything that illuminates"):
        replace(with_geometry(small_geometry()), light_field=None)
    frame = LocalFrame(np.array([1.0, 0.3, 1.0]), np.eye(4))
    with pytest.raises(LumitreeError, match="outside the box"):
        with_geometry(small_geometry(), frame)
    *others, sphere = small_geometry().shapes
    sphere = replace(sphere, to_world=rows_of(np.eye(4) + np.eye(4, k=3)))
    with pytest.raises(LumitreeError, match="outside the box"):
        with_geometry(small_geometry(shapes=(*others, sphere)))
