"""Files of others that are small and would take gigabytes: one line, before the work."""

import io
import zipfile

import numpy as np
import pytest
from PIL import Image

from lumitree.errors import LumitreeError, LumitreeWarning
from lumitree.formats import l3d as l3d_module
from lumitree.formats import reading
from lumitree.formats.gldf import bake_gldf
from lumitree.formats.reading import Archive, parse_xml
from lumitree.formats.tm33 import read_tm33
from support.gldf_files import l3d, light, obj, part, product, structure, surface
from support.photometric_types import ies
from support.tm33_files import table, tm33

FILES = (
    '<File id="ldc" contentType="ldc/ies" type="localFileName">{}</File>'
    '<File id="geo" contentType="geo/l3d" type="localFileName">lamp.l3d</File>'
)
MIB = 1 << 20


@pytest.fixture(autouse=True)
def folder(mi, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def photometry():
    return ies("C", np.zeros(1), np.array([0.0, 90]), np.array([[100.0, 0]])).encode()


def zipped(files, method=zipfile.ZIP_DEFLATED):
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", method) as archive:
        for name, data in files.items():
            archive.writestr(name, data)
    return content.getvalue()


def gldf(path="lamp.gldf", xml=None, model=None, method=zipfile.ZIP_DEFLATED):
    """Path of a GLDF file."""
    files = {
        "product.xml": product(files=FILES.format("lamp.ies")) if xml is None else xml,
        "ldc/lamp.ies": photometry(),
        "geo/lamp.l3d": l3d() if model is None else model,
    }
    with open(path, "wb") as file:
        file.write(zipped(files, method))
    return path


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_other_methods_of_compression_are_refused(method):
    """zipfile unpacks them as a whole, whatever size is read: 2 GiB of 1.7 kB."""
    with pytest.raises(LumitreeError, match=r"product.xml in lamp.gldf is compressed by method 1"):
        bake_gldf(gldf(method=method))


def test_a_member_is_refused_by_the_size_that_it_states(monkeypatch):
    unpacked = []
    monkeypatch.setattr(zipfile.ZipExtFile, "read", lambda *_: unpacked.append(1))
    monkeypatch.setattr(reading, "_MAX_UNPACKED", 2 * MIB)
    with pytest.raises(LumitreeError, match=r"is too large: 3 MiB, of which 2 MiB would be"):
        bake_gldf(gldf(xml=b" " * (3 * MIB)))
    assert not unpacked


def test_a_list_of_members_is_counted_before_it_is_read(monkeypatch):
    content = zipped({f"{i}": b"" for i in range(64)} | {"last": b""})
    monkeypatch.setattr(zipfile, "ZipFile", None)
    monkeypatch.setattr(reading, "_MAX_MEMBERS", 64)
    with pytest.raises(LumitreeError, match=r"a has 65 members; at most 64 are read"):
        Archive(content, "a", "an archive")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"<a>" + b" " * (2 * MIB) + b"</a>", "larger than 1 MiB"),
        (b"<a>" + b"<b/>" * 512 + b"</a>", "more than 512 elements"),
        (b"<a " + b'b="" ' * 1025 + b"/>", "more than 1024 attributes"),
        (b"<a>" * 300 + b"</a>" * 300, "more than 256 deep"),
        (b'<!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>', "declares XML entities"),
    ],
)
def test_limits_of_xml(monkeypatch, content, message):
    for name, value in (("MAX_XML_BYTES", MIB), ("_MAX_ELEMENTS", 512), ("_MAX_ATTRIBUTES", 1024)):
        monkeypatch.setattr(reading, name, value)
    with pytest.raises(LumitreeError, match=message):
        parse_xml(content, "x", "a file")


PARTS = part(light(), surface())


@pytest.mark.parametrize(
    ("model", "message"),
    [
        (obj() + "\n" * (3 * MIB), "too large: 3 MiB, of which 2 MiB"),
        (obj() + "f 1 2 3\n" * 1024, "more than 1024 lines"),
        (obj() + ("f" + " 1 2 3" * 300 + "\n") * 6, "or 4096 corners of faces"),
    ],
)
def test_limits_of_models(monkeypatch, model, message):
    """The light is there without them."""
    for name, value in (("_MAX_OBJ_BYTES", 2 * MIB), ("_MAX_LINES", 1024), ("_MAX_CORNERS", 4096)):
        monkeypatch.setattr(l3d_module, name, value)
    path = gldf(model=l3d(box_obj=model))
    with pytest.warns(LumitreeWarning, match=f"its light without its 3D model: .*{message}"):
        assert bake_gldf(path).geometry is None


def test_pixels_of_images_are_counted_before_they_are_decoded(monkeypatch):
    """Many black pixels are a few bytes of an archive in another one."""
    monkeypatch.setattr(l3d_module, "_MAX_PIXELS", 1 << 12)
    image = io.BytesIO()
    Image.new("L", (128, 128)).save(image, "PNG")
    mtl = "newmtl a\nmap_Kd a.png\n"
    model = l3d(box_obj=obj(head="mtllib a.mtl\nusemtl a"), a_mtl=mtl, a_png=image.getvalue())
    with pytest.warns(LumitreeWarning, match="its images have more than 4096 pixels"):
        assert bake_gldf(gldf(model=model)).geometry is None


def test_parts_of_a_model_are_counted(monkeypatch):
    monkeypatch.setattr(l3d_module, "_MAX_PARTS", 20)
    many = l3d(structure(PARTS + 20 * part()))
    with pytest.raises(LumitreeError, match="more than 20 parts and light emitting objects"):
        bake_gldf(gldf(model=many))


def test_emitters_of_different_angles_are_limited(folder):
    """2 emitters of 2,000 and more angles in each direction are one grid of millions."""
    first, second = (
        table(np.array([0.0]), np.linspace(0, 180, 1500)),
        table(np.linspace(0, 359.9, 1500), np.array([0.0, 180])),
    )
    text = tm33(data=first).replace("</IESTM33-22>", "")
    other = tm33(data=second)
    text += other[other.index("<Emitter>") :]
    (folder / "a.tm33").write_text(text)
    with pytest.raises(LumitreeError, match=r"2 emitters have 1500 x 1500 different angles"):
        read_tm33("a.tm33")


@pytest.mark.parametrize("declared", ["UTF-16", "utf-8"])
@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be"])
def test_a_product_in_utf_16_is_read(encoding, declared):
    xml = product(files=FILES.format("lamp.ies")).replace("UTF-8", declared).encode(encoding)
    assert bake_gldf(gldf(xml=xml)).luminaire.startswith("lamp")


@pytest.mark.parametrize(
    ("encoding", "name"),
    [
        ("cp437", "Leuchte-äöüßñ.ies"),
        ("cp850", "Løuchte-äöüßÁ.ies"),
        ("cp1252", "Løuchte-äöüß€.ies"),
        ("utf-8", "灯-äöü.ies"),
    ],
)
def test_names_of_members_in_the_encodings_of_older_programs(encoding, name):
    """Programs that do not mark a name as UTF-8 write it in a code page."""
    raw = name.encode(encoding)
    files = {
        "product.xml": product(files=FILES.format(name)).encode(),
        f"ldc/{'X' * len(raw)}": photometry(),
        "geo/lamp.l3d": l3d(),
    }
    with open("lamp.gldf", "wb") as file:
        file.write(zipped(files).replace(b"X" * len(raw), raw))
    assert bake_gldf("lamp.gldf").light_field is not None
