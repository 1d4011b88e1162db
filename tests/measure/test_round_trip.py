"""A file, the asset that it becomes, and the file that photometry writes of it."""

import json
import math

import numpy as np
import pytest

import lumitree
from lumitree.cli import main
from lumitree.core.frames import LocalFrame
from lumitree.errors import LumitreeWarning
from lumitree.formats.ies import read_ies, write_ies
from lumitree.formats.ldt import read_ldt, write_ldt
from lumitree.formats.opening import Opening
from lumitree.formats.tm33 import read_tm33
from lumitree.formats.type_c import IntensityDistribution, direction_of
from lumitree.measure.far_field import (
    ExactLight,
    exact_grid,
    file_light,
    light_field_light,
    upward_share,
)
from support.photometric_types import ies, world
from support.slow import slow
from support.tm33_files import table, tm33

PATHS = 1 << 14
# Largest error of an intensity, over the largest intensity.
TOLERANCE = 0.005


def lobe(direction, axis, beam):
    """A lobe of a beam angle, degrees, between half values."""
    sharpness = np.log(2) / (1 - np.cos(np.deg2rad(beam / 2)))
    return np.exp(sharpness * (direction @ np.array(axis) / np.linalg.norm(axis) - 1))


def narrow_beam(direction):
    return 10_000 * lobe(direction, (0.3, -1, 0.2), 10)


def street_light(direction):
    """Two lobes along the street and a wide one, cut off above."""
    cut_off = 1 / (1 + np.exp(40 * np.clip(direction[..., 1] + 0.12, -1.5, 1.5)))
    along = 900 * lobe(direction, (0.85, -0.45, -0.3), 36)
    back = 800 * lobe(direction, (-0.8, -0.5, -0.35), 33)
    return (along + back + 250 * lobe(direction, (0, -1, -0.3), 80)) * cut_off


def floodlight(direction):
    """A spot in a wide and flat beam."""
    x, y, z = np.moveaxis(direction, -1, 0)
    flat = np.exp(-((x / 0.5) ** 2) - ((z + 0.15) / 0.12) ** 2) * (y < 0)
    return 20_000 * lobe(direction, (0.25, -1, 0.1), 18) + 6000 * flat


CIRCLE, HALF = np.arange(0, 361, 1.0), np.arange(-90, 91, 1.0)
CASES = {
    "narrow beam": (narrow_beam, "C", CIRCLE, np.arange(0, 91, 0.5)),
    "street light": (street_light, "C", np.arange(0, 361, 2.5), np.arange(0, 181, 2.5)),
    "floodlight of Type B": (floodlight, "B", HALF, HALF),
}


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [slow("narrow beam"), "street light", slow("floodlight of Type B")]
)
def test_intensities_there_and_back(mi, tmp_path, name):
    """Against what the file was sampled from, at its angles: by the file, and by its asset."""
    light, kind, horizontal, vertical = CASES[name]
    direction = world(kind, horizontal, vertical)
    exact = light(direction)
    (tmp_path / "a.ies").write_text(ies(kind, horizontal, vertical, exact))
    lamp, asset = read_ies(tmp_path / "a.ies"), lumitree.load(tmp_path / "a.ies")
    for known in (file_light(lamp, asset.frame), light_field_light(asset)):
        grid, intensity = exact_grid(known, asset.frame, None)
        found = IntensityDistribution("found", grid.c, grid.gamma, intensity)
        write_ies(tmp_path / "b.ies", found)
        write_ldt(tmp_path / "b.ldt", found)
        for again in (read_ies(tmp_path / "b.ies"), read_ldt(tmp_path / "b.ldt")):
            assert np.abs(again.at(direction) - exact).max() < TOLERANCE * exact.max()
            assert again.lumens == pytest.approx(lamp.lumens, rel=1e-3)


@pytest.mark.parametrize(("first", "share"), [(0.0, 0.0), (90.0, 1.0)])
def test_light_of_one_half_has_the_angles_of_its_file(mi, tmp_path, first, share):
    gamma = first + np.arange(0, 91, 10)
    candela = 100 * np.abs(np.cos(np.deg2rad(gamma)))
    (tmp_path / "a.ies").write_text(ies("C", np.zeros(1), gamma, candela[None]))
    lamp, frame = read_ies(tmp_path / "a.ies"), lumitree.load(tmp_path / "a.ies").frame
    light = file_light(lamp, frame)
    grid, intensity = exact_grid(light, frame, None)
    assert grid.step == 10
    assert intensity.max() == pytest.approx(100)
    assert upward_share(light, frame) == share


