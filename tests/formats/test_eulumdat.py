"""EULUMDAT files against the reader of eulumdat-py, and what its fields change."""

import contextlib

import numpy as np
import pytest

from lumitree.errors import LumitreeError, LumitreeWarning
from lumitree.formats.ldt import ldt_of, read_ldt, write_ldt
from lumitree.formats.opening import Opening
from lumitree.formats.type_c import IntensityDistribution, direction_of

PLANES, ROWS = 24, 19
# Indices of the planes that each symmetry stores.
STORED = {
    0: np.arange(24),
    1: np.arange(1),
    2: np.arange(13),
    3: np.arange(18, 31) % 24,
    4: np.arange(7),
}
C, GAMMA = 15.0 * np.arange(PLANES), 10.0 * np.arange(ROWS)


def text_of(symmetry, values, sets=((1, 2000.0),), heights=(0, 0, 0, 0), size=(100, 50), **fields):
    """A file; `fields` replaces lines 22 to 25 by their names."""
    named = {"dff": 50, "lorl": 0, "factor": 1, "tilt": 0, **fields}
    lines = ["own", 1, symmetry, PLANES, 15, ROWS, 10, "rep", "case", "no", "file", "date"]
    lines += [100, 50, 80, *size, *heights, *named.values(), len(sets)]
    for number, flux in sets:
        lines += [number, "LED", flux, 3000, 80, 10]
    lines += [0.5] * 10 + [*C, *GAMMA, *values.ravel()]
    return "\n".join(map(str, lines)) + "\n"


def read(tmp_path, text):
    path = tmp_path / "lamp.ldt"
    path.write_text(text)
    return read_ldt(path)


def intensities(planes, seed=0):
    """Random cd per 1000 lm, with one number at each pole."""
    values = 100 * np.random.default_rng(seed).random((planes, ROWS))
    values[:, 0], values[:, -1] = 50, 20
    return values


@pytest.mark.parametrize("symmetry", STORED)
@pytest.mark.parametrize("factor", [1, 0.8])
def test_every_symmetry_by_another_reader(tmp_path, symmetry, factor):
    pyldt = pytest.importorskip("pyldt")
    text = text_of(symmetry, intensities(len(STORED[symmetry])), factor=factor)
    lamp = read(tmp_path, text)
    other = pyldt.LdtReader.read(tmp_path / "lamp.ldt")
    # It expands symmetries and applies no factors.
    expected = np.array(other.intensities) * 2000 / 1000 * factor
    assert expected.shape == (PLANES, ROWS)
    found = lamp.at(direction_of(C[:, None], GAMMA))
    assert found[:, 1:-1] == pytest.approx(expected[:, 1:-1])
    assert len(np.unique(expected[:, 5].round(6))) == (1 if symmetry == 1 else len(
        STORED[symmetry]))  # fmt: skip


@pytest.mark.parametrize(
    ("sets", "emitted", "message"),
    [
        (((1, 2000.0),), 2000, None),
        (((3, 2000.0),), 2000, None),
        (((1, 2000.0), (2, 2000.0)), 2000, None),
        (((1, 2000.0), (2, 3500.0)), 2000, "2 sets of lamps, of 2000, 3500 lm; the first"),
        # Absolute photometry.
        (((-1, 2000.0),), None, None),
        (((-4, 2000.0),), None, None),
    ],
)
def test_sets_of_lamps(tmp_path, sets, emitted, message):
    """Intensities are per 1000 lm of all lamps of a set."""
    values = intensities(24)
    said = pytest.warns(LumitreeWarning, match=message) if message else contextlib.nullcontext()
    with said:
        lamp = read(tmp_path, text_of(0, values, sets))
    assert lamp.at(direction_of(C, 60.0)) == pytest.approx(2 * values[:, 6])
    assert lamp.emitted_lumens == emitted
    kind = "absolute" if emitted is None else "relative"
    assert lamp.details["photometry"] == f"{kind}, symmetry 0"


def test_a_light_output_ratio_that_disagrees_is_said(tmp_path):
    values = np.full((24, ROWS), 60.0)
    percent = 100 * 60 * 4 * np.pi / 1000
    for ratio, message in (
        (percent, None),
        (percent / 1.04, None),
        (0, None),
        (50, r"have 1507\.9\d* lm, but its lamps of 2000 lm with .* 50 % give 1000 lm"),
    ):
        said = pytest.warns(LumitreeWarning, match=message) if message else contextlib.nullcontext()
        with said:
            lamp = read(tmp_path, text_of(0, values, lorl=ratio))
        assert lamp.lumens == pytest.approx(20 * percent, rel=1e-3)
    with pytest.warns(LumitreeWarning, match=r"conversion factor of 0\.5 is applied"):
        lamp = read(tmp_path, text_of(0, values, lorl=percent, factor=0.5))
    assert lamp.lumens == pytest.approx(10 * percent, rel=1e-3)


@pytest.mark.parametrize(
    ("size", "heights", "opening"),
    [
        ((600, 200), (0, 0, 0, 0), Opening((0.2, 0, 0.6))),
        ((600, 200), (50, 50, 50, 50), Opening((0.2, 0.05, 0.6))),
        (
            (600, 200),
            (50, 0, 20, 0),
            Opening((0.2, 0.05, 0.6), heights=(0.05, 0, 0.02, 0)),
        ),
        ((300, 0), (0, 0, 0, 0), Opening((0.3, 0, 0.3), "cylinder")),
        ((300, 0), (40, 40, 40, 40), Opening((0.3, 0.04, 0.3), "cylinder")),
        (
            (300, 0),
            (40, 20, 0, 20),
            Opening((0.3, 0.04, 0.3), "cylinder", heights=(0.04, 0.02, 0, 0.02)),
        ),
        ((0, 0), (0, 0, 0, 0), Opening((0, 0, 0), "cylinder")),
    ],
)
def test_luminous_areas_are_read_and_written(tmp_path, size, heights, opening):
    """The length is along C = 90; a width of 0 means a round area."""
    lamp = read(tmp_path, text_of(0, intensities(24), size=size, heights=heights))
    assert (lamp.opening, lamp.watts) == (opening, 10)
    write_ldt(tmp_path / "again.ldt", lamp)
    again = read_ldt(tmp_path / "again.ldt")
    assert (again.opening, again.watts) == (opening, 10)


def test_heights_above_the_sides_are_refused():
    with pytest.raises(LumitreeError, match="luminous up to"):
        Opening((1, 1, 1), heights=(2, 0, 0, 0))


@pytest.mark.parametrize("step", [1, 2.5, 10, 12])
def test_the_downward_fraction_is_that_below_the_horizon(step):
    """An even source, and one that emits only downwards; also between nodes."""
    gamma = np.arange(0, 180 + step, step).clip(0, 180)
    even = IntensityDistribution("", np.zeros(1), gamma, np.ones((1, len(gamma))))
    assert ldt_of(even).header.dff == pytest.approx(50, abs=0.01)
    down = np.where(gamma < 60, 1.0, 0)[None]
    found = ldt_of(IntensityDistribution("", np.zeros(1), gamma, down))
    assert found.header.dff == pytest.approx(100, abs=0.01)
