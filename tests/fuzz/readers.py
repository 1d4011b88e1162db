"""The readers: a corpus of valid files, how they are changed, and the check of accepted inputs."""

import dataclasses
import functools
import json
import struct
import tempfile
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import strategies as st

from fuzz.mutations import (
    changed_bytes,
    changed_text,
    changed_tree,
    changed_xml,
    few,
    json_text,
    toml_text,
)
from lumitree.asset.asset import EmittedSpectrum, light_field_asset
from lumitree.asset.file import load, save
from lumitree.asset.light_field import TracedPaths
from lumitree.errors import LumitreeError
from lumitree.formats.gldf import KIND, read_variant
from lumitree.formats.ies import read_ies
from lumitree.formats.l3d import KIND as L3D_KIND
from lumitree.formats.l3d import read_l3d
from lumitree.formats.ldt import read_ldt
from lumitree.formats.reading import Archive
from lumitree.formats.tm25 import read_tm25
from lumitree.formats.tm33 import read_tm33
from lumitree.lamp.read_source import read_model
from lumitree.measure.receivers import read_points
from lumitree.rendering.placement import read_placements
from support import gldf_files
from support.asset_drafts import CHANGES, Draft
from support.every_material import every_material
from support.fields import random_asset
from support.geometry_assets import small_geometry, with_geometry
from support.gltf_models import rich
from support.ies_text import ies_text
from support.light_fields import assert_equal_fields, random_light_field, with_inside
from support.obj_files import obj_model
from support.placement_text import PLACEMENTS
from support.sound_assets import assert_sound
from support.stored_arrays import change_geometry_arrays, change_light_arrays
from support.tm25_files import file_bytes
from support.tm33_files import AREA, table, tm33

_DIRECTIONS = np.random.default_rng(0).normal(size=(40, 3))
_DIRECTIONS = np.concatenate([_DIRECTIONS, np.eye(3), -np.eye(3)])
_OBJ_WORDS = ("f", "v", "vt", "vn", "usemtl", "mtllib", "g", "o", "s", "l", "\\", "newmtl", "Kd")
_OBJ_WORDS += ("Ke", "Tf", "illum", "map_Kd", "map_Ke", "map_d", "-s", "-o", "-clamp", "spectral")
_GLTF_KEYS = ("KHR_draco_mesh_compression", "EXT_mesh_gpu_instancing", "KHR_materials_volume")
_GLTF_KEYS += ("sparse", "extensionsRequired", "children", "matrix", "byteStride", "normalized")
_ASSET_KEYS = ("light", "spectrum", "inside", "traced", "origin", "nested", "image", "scale")


@dataclasses.dataclass(frozen=True)
class Reader:
    """A reader of files.

    Attributes:
        inputs: strategy of the contents of the files of an input by name; the first is read.
        read: takes the path of the first file; returns what was read.
        check: takes the result, and fails if it is not sound.
        use: the same, by a rendering or a bake: it takes seconds.
        memory: bytes that one input may take at most, besides the memory of the program.
        count: of inputs of a run, unless the environment says how many.
    """

    inputs: st.SearchStrategy[dict[str, bytes]]
    read: Callable[..., Any]
    check: Callable[[Any], None] = lambda _: None
    use: Callable[[Any], None] | None = None
    memory: int = 2 << 30
    count: int = 40


@functools.cache
def drafts():
    """A draft of each kind of asset."""
    plain = random_asset(0, tree_depth=3, l_max=1, half_extents=np.array([1.0, 0.5, 0.25]))
    light = random_light_field(0, traced=TracedPaths(1 << 20, (0, 7), 64 * "a", 0.02))
    spectrum = EmittedSpectrum.of(np.random.default_rng(0).random(471), 0.75)
    inside = with_inside(1, random_light_field(1))
    whole = with_geometry(small_geometry())
    assets = (
        plain,
        random_asset(1, tree_depth=2, l_max=4, law="exponential", light_factors=(0.5, 1.0, 2.0)),
        dataclasses.replace(plain, light_field=light),
        light_field_asset(random_light_field(2, resolution=8), plain.frame, "test", spectrum),
        light_field_asset(inside, plain.frame, "test"),
        dataclasses.replace(whole, light_field=inside, spectrum=spectrum),
        with_geometry(every_material()),
    )
    return tuple(map(Draft, assets))