@pytest.mark.slow
def test_angles_finer_than_any_grid_are_told(mi, tmp_path):
    gamma = np.concatenate([np.arange(0, 2, 0.2), np.arange(2, 91, 2.0)])
    (tmp_path / "a.ies").write_text(ies("C", np.zeros(1), gamma, np.exp(-(gamma**2))[None]))
    with pytest.warns(LumitreeWarning, match="as little as 0.2 degrees apart"):
        assert lumitree.photometry(tmp_path / "a.ies", paths=PATHS).step == 0.5


STATED = (
    "IES:LM-63-2019\n[TEST] own\nTILT=NONE\n1 1000 1 3 1 1 2 -0.2 -0.2 0\n1 1.10100 10\n"
    "0 45 90\n0\n100 70 0\n"
)
GAMMA = np.arange(0, 91, 15.0)


@pytest.mark.slow
def test_what_a_file_states_is_shown_and_kept(mi, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.ies").write_text(STATED)
    title = "Test at an accredited lab that has been lumen scaled"
    assert main(["info", "a.ies", "--json", "info.json"]) == 0
    assert title in capsys.readouterr().out
    report = json.loads((tmp_path / "info.json").read_text())["asset"]
    assert report["file_generation_type"] == title
    assert report["format"] == "IES LM-63-2019"
    command = ["photometry", "a.ies", "-o", "b.ies", "-o", "b.ldt", "--paths", str(PATHS)]
    assert main(command) == 0
    shown = capsys.readouterr().out
    assert f"file generation type  {title}\n" in shown
    lumens = read_ies("a.ies").lumens
    assert f"light output ratio  {lumens / 10:.4g}" in shown
    for again in (read_ies("b.ies"), read_ldt("b.ldt")):
        # The file's own intensities, on the coarsest grid that has its angles.
        candela = np.interp(GAMMA, [0, 45, 90], [100, 70, 0])
        assert again.at(direction_of(30, GAMMA)) == pytest.approx(candela, abs=1e-4)
        assert len(again.gamma) == 37
        assert again.opening == Opening((0.2, 0, 0.2), "cylinder")
        assert again.emitted_lumens == 1000
    # It is no simulation of a lamp, and no measurement either.
    assert read_ies("b.ies").details["file_generation_type"] == "Undefined"
    lumitree.photometry(lumitree.load("a.ies"), "c.ies", step=5, paths=PATHS)
    assert read_ies("c.ies").details["file_generation_type"] == "Computer Simulation"


def test_luminaire_data_keep_their_intensities_opening_and_colour(mi, tmp_path):
    c, gamma = np.arange(0, 360, 30.0), np.arange(0, 181, 5.0)
    spectrum = "".join(f'<PwrData w="{w}">{p}</PwrData>' for w, p in [(600, 1), (700, 1)])
    spectrum = f"<SpectralData><EmitterSpectral>{spectrum}</EmitterSpectral></SpectralData>"
    (tmp_path / "a.tm33").write_text(tm33(table(c, gamma), after=spectrum))
    given, colour = read_tm33(tmp_path / "a.tm33")
    result = lumitree.photometry(tmp_path / "a.tm33", tmp_path / "b.ies", paths=PATHS)
    found = read_ies(tmp_path / "b.ies")
    assert result.step == 5
    direction = direction_of(c[:, None], gamma)
    assert found.at(direction) == pytest.approx(given.at(direction), abs=1e-3)
    assert found.opening == given.opening
    assert found.details["file_generation_type"] == "Undefined"
    assert colour[0] > 2
    assert result.colour_temperature is None or result.colour_temperature.value < 1500


@pytest.mark.parametrize(("resolution", "step"), [(16, 5.0), (32, 2.5), (64, 1.0), (128, 0.5)])
def test_the_step_of_traced_light_is_at_most_half_a_bin(resolution, step):
    width = math.degrees(math.sqrt(4 * math.pi) / resolution)
    light = ExactLight(lambda direction: 1 + 0 * direction[:, 0], np.ones(3), width)
    grid, intensity = exact_grid(light, LocalFrame(np.ones(3), np.eye(4)), None)
    assert grid.step == step <= width / 2
    assert intensity == pytest.approx(np.ones((len(grid.c), len(grid.gamma))))
