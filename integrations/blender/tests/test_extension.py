"""The extension for Blender: its archive, and what of it needs no Blender."""

import ast
import sys
import time
import tomllib
import zipfile

import numpy as np
import pytest

import lumitree
import make_archive
from lumitree_blender import light, model_file, program
from support.gltf_builder import Gltf


def test_the_manifest_is_one_of_blender_4_2(archive):
    with zipfile.ZipFile(archive) as found:
        names = set(found.namelist())
        manifest = tomllib.loads(found.read("blender_manifest.toml").decode())
        for name in names:
            if name.endswith(".py"):
                compile(found.read(name), name, "exec")
    assert {"__init__.py", "blackbody.json"} <= names
    assert manifest["schema_version"] == "1.0.0"
    assert manifest["id"].isidentifier()
    assert manifest["version"] == lumitree.__version__
    assert manifest["type"] == "add-on"
    assert manifest["blender_version_min"] == "4.2.0"
    assert manifest["license"] == ["SPDX:BSD-3-Clause"]
    assert {"name", "maintainer"} <= {key for key, value in manifest.items() if value}
    # Blender refuses longer texts, and those that end with punctuation.
    texts = [manifest["tagline"], *manifest["permissions"].values()]
    assert all(len(text) <= 64 and text[-1].isalnum() for text in texts)
    assert set(manifest["permissions"]) == {"files"}


def test_the_archive_in_the_package_is_up_to_date(archive):
    """If this fails, run `python integrations/blender/make_archive.py`."""
    assert make_archive.ARCHIVE.read_bytes() == archive.read_bytes()


def imported(path):
    """Names of the modules that a file imports, but for relative imports."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (name.name for name in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            yield node.module


def test_it_imports_the_standard_library_and_blender_alone():
    paths = make_archive.FOLDER.glob("*.py")
    found = {name.partition(".")[0] for path in paths for name in imported(path)}
    assert "bpy" in found
    assert found <= sys.stdlib_module_names | {"bpy", "bpy_extras", "mathutils"}


def test_factors_are_those_of_lumitree():
    from lumitree.core.photometry import luminance
    from lumitree.rendering.asset_flux import factors_to

    random = np.random.default_rng(0)
    for kelvin in [1000.0, 20000.0, *random.uniform(1000, 20000, 20)]:
        watts = random.uniform(0.1, 5, 3)
        tint = np.array(light.tint_for(watts.tolist(), kelvin))
        np.testing.assert_allclose(
            tint, factors_to(watts, None, kelvin, "lamp"), atol=1e-3 * tint.max()
        )
        found = light.lumens(watts.tolist(), tint.tolist(), 1.5, 2.0)
        assert found == pytest.approx(float(luminance(watts)) * 1.5 * 4, rel=1e-3)


def test_a_temperature_needs_light_in_its_channels():
    assert light.tint_for([1.0, 1.0, 0.0], 6500.0) is None
    # A black body of 1500 K is so red that its blue is clipped.
    assert light.tint_for([1.0, 1.0, 0.0], 1500.0)[2] == 0


def test_models_become_photometric_and_relative_to_a_point(tmp_path):
    from lumitree.lamp.importers.gltf import read_gltf

    gltf = Gltf()
    strong = {"KHR_materials_emissive_strength": {"emissiveStrength": 4.0}}
    gltf.json["extensionsUsed"] = list(strong)
    for extensions in ({}, strong):
        material = gltf.material(emissiveFactor=[1.0, 0.5, 0.25], extensions=extensions)
        # Where Blender has (3, -7, 5), with z up.
        gltf.quad(material, translation=[3.0, 5.0, 7.0])
    gltf.quad(gltf.material(), translation=[3.0, 5.0, 7.0])
    path = tmp_path / "lamp.glb"
    path.write_bytes(model_file.prepared(gltf.glb(), (3.0, -7.0, 5.0)))
    geometry = read_gltf(path)
    radiance = [material.radiance for material in geometry.materials]
    np.testing.assert_allclose(radiance[:2], [[1, 0.5, 0.25], [4, 2, 1]], rtol=1e-6)
    assert radiance[2] is None
    for part in geometry.parts:
        (place,) = part.places
        np.testing.assert_allclose(place[:3, 3], 0, atol=1e-6)


def test_closed_glass_is_solid_as_in_cycles(tmp_path):
    from lumitree.asset.materials import Dielectric, ThinDielectric
    from lumitree.lamp.importers.gltf import read_gltf

    gltf = Gltf()
    glass = {"KHR_materials_transmission": {"transmissionFactor": 1.0}}
    gltf.json["extensionsUsed"] = list(glass)
    material = gltf.material(
        pbrMetallicRoughness={"roughnessFactor": 0.0, "metallicFactor": 0.0}, extensions=glass
    )
    gltf.sphere(material)
    gltf.quad(material)
    path = tmp_path / "lamp.glb"
    path.write_bytes(model_file.prepared(gltf.glb(), (0.0, 0.0, 0.0)))
    geometry = read_gltf(path)
    surfaces = {each.name: each.surface for each in geometry.materials}
    ball, sheet = (surfaces[part.material] for part in geometry.parts)
    assert (type(ball), type(sheet)) == (Dielectric, ThinDielectric)


def python(code):
    return [sys.executable, "-c", code]


def test_commands_run_one_after_the_other(tmp_path):
    path = tmp_path / "written"
    first = python(f"open({str(path)!r}, 'w').write('first')")
    second = python(
        f"f = open({str(path)!r}, 'r+'); assert f.read() == 'first'; f.write(' second')"
    )
    program.Job([first, second], tmp_path / "log").wait()
    assert path.read_text() == "first second"


@pytest.mark.parametrize(
    ("code", "message"),
    [
        ("import sys; sys.exit('more\\nlumitree: error: no emitter\\n')", "no emitter"),
        ("import sys; sys.exit(3)", "lumitree ended with status 3"),
    ],
)  # fmt: skip
def test_a_program_that_fails_is_explained_by_its_last_line(tmp_path, code, message):
    never = python(f"open({str(tmp_path / 'never')!r}, 'w')")
    with pytest.raises(program.ExtensionError) as caught:
        program.Job([python(code), never], tmp_path / "log").wait()
    assert str(caught.value) == message
    assert not (tmp_path / "never").exists()


def test_a_job_shows_progress_and_can_be_ended(tmp_path):
    code = (
        "import sys, time; print('bake lamp: 40 %', file=sys.stderr, flush=True); time.sleep(600)"
    )
    job = program.Job([python(code), python("assert False")], tmp_path / "log")
    while "40 %" not in job.progress():
        assert not job.poll()
        time.sleep(0.01)
    assert job.progress().startswith("bake lamp: 40 % (")
    job.stop()
    job.stop()
    assert job._process.poll() is not None
    assert not job._commands


def test_programs_are_found(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(program.ExtensionError, match="lumitree was not found; install it"):
        program.find_program("")
    with pytest.raises(program.ExtensionError, match="/none is not a program"):
        program.find_program("/none")
    for name in ("lumitree", "python3"):
        (tmp_path / name).write_text("#!/bin/sh\n")
        (tmp_path / name).chmod(0o755)
    assert program.find_program("") == [str(tmp_path / "lumitree")]
    python3 = str(tmp_path / "python3")
    assert program.find_program(python3) == [python3, "-m", "lumitree"]
    with pytest.raises(program.ExtensionError, match="does not start"):
        program.Job([[str(tmp_path)]], tmp_path / "log")
