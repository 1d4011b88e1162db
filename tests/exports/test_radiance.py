"""`lumitree export` for Radiance: flux of the tables, and what Radiance makes of them."""

import os
import subprocess
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

import lumitree
from lumitree.core.octahedral import solid_angles
from lumitree.core.photometry import luminance
from lumitree.exports.radiance import EFFICACY, LUMA, radiance_intensity
from lumitree.rendering.asset_flux import asset_watts
from support.exported_lamps import FRAME, lamp

pytestmark = pytest.mark.usefixtures("mi")

found = find_spec("pyradiance")
needs_radiance = pytest.mark.skipif(found is None, reason="pyradiance is not installed")


def lumens(rgb):
    """Photometric values of Radiance's R, G and B."""
    return EFFICACY * (np.asarray(rgb) @ np.array(LUMA))


def radiance(folder, *command, text=""):
    """Output of one of Radiance's programs, from the package pyradiance."""
    home = Path(found.submodule_search_locations[0])
    path = f"{home / 'bin'}:{os.environ['PATH']}"
    environment = {**os.environ, "PATH": path, "RAYPATH": f".:{home / 'lib'}"}
    program = [str(home / "bin" / command[0]), *map(str, command[1:])]
    run = subprocess.run(
        program, cwd=folder, env=environment, input=text.encode(), capture_output=True
    )
    assert run.returncode == 0, run.stderr.decode()
    assert not run.stderr
    return run.stdout


def illuminance(folder, points, normals, *options):
    """Illuminance [N], lx, that rtrace computes."""
    rows = np.concatenate([points, normals], axis=1).tolist()
    text = "".join(" ".join(map(repr, row)) + "\n" for row in rows)
    out = radiance(folder, "rtrace", "-h", "-I", *options, "scene.oct", text=text)
    return lumens(np.array(out.split(), float).reshape(-1, 3))


def table(path):
    """Values [S, R + 2, R + 2] of a data file."""
    numbers = path.read_text().split()
    assert numbers[0] == "3"
    shape = [int(numbers[1 + 3 * i + 2]) for i in range(3)]
    return np.array(numbers[10:], float).reshape(shape)


def test_intensities_keep_their_lumens_and_their_colour():
    rgb = np.random.default_rng(1).exponential(size=(50, 3))
    converted = radiance_intensity(rgb)
    np.testing.assert_allclose(lumens(converted), luminance(rgb), rtol=1e-12)
    np.testing.assert_allclose(np.cross(rgb, converted), 0, atol=1e-12)
    assert radiance_intensity(np.zeros((1, 3))).tolist() == [[0, 0, 0]]


@pytest.mark.parametrize("count", [1, 5])
def test_tables_hold_the_flux(tmp_path, count):
    asset = lamp()
    result = lumitree.export(asset, tmp_path / "the lamp.rad", lights=count)
    # The digest of a name that not all files can have.
    side = tmp_path / "the_lamp-04410513_files"
    assert sorted(os.listdir(tmp_path)) == ["the lamp.rad", side.name]
    names = ("b.dat", "g.dat", "light.cal", "r.dat")
    assert result.files == [tmp_path / "the lamp.rad", *(side / name for name in names)]
    tables = np.stack([table(side / f"{each}.dat") for each in "rgb"], axis=-1)
    inner = tables[:count, 1:-1, 1:-1].reshape(count, -1, 3)
    flux = np.einsum("sbc,b->c", inner, solid_angles(8))
    assert lumens(flux) == pytest.approx(float(luminance(asset_watts(asset))), rel=1e-4)
    text = (tmp_path / "the lamp.rad").read_text()
    assert text.count(" sphere ") == result.lights == count
    radius = 1e-3 * FRAME.scale
    assert text.count(f"\n3 {1 / (np.pi * radius**2):.9g} ") == count


def received(mi, asset, points, normals):
    """Illuminance that lumitree itself computes, of a frame with y up."""
    from benchmarks.inside_box.received import received_irradiance

    scene = mi.load_dict({"type": "scene", "lamp": lumitree.shape(asset)})
    return luminance(received_irradiance(scene, points, normals, 1 << 14))


def z_up(vectors):
    x, y, z = np.transpose(vectors)
    return np.stack([x, -z, y], axis=-1)


@needs_radiance
@pytest.mark.parametrize("name", ["-y", "+x", "-z"])
def test_radiance_illuminates_planes_as_lumitree_does(mi, tmp_path, name):
    """At 1.5 times the box size from its centre; a light for each cell."""
    asset = lamp()
    lumitree.export(asset, tmp_path / "lamp.rad", lights=20)
    (tmp_path / "scene.oct").write_bytes(radiance(tmp_path, "oconv", "lamp.rad"))
    axis, sign = "xyz".index(name[1]), 1 if name[0] == "+" else -1
    size = 2 * FRAME.scale
    grid = (np.arange(8) + 0.5) / 4 - 1
    flat = np.stack(np.meshgrid(grid, grid), axis=-1).reshape(-1, 2) * size
    points = FRAME.centre + np.insert(flat, axis, sign * 1.5 * size, axis=1)
    normals = np.tile(np.insert([0.0, 0.0], axis, -sign), (len(points), 1))
    expected = received(mi, asset, points, normals)
    have = illuminance(tmp_path, z_up(points), z_up(normals), "-ab", 0, "-dt", 0)
    assert np.sqrt(np.mean((have - expected) ** 2) / np.mean(expected**2)) < 0.02
    assert have.mean() == pytest.approx(expected.mean(), rel=0.01)


HALF, GREY = 8.0, 0.3