@st.composite
def assets(draw):
    """The file of an asset that was changed, with a checksum that is right."""
    made = draw(st.sampled_from(drafts()))
    made = Draft(made.asset)
    rng = np.random.default_rng(draw(st.integers(0, 1 << 30)))
    content = made.file()
    for _ in range(draw(few)):
        kind = draw(st.integers(0, 5))
        try:
            if kind == 0:
                tree = draw(changed_tree(json.loads(made.description()), _ASSET_KEYS))
                content = made.file(made.header(draw(json_text(tree)).decode("utf-8", "replace")))
            elif kind == 1 and made.asset.geometry is not None:
                stored = json.loads(made.tensors["geometry.shapes"].tobytes())
                text = draw(json_text(draw(changed_tree(stored, _ASSET_KEYS))))
                made.tensors["geometry.shapes"] = np.frombuffer(text, np.uint8)
                content = made.file()
            elif kind == 2 and made.asset.light_field is not None:
                change_light_arrays(made.tensors, made.asset.light_field, _one_array(rng))
                content = made.file()
            elif kind == 3 and made.asset.geometry is not None:
                change_geometry_arrays(made.tensors, _one_array(rng))
                content = made.file()
            else:
                content = CHANGES[rng.integers(len(CHANGES))](made, rng) or made.file()
        except (LumitreeError, LookupError, TypeError, ValueError, AttributeError, RecursionError):
            # An earlier change may have left nothing to change.
            continue
    return {"lamp.lumitree": content}


def _one_array(rng):
    def change(arrays):
        array = arrays[rng.choice([name for name, each in arrays.items() if each.size])]
        values = (0, 1, *([np.inf, -1, np.nan] if array.dtype.kind == "f" else [array.max()]))
        array.flat[rng.integers(array.size)] = values[rng.integers(len(values))]

    return change


def _sound_distribution(lamp):
    assert np.isfinite(lamp.lumens)
    assert lamp.lumens >= 0
    values = lamp.at(_DIRECTIONS)
    assert np.isfinite(values).all()
    assert (values >= 0).all()
    assert all(text.isprintable() for text in (lamp.name, *lamp.details.values()))


def _sound_tm33(found):
    _sound_distribution(found[0])
    assert np.isfinite(found[1]).all()
    assert min(found[1]) >= 0


def _bake(lamp, *colour):
    """The asset of intensities is sound, and is shown; if they are 0, that is said."""
    from lumitree.formats.light_field import bake_distribution

    try:
        asset = bake_distribution(lamp, *colour)
    except LumitreeError as error:
        if lamp.lumens > 1e-6:
            raise AssertionError(f"intensities were read, but not baked: {error}") from error
        return
    _show(asset)


def _sound_asset(asset):
    assert_sound(asset)
    # A change that is accepted comes back from a file.
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "again.lumitree"
        save(asset, path)
        again = load(path)
    assert (again.luminaire, again.parts) == (asset.luminaire, asset.parts)
    assert (again.spectrum is None) == (asset.spectrum is None)
    if asset.light_field is not None:
        assert_equal_fields(again.light_field, asset.light_field)
    if asset.geometry is not None:
        assert again.geometry.shapes == asset.geometry.shapes
        assert again.geometry.materials == asset.geometry.materials


def _show(asset):
    # Mitsuba is loaded only for this.
    from fuzz.rendering import assert_renders

    assert_sound(asset)
    assert_renders(asset)


