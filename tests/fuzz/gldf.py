"""GLDF files: archives of a product's XML, an L3D model and photometric files."""

import functools
import io
import struct
import warnings
import zipfile

from fuzz import photometric_texts, words, xml_trees
from fuzz.reader import MEBIBYTE, Reader
from fuzz.values import chance, pick, text
from lumitree.formats.gldf import KIND, read_variant
from lumitree.formats.l3d import KIND as L3D_KIND
from lumitree.formats.l3d import read_l3d
from lumitree.formats.reading import Archive
from support import gldf_files as files
from support.damage import damaged
from support.obj_files import obj_model

_FILE = "lamp.gldf"
_SIMPLE = (
    '<SimpleGeometry id="simple"><RectangularEmitter><Width>100</Width><Length>200</Length>'
    "</RectangularEmitter><C-Heights><C0>1</C0><C90>1</C90><C180>1</C180><C270>1</C270>"
    "</C-Heights></SimpleGeometry>"
)
# Bytes of a member that is much larger than its compressed form.
_LARGE = 1 << 24


@functools.cache
def _products():
    """XML of products of several kinds."""
    simple = '<SimpleGeometryReference geometryId="simple" emitterId="e"/>'
    turned = files.emitter(rest="<Rotation><X>10</X><Y>0</Y><Z>5</Z><G0>20</G0></Rotation>")
    return (
        files.product(),
        files.product(emitters=files.emitter(lumens="800")),
        files.product(emitters=turned),
        files.product(files.variant(simple), general=_SIMPLE),
        files.product(files.variant() + files.variant(name="w", attributes='sortOrder="1"')),
        files.product(files.variant("")),
    )


@functools.cache
def _structures():
    """XML of L3D models of several kinds."""
    child = files.part(at=(0, 0, 0.1))
    joined = files.part(files.light(), files.surface(), joints=files.joint(child, turn=(10, 0, 0)))
    grouped = files.surface(faces=(0, 3), group='groupIndex="0"')
    round_ = files.light(shape='<Circle diameter="0.2"/>')
    return (
        files.structure(),
        files.structure(joined),
        files.structure(files.part(round_), units="mm"),
        files.structure(files.part(files.light(), grouped)),
    )


def _xml(rng, content):
    if chance(rng, 0.1):
        return damaged(content, rng)
    return xml_trees.changed(content, rng)


def make(rng):
    """A GLDF file, one part of which is changed."""
    product, structure = pick(rng, _products()).encode(), pick(rng, _structures()).encode()
    box = files.obj(head="mtllib lamp.mtl\nusemtl shade").encode()
    photometry, model = _photometry(), None
    match int(rng.integers(8)):
        case 0 | 1 | 2:
            product = _xml(rng, product)
        case 3 | 4:
            structure = _xml(rng, structure)
        case 5:
            box = damaged(box, rng, tokens=(b"f", b"g", b"o", b"usemtl"))
        case 6:
            photometry = photometric_texts.ldt(rng)
        case _:
            model = words.flipped(_l3d(structure, box), rng)
    members = {
        "product.xml": product,
        "ldc/lamp.ldt": photometry,
        "geo/lamp.l3d": _l3d(structure, box) if model is None else model,
    }
    content = zipped(members, rng)
    return {_FILE: words.flipped(content, rng) if chance(rng, 0.1) else content}


@functools.cache
def _photometry():
    lines = ["own", "1", 1, 24, 15, 3, 45, "rep", "case", "no", "file", "date"]
    lines += [100, 50, 80, 100, 50, 0, 0, 0, 0, 100, 100, 1, 0, 1, 1, "LED", 500, 3000, 80, 10]
    lines += [0.5] * 10 + [15 * plane for plane in range(24)] + [0, 45, 90, 200, 100, 0]
    return ("\n".join(map(str, lines)) + "\n").encode()


