"""`lumitree export` into a folder of IES files: flux, far field, places and errors."""

import numpy as np
import pytest

import lumitree
from benchmarks.exported_files.ies_folder import placed_profiles
from lumitree.asset.asset import light_field_asset
from lumitree.asset.light_field import make_light_field
from lumitree.cli import main
from lumitree.core.octahedral import bilinear_bins, middle_directions
from lumitree.core.photometry import luminance
from lumitree.exports.ies_folder import COLUMNS, PLACEMENT
from lumitree.rendering.asset_flux import asset_watts
from support.exported_lamps import FRAME, beam, lamp

pytestmark = pytest.mark.usefixtures("mi")


def read(folder):
    """Rows of the table, with the distribution of each file."""
    assert (folder / PLACEMENT).read_text(encoding="utf-8").startswith("# ")
    lights = placed_profiles(folder)
    assert tuple(lights[0][0]) == COLUMNS
    return lights


def number(row, *names):
    return np.array([float(row[name]) for name in names])


def lobes():
    """A lamp whose cells have a few broad lobes each, and colours."""
    random = np.random.default_rng(3)
    axes = random.normal(size=(6, 3, 3))
    axes /= np.linalg.norm(axes, axis=-1, keepdims=True)
    lobe = np.exp(4 * (np.einsum("ckx,bx->cbk", axes, middle_directions(16)) - 1))
    intensity = lobe @ random.random((3, 3)) + 0.05
    cells = np.array([[1, 2, 3], [6, 2, 3], [4, 4, 4], [5, 7, 0], [0, 0, 0], [2, 6, 7]])
    return light_field_asset(make_light_field(cells, intensity, 3), FRAME, "lobes")


def test_files_hold_the_flux_and_the_far_field(tmp_path):
    asset = lobes()
    result = lumitree.export(asset, tmp_path / "out", lights=6)
    lights = read(tmp_path / "out")
    assert result.lights == len(lights) == 6
    assert result.file == tmp_path / "out"
    assert sorted(result.files) == sorted((tmp_path / "out").iterdir())
    lumens = float(luminance(asset_watts(asset)))
    assert sum(found.lumens for _, found in lights) == pytest.approx(lumens, rel=1e-3)
    for row, found in lights:
        assert found.lumens == pytest.approx(float(row["flux_lm"]), rel=1e-3)
        assert luminance(number(row, "red", "green", "blue")) == pytest.approx(683, rel=1e-3)
    # The far field of the light field itself.
    directions = np.random.default_rng(2).normal(size=(4000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    expected = far_field(asset, directions)
    have = sum(found.at(directions) for _, found in lights)
    assert np.abs(have - expected).max() < 0.02 * expected.max()


def far_field(asset, directions):
    """Luminous intensity, cd, for directions of the file."""
    from lumitree.asset.light_field import unpack

    field = asset.light_field
    colours = unpack(field.intensity) * field.scale * asset.light_factors
    row = np.nonzero(np.unpackbits(field.lit, axis=1))[1]
    bins = field.resolution**2
    sums = np.stack([np.bincount(row, each, bins) for each in colours.T], axis=-1)
    index, weights = bilinear_bins(directions @ asset.frame.rotation, field.resolution)
    return (luminance(sums)[index] * weights).sum(axis=1) * asset.frame.scale**2


@pytest.mark.parametrize(("up", "gamma"), [("y", 180), ("z", 90)])
def test_light_upwards_is_at_gamma_180(tmp_path, mi, up, gamma):
    lumitree.export(beam(mi, (1e-3, 1, 1e-3)), tmp_path / "out", up=up)
    ((_, found),) = read(tmp_path / "out")
    plane, row = np.unravel_index(found.intensity.argmax(), found.intensity.shape)
    assert abs(found.gamma[row] - gamma) < 8
    if up == "z":
        # y of a frame with z up.
        assert abs(found.c[plane] - 90) < 8


def test_the_command_prints_units_orientation_and_the_folder(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    lumitree.save(lamp(), "lamp.lumitree")
    (tmp_path / "empty").mkdir()
    for output in ("empty", "new.v2/"):
        assert main(["export", "lamp.lumitree", "-o", output, "--lights", "3"]) == 0
        out = capsys.readouterr().out
        assert "note: the lamp itself is not shown" in out
        assert "metres; candela and lumens" in out
        assert "z is up" in out
        assert out.splitlines()[-1] == f"Open: {output.rstrip('/')}"
        assert len(list((tmp_path / output).iterdir())) == 4