def ldt(symmetry=1, planes=24, sets=1):
    """Text of an EULUMDAT file."""
    count = {0: planes, 1: 1, 4: planes // 4 + 1}[symmetry]
    lines = ["own", "1", symmetry, planes, 360 / planes, 3, 45, "rep", "case", "no", "file", "date"]
    lines += [100, 50, 80, 100, 50, 0, 0, 0, 0, 100, 100, 1, 0, sets]
    lines += sets * [1, "LED", 500, 3000, 80, 10]
    lines += [0.5] * 10 + [360 / planes * plane for plane in range(planes)] + [0, 45, 90]
    lines += count * [200, 100, 0]
    return ("\n".join(map(str, lines)) + "\n").encode()


def ies():
    """IES files of several symmetries and types."""
    gamma = [0, 30, 60, 90]
    plain = ies_text([[100, 80, 30, 0]], [0], gamma)
    turned = ies_text([[9, 5, 3, 1]] * 3, [0, 45, 90], gamma, (0.1, -0.1, 0.2))
    tilted = plain.replace("TILT=NONE", "TILT=INCLUDE\n1\n2\n0 90\n1 0.8")
    of_type_b = ies_text([[1, 2, 1]] * 3, [-60, 0, 60], [-90, 0, 90]).replace(" 1 2 ", " 2 2 ")
    return [each.encode() for each in (plain, turned, tilted, of_type_b)]


def tm25():
    """Ray files with several columns and tables of spectra."""
    random, nanometres = np.random.default_rng(0), np.array([[400.0, 1], [550, 3], [700, 2]])
    found = []
    for width, flags, kind, tables in (
        (1, [1, 1, 0, 0, 1, 0, 0, 0], 0, ()),
        (3, [1, 1, 0, 0, 1, 0, 1, 0], 0, ()),
        (2, [1, 1, 1, 1, 0, 0, 0, 0], 2, ()),
        (2, [1, 1, 0, 0, 1, 0, 0, 1], 4, (nanometres, nanometres[:2])),
        (1, [1, 1, 1, 0, 0, 0, 0, 0], 3, (nanometres,)),
    ):
        rows = random.random((6, 6 + width)).astype(np.float32)
        rows[:, 3:6] /= np.linalg.norm(rows[:, 3:6], axis=1, keepdims=True)
        if width == 2:
            rows[:, 7] = 550 if kind == 2 else 1
        found.append(file_bytes(rows, flags, kind, tables=tables))
    return found


@st.composite
def ray_files(draw):
    """Ray files with other numbers in their header, tables and rays."""
    content = bytearray(draw(st.sampled_from(tm25())))
    end = len(content)
    for _ in range(draw(few)):
        # The texts between header and tables are long.
        at = 4 * draw(st.one_of(st.integers(1, 72), st.integers(9072, end // 4 - 1)))
        values = st.sampled_from((0, 1, 2, 5, -1, 2**31 - 1, 0x7F800000, 0x7FC00000, 0x3F000000))
        content[at : at + 4] = struct.pack("<i", draw(values))
    return {"lamp.ray": bytes(content)}


def tm33_texts():
    """Small TM-33 files of several kinds."""
    c, gamma, half = np.arange(0, 360, 90.0), np.arange(0, 181, 45.0), np.arange(-90, 91, 45.0)
    kind = "<Equipment><Gonioradiometer><Type>CIE{}</Type></Gonioradiometer></Equipment>"
    tilts = "<BallastFactor>0.9</BallastFactor><TiltAngles><Tilt angle='0'>0.8</Tilt></TiltAngles>"
    texts = (
        tm33(table(c, gamma)),
        tm33(table([0.0], gamma), before=tilts),
        tm33(table(half, half), top=kind.format("A")),
        tm33(table(c, gamma, extra="<Multiplier>2</Multiplier>"), areas=2 * AREA, emitters=2),
        tm33(table(c, gamma, point="IntensityData", keys=("horz", "vert")), root="IESTM33"),
    )
    return [text.encode() for text in texts]


@st.composite
def gldf(draw):
    """A GLDF file, one member of which is changed."""
    lumens = gldf_files.product(emitters=gldf_files.emitter(lumens="800"))
    product = draw(st.sampled_from((gldf_files.product(), lumens))).encode()
    round_ = gldf_files.part(gldf_files.light(shape='<Circle diameter="0.2"/>'))
    structures = (gldf_files.structure(), gldf_files.structure(round_, units="mm"))
    model = obj_model()
    inner = {
        "structure.xml": draw(st.sampled_from(structures)).encode(),
        "box/box.obj": gldf_files.obj(head="mtllib lamp.mtl\nusemtl shade").encode(),
        "box/lamp.mtl": model["lamp.mtl"],
        "box/image.png": model["image.png"],
    }
    photometry, part = ldt(), draw(st.integers(0, 5))
    if part == 0:
        product = draw(changed_xml(product))
    elif part == 1:
        inner["structure.xml"] = draw(changed_xml(inner["structure.xml"]))
    elif part == 2:
        inner["box/box.obj"] = draw(changed_text(inner["box/box.obj"], (" ", "/"), _OBJ_WORDS))
    elif part == 3:
        photometry = draw(changed_text(photometry))
    archive = gldf_files.zipped(inner)
    if part == 4:
        archive = draw(changed_bytes(archive))
    members = {"product.xml": product, "ldc/lamp.ldt": photometry, "geo/lamp.l3d": archive}
    content = gldf_files.zipped(members)
    return {"lamp.gldf": draw(changed_bytes(content)) if part == 5 else content}


def _read_gldf(path):
    """The product, its model and its photometries, as `bake_gldf` reads them before it bakes."""
    from lumitree.formats.photometric_file import read_photometry

    archive = Archive.open(path, KIND)
    found = read_variant(archive, path, None)
    if found.model is not None:
        member = found.model.member(archive)
        read_l3d(Archive(archive.read(member, L3D_KIND), "the model", L3D_KIND, archive))
    for each in found.emitters:
        content = archive.read(each.photometry.member(archive), "a photometric file")
        path.with_name("copy.ldt").write_bytes(content)
        read_photometry(path.with_name("copy.ldt"))
    return path


def _bake_gldf(path):
    from fuzz.rendering import coarse_bakes
    from lumitree.errors import explained
    from lumitree.formats.gldf import bake_gldf

    with coarse_bakes():
        asset = explained(bake_gldf)(path)
    _show(asset)


@st.composite
def obj(draw):
    """An OBJ model, one or two of whose files are changed."""
    files = obj_model()
    for name in draw(st.lists(st.sampled_from(list(files)), min_size=1, max_size=2)):
        if name == "lamp.toml":
            try:
                tree = tomllib.loads(files[name].decode())
            except (ValueError, RecursionError):
                continue
            files[name] = toml_text(draw(changed_tree(tree)))
        elif name == "image.png":
            files[name] = draw(changed_bytes(files[name]))
        else:
            files[name] = draw(changed_text(files[name], (" ", "/"), _OBJ_WORDS))
    return files


@st.composite
def gltf(draw):
    """A glTF model whose JSON or buffer is changed; the lengths fit."""
    made = rich()
    text, data = json.dumps(made.with_buffer()), bytes(made.data)
    tree = json.loads(text)
    if draw(st.integers(0, 3)) == 0:
        at = 4 * draw(st.integers(0, len(data) // 4 - 1))
        word = draw(st.sampled_from((0, 1, 255, 65535, 2**31 - 1, 0x7FC00000)))
        data = data[:at] + struct.pack("<I", word) + data[at + 4 :]
    else:
        tree = draw(changed_tree(tree, _GLTF_KEYS))
    content = draw(json_text(tree))
    content += b" " * (-len(content) % 4)
    data += b"\0" * (-len(data) % 4)
    body = struct.pack("<II", len(content), 0x4E4F534A) + content
    body += struct.pack("<II", len(data), 0x004E4942) + data
    return {"lamp.glb": struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body}


def _read_model(path):
    return path, read_model(path)


def _sound_model(found):
    geometry = found[1]
    names = {material.name for material in geometry.materials}
    assert geometry.parts
    for part in geometry.parts:
        mesh = part.mesh
        assert part.material in names
        assert np.isfinite(mesh.vertices).all()
        assert len(mesh.faces) > 0
        assert 0 <= mesh.faces.min() <= mesh.faces.max() < len(mesh.vertices)
        assert mesh.normals is None or mesh.normals.shape == mesh.vertices.shape


def _show_model(found):
    from fuzz.rendering import assert_lamp_renders

    assert_lamp_renders(found[0])


def _sound_placements(found):
    for each in found:
        assert each.label is not None
        for values in (each.at, each.rotate, each.size, each.gain, each.lumens, each.temperature):
            assert values is None or np.isfinite(np.array(values, float)).all()


def _sound_points(found):
    points, normals = found
    assert points.shape == normals.shape == (len(points), 3)
    assert len(points) > 0


def _texts(name, corpus, **options):
    """Changed texts of a corpus."""
    texts = st.sampled_from(corpus).flatmap(lambda text: changed_text(text, **options))
    return texts.map(lambda content: {name: content})


_POINTS = b"x,y,z,nx,ny,nz\n" + b"0.5,1,-2.25,0,1,0\n" * 3
_LDT = [ldt(), ldt(0, 4), ldt(4, 8, 2)]
_TM33 = st.sampled_from(tm33_texts()).flatmap(changed_xml).map(lambda text: {"lamp.tm33": text})
_PLACEMENT_TREES = changed_tree(tomllib.loads(PLACEMENTS))
READERS = {
    "asset": Reader(assets(), load, _sound_asset, _show, memory=3 << 30, count=200),
    "ies": Reader(_texts("a.ies", ies()), read_ies, _sound_distribution, _bake),
    "ldt": Reader(_texts("a.ldt", _LDT), read_ldt, _sound_distribution, _bake),
    "tm25": Reader(ray_files(), read_tm25),
    "tm33": Reader(_TM33, read_tm33, _sound_tm33, lambda found: _bake(*found)),
    "gldf": Reader(gldf(), _read_gldf, use=_bake_gldf, memory=3 << 30),
    "obj": Reader(obj(), _read_model, _sound_model, _show_model),
    "gltf": Reader(gltf(), _read_model, _sound_model, _show_model),
    "placements": Reader(
        _PLACEMENT_TREES.map(lambda tree: {"lights.toml": toml_text(tree)}),
        read_placements,
        _sound_placements,
    ),
    "points": Reader(
        _texts("points.csv", [_POINTS], separators=(",",)), read_points, _sound_points
    ),
}