def _l3d(structure, box):
    model = obj_model()
    members = {"structure.xml": structure, "box/box.obj": box, "box/lamp.mtl": model["lamp.mtl"]}
    return files.zipped(members | {"box/image.png": model["image.png"]})


def zipped(members, rng):
    """A zip archive whose members are stored in several ways; a few have wrong headers."""
    stream = io.BytesIO()
    with warnings.catch_warnings(), zipfile.ZipFile(stream, "w") as archive:
        # Of members of one name.
        warnings.simplefilter("ignore")
        for name, content in members.items():
            kind = pick(rng, (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_DEFLATED))
            if chance(rng, 0.05):
                kind = pick(rng, (zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA))
            name = _member_name(rng, name)
            if chance(rng, 0.003):
                content += b" " * _LARGE
                kind = zipfile.ZIP_DEFLATED
            # Without a date: an input depends on its number alone.
            archive.writestr(zipfile.ZipInfo(name), content, kind)
            if chance(rng, 0.02):
                archive.writestr(zipfile.ZipInfo(name), b"")
    data = bytearray(stream.getvalue())
    if chance(rng, 0.1):
        _change_entry(data, rng)
    return bytes(data)


def _member_name(rng, name):
    if chance(rng, 0.04):
        return pick(rng, (name.upper(), f"./{name}", name.replace("/", "\\"), f"../{name}"))
    if chance(rng, 0.01):
        # zipfile writes no lone surrogates, nothing after a zero, and no empty names.
        return text(rng).encode("utf-8", "ignore").decode().partition("\0")[0] or " "
    return name


def _change_entry(data, rng):
    """Set one number of an entry of the archive's directory, or of its end, in place."""
    entries = [at for at in range(len(data) - 46) if data[at : at + 4] == b"PK\x01\x02"]
    end = data.rfind(b"PK\x05\x06")
    # Version, flags, method, time, sum, both sizes, lengths of texts, offset.
    places = [(at + field, 2 if field in (6, 8, 10, 28, 30, 32) else 4)
              for at in entries for field in (6, 8, 10, 16, 20, 24, 28, 30, 32, 42)]  # fmt: skip
    places += [(end + field, size) for field, size in ((8, 2), (10, 2), (12, 4), (16, 4), (20, 2))]
    at, size = pick(rng, places)
    value = pick(rng, (0, 1, 8, 9, 12, 14, 99, 0xFFFF, 0x7FFFFFFF, 0xFFFFFFFF))
    data[at : at + size] = struct.pack("<I", value)[:size]


def read(folder):
    """The product, its model and its photometries, as `bake_gldf` reads them before it bakes."""
    from lumitree.formats.photometric_file import read_photometry

    path = folder / _FILE
    archive = Archive.open(path, KIND)
    found = read_variant(archive, path, None)
    if found.model is not None:
        member = found.model.member(archive)
        read_l3d(Archive(archive.read(member, L3D_KIND), "the model", L3D_KIND, archive))
    for each in found.emitters:
        content = archive.read(each.photometry.member(archive), "a photometric file")
        (folder / "copy.ldt").write_bytes(content)
        read_photometry(folder / "copy.ldt")
    return path


def use_in_full(path):
    """Bake the file, and show its asset, coarsely."""
    from fuzz.rendering import assert_renders, coarse_bakes
    from lumitree.core.backend import load_mitsuba
    from lumitree.errors import explained
    from support.sound_assets import assert_sound
    from support.variant import VARIANT

    load_mitsuba(VARIANT)
    from lumitree.formats.gldf import bake_gldf

    with coarse_bakes():
        asset = explained(bake_gldf)(path)
    assert_sound(asset)
    assert_renders(asset)


READERS = (
    Reader(
        "gldf",
        make,
        read,
        use_in_full=use_in_full,
        # Of what is unpacked, and of what is made of it.
        memory=3072 * MEBIBYTE,
        in_suite=120,
        full_share=1 / 100,
    ),
)
