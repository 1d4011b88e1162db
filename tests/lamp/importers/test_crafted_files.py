"""Files that nobody would write by hand: each is refused in one printable line."""

import os

import pytest

from lumitree.errors import LumitreeError
from lumitree.lamp.loading import load_luminaire

KINDS = (".xml", ".obj", ".gltf", ".glb")
SHAPE = (
    '<shape type="sphere" id="{name}"><bsdf type="diffuse"/>'
    '<emitter type="area"><rgb name="radiance" value="1"/></emitter></shape>'
)
OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl a\nf 1 2 3\n"


def refused(source, match):
    with pytest.raises(LumitreeError, match=match) as caught:
        load_luminaire(source)
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 1000


def xml(content, head=""):
    return f'{head}<scene version="3.0.0">{content}</scene>'


@pytest.mark.parametrize("kind", KINDS)
def test_files_that_may_not_be_read(mi, tmp_path, monkeypatch, kind):
    path = tmp_path / f"lamp{kind}"
    path.write_text("")
    original = type(path).open

    def forbidden(self, *options, **named):
        if self == path:
            raise PermissionError(13, "Permission denied")
        return original(self, *options, **named)

    monkeypatch.setattr(type(path), "open", forbidden)
    refused(path, f"lamp{kind}: Permission denied")


@pytest.mark.parametrize("kind", KINDS)
def test_folders_in_place_of_files(mi, tmp_path, kind):
    (tmp_path / f"lamp{kind}").mkdir()
    refused(tmp_path / f"lamp{kind}", "is a folder; expected a")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", ["x" * 300, "a\0b", "\x1b[31m", "\ud800"])
def test_paths_that_cannot_be(mi, kind, name):
    refused(name + kind, "no luminaire")


@pytest.mark.parametrize("name", ["x" * 300 + ".toml", "a\0b.toml", "."])
def test_paths_of_overrides_that_cannot_be(mi, tmp_path, name):
    from lumitree.lamp.source import LuminaireSource

    (tmp_path / "lamp.obj").write_text(OBJ)
    refused(LuminaireSource(str(tmp_path / "lamp.obj"), name), "expected a TOML file of overrides")


def test_text_of_scenes(mi, tmp_path):
    path = tmp_path / "lamp.xml"
    text = xml(SHAPE.format(name="Küche"))
    path.write_bytes(text.encode("latin-1"))
    refused(path, "not valid UTF-8")
    for encoding in ("iso-8859-1", "utf-8", "utf-16"):
        head = f'<?xml version="1.0" encoding="{encoding}"?>'
        path.write_bytes((head + text).encode(encoding))
        assert load_luminaire(path).num_emitters == 1


def test_escape_codes_and_long_names_of_plugins(mi, tmp_path):
    path = tmp_path / "lamp.xml"
    path.write_text(xml(SHAPE.format(name="a").replace("sphere", "x" * 100_000)))
    refused(path, "lamp.xml cannot be loaded")
    path.write_text(xml(SHAPE.format(name="a").replace("sphere", "&#27;[31m")))
    refused(path, "lamp.xml cannot be loaded")


@pytest.mark.parametrize(
    ("data", "match"),
    [
        ("up = 'Küche'".encode("latin-1"), "is not valid TOML in UTF-8"),
        (b"up = " + b"[" * 100_000, "is not valid TOML"),
        (b"up = " + b"[" * 200 + b"]" * 200, r"up is '\[\["),
        (b"up = '" + b"x" * 10_000 + b"'", "up is 'xxx"),
        (b"x" * 10_000 + b" = 1", "unknown key 'xxx"),
        (b'"\\u001b[31m" = 1', r"unknown key '\?\[31m'"),
        (b"[material." + b"x" * 10_000 + b"]\nglass = 1", "material.xxx"),
        (b"material.a = [" + b"1, " * 10_000 + b"]", "material.a is"),
        (b"units = " + b"9" * 4000, "units is"),
        (b"units = " + b"9" * 5000, "is not valid TOML"),
        (b"[material.nothing]\nopacity = 1", "no material is called 'nothing'"),
        (b'[material."\\u001b' + b"x" * 1000 + b'"]\nopacity = 1', "no material is called"),
    ],
)
@pytest.mark.filterwarnings("ignore::lumitree.errors.LumitreeWarning")
def test_overrides(mi, tmp_path, data, match):
    (tmp_path / "lamp.obj").write_text(OBJ)
    (tmp_path / "lamp.toml").write_bytes(data)
    refused(tmp_path / "lamp.obj", match)


def test_files_named_by_a_scene(mi, tmp_path):
    mesh = SHAPE.format(name="a").replace(
        "<bsdf", '<string name="filename" value="{}"/><bsdf'
    ).replace("sphere", "ply")  # fmt: skip
    path = tmp_path / "lamp.xml"
    os.mkdir(tmp_path / "folder.ply")
    for name in ("x" * 300 + ".ply", "folder.ply", "none.ply"):
        path.write_text(xml(mesh.format(name)))
        refused(path, "lamp.xml cannot be loaded")
