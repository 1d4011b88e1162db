"""The files on which a luminaire depends."""

from pathlib import Path

import pytest

from lumitree.lamp.luminaire import load_luminaire, source_files
from lumitree.lamp.source import LuminaireSource
from support.lamps import AREA, scene, sphere

TRIANGLE = "v 0 0 0\nv 0 0 1\nv 1 0 0\nf 1 2 3\n"
SPECTRUM = '<emitter type="area"><spectrum name="radiance" filename="light.spd"/></emitter>'


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch, mi):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mesh").mkdir()
    (tmp_path / "mesh" / "triangle.obj").write_text(TRIANGLE)
    (tmp_path / "light.spd").write_text("400 1\n700 2\n")
    (tmp_path / "inner.xml").write_text(scene(sphere("inner", 0.1, inside=SPECTRUM)))
    return tmp_path


def files(text, **options):
    """Names of the files of a scene, relative to its folder."""
    Path("lamp.xml").write_text(text)
    source = LuminaireSource("lamp.xml", **options)
    found = source_files(source, load_luminaire(source))
    return (
        None if found is None else {str(path.resolve().relative_to(Path.cwd())) for path in found}
    )


def test_scenes_name_meshes_spectra_and_other_scenes():
    mesh = '<shape type="obj"><string name="filename" value="mesh/triangle.obj"/></shape>'
    assert files(scene(sphere("a", 1, inside=AREA))) == {"lamp.xml"}
    assert files(scene(sphere("a", 1, inside=SPECTRUM))) == {"lamp.xml", "light.spd"}
    found = files(scene(mesh, '<include filename="inner.xml"/>'))
    assert found == {"lamp.xml", "mesh/triangle.obj", "inner.xml", "light.spd"}


@pytest.mark.parametrize(
    "includes",
    [
        '<path value="parts"/><include filename="inner.xml"/>',
        '<default name="part" value="parts/inner"/><include filename="$part.xml"/>',
    ],
)
def test_a_scene_of_another_folder_belongs_to_the_fingerprint(folder, includes):
    (folder / "parts").mkdir()
    fingerprints = []
    for radius in (0.1, 0.2, 0.1):
        inner = scene(sphere("inner", radius, inside=AREA))
        (folder / "parts/inner.xml").write_text(inner)
        (folder / "lamp.xml").write_text(scene(includes))
        fingerprints.append(load_luminaire("lamp.xml").fingerprint)
    assert fingerprints[0] == fingerprints[2] != fingerprints[1]


def test_files_that_parameters_name_are_not_known():
    shape = sphere("a", "$r", inside=AREA)
    assert files(scene('<default name="r" value="1"/>', shape)) is None
    assert files(scene('<path value="mesh"/>', sphere("a", 1, inside=AREA))) is None


def test_built_in_luminaires_have_no_files():
    assert source_files(LuminaireSource("bulbs"), None) is None


def test_photometric_files_are_their_own():
    assert source_files(LuminaireSource("a.ies"), None) == [Path("a.ies")]
    assert source_files(LuminaireSource("a.gldf#one"), None) == [Path("a.gldf")]


def test_models_depend_on_overrides_also_if_there_are_none(folder):
    (folder / "lamp.obj").write_text("mtllib lamp.mtl\nusemtl light\n" + TRIANGLE)
    (folder / "lamp.mtl").write_text("newmtl light\nKe 5 5 5\nmap_Kd missing.png\n")
    source = LuminaireSource("lamp.obj")
    with pytest.warns(UserWarning, match="missing.png"):
        luminaire = load_luminaire(source)
    found = source_files(source, luminaire)
    names = sorted(path.name for path in found)
    assert names == ["lamp.mtl", "lamp.obj", "lamp.toml", "missing.png"]
    chosen = LuminaireSource("lamp.obj", materials="other.toml")
    (folder / "other.toml").write_text('units = "cm"\n')
    with pytest.warns(UserWarning, match="missing.png"):
        luminaire = load_luminaire(chosen)
    assert Path("other.toml") in source_files(chosen, luminaire)
