"""The kind of a file, for messages; and its encoding."""

import io

import numpy as np
import OpenEXR
import pytest
from PIL import Image

import lumitree
from lumitree.cli import main
from lumitree.core.file_kinds import in_utf8, what_it_is


def png():
    buffer = io.BytesIO()
    Image.new("L", (2, 2)).save(buffer, "png")
    return buffer.getvalue()


FILES = {
    "a.png": (png(), "a PNG image"),
    "a.jpg": (b"\xff\xd8\xff\xe0", "a JPEG image"),
    "a.glb": (b"glTF\x02\x00", "a glTF model"),
    "a.gltf": (b'{"asset": {"version": "2.0"}}', "a glTF model"),
    "a.OBJ": (b"v 0 0 0\n", "an OBJ model"),
    "room.xml": (b'<?xml version="1.0"?>\n<scene version="3.0.0"/>', "a Mitsuba scene"),
    "a.svg": (b"<svg/>", "an XML file"),
    "lamp.txt": (b"IESNA:LM-63-2002\n", "a photometric file (IES LM-63)"),
    "a.toml": (b"[lamps.a]\n", "a TOML file"),
    "empty.lumitree": (b"", "an empty file"),
    "a.bin": (bytes(range(256)), "a file of another kind"),
}


@pytest.mark.parametrize("name", FILES)
def test_what_is_not_an_asset_is_named(tmp_path, name, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    content, kind = FILES[name]
    (tmp_path / name).write_bytes(content)
    assert what_it_is(name) == (None if name == "a.bin" else kind)
    assert main(["info", name]) == 2
    error = capsys.readouterr().err
    assert f"{name} is {kind}, not a .lumitree asset; expected" in error
    assert error.count("\n") == 1


def test_folders_and_names_without_a_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder").mkdir()
    assert what_it_is("folder") == "a folder"
    assert what_it_is("nothing") is None
    for name, message in (
        ("folder", "folder is a folder"),
        ("nothing", "nothing does not exist"),
        ("bulbs", "bulbs is a built-in luminaire, not an asset; bake it first"),
        ("a\0b", "not a file name"),
    ):
        with pytest.raises(lumitree.LumitreeError, match=message):
            lumitree.load(name)


def test_a_damaged_asset_stays_a_damaged_asset(tmp_path):
    (tmp_path / "a.lumitree").write_bytes(bytes(range(200, 256)) * 4)
    with pytest.raises(lumitree.LumitreeError, match=r"is not a valid \.lumitree asset"):
        lumitree.load(tmp_path / "a.lumitree")


def test_other_places_name_it_too(mi, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.png").write_bytes(png())
    (tmp_path / "a.ies").write_text("x")
    (tmp_path / "room.xml").write_text(
        '<scene version="3.0.0"><sensor type="perspective"/></scene>'
    )
    for command, message in (
        (["mix", "a.png", "-o", "b.png"], "a.png is not a readable OpenEXR image: it is a PNG"),
        (["render", "room.xml", "--place", "a.png", "-o", "b.png"], "a.png is a PNG image; exp"),
        (["render", "a.png", "-o", "b.png"], "a.png is a PNG image; expected a Mitsuba 3 scene"),
        (["capture", "a.ies", "-o", "d"], "a.ies is a photometric file, which has no shapes"),
        (["bake", "room.xml.lumitree", "-o", "b.lumitree"], "no luminaire"),
    ):
        assert main(command) == 2
        error = capsys.readouterr().err
        assert message in error
        assert error.count("\n") == 1
    # A damaged image has the reader's message.
    OpenEXR.File({}, {"Y": np.zeros((2, 2), np.float32)}).write("c.exr")
    content = (tmp_path / "c.exr").read_bytes()
    (tmp_path / "c.exr").write_bytes(content[:20])
    assert main(["mix", "c.exr", "-o", "b.png"]) == 2
    assert "it is" not in capsys.readouterr().err


LINES = ["v 1 2 3", "# Küche", "", "f 1 2 3"]


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r", "\r\r\n"])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be"])
def test_encodings_and_line_ends(encoding, end):
    content = end.join(LINES).encode(encoding)
    assert in_utf8(content).decode().split("\n") == LINES


def test_bytes_of_other_encodings_are_left():
    assert in_utf8("# Küche".encode("latin-1")) == b"# K\xfcche"
    assert in_utf8(b"") == b""
