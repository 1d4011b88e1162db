"""Sheets of views and of irradiance: their tiles show what they say."""

import math

import matplotlib as mpl
import numpy as np
import pytest

from lumitree.core.images import auto_exposure, tonemap
from lumitree.core.photometry import LUMENS_PER_WATT
from lumitree.measure import figures
from lumitree.measure.batches import BATCHES
from lumitree.measure.figures import SheetRow, draw_irradiance, draw_sheet
from lumitree.measure.irradiance import (
    CUBE_HALF_SIDE,
    FACES,
    PATCHES,
    Irradiance,
    IrradianceEvaluation,
    irradiance_error,
)
from support.figures import texts, tile_pixels

METRICS = {"psnr_linear": 31.234, "psnr_linear_black": 16.1, "opacity_rmse": 0.0123}


def test_views_show_what_they_say():
    reference, baked = np.full((16, 16, 3), [4.0, 2.0, 1.0]), np.full((16, 16, 3), [2.0, 1.0, 0.5])
    opacities = np.full((16, 16), 1.0), np.full((16, 16), 0.4)
    sheet = draw_sheet([SheetRow("view 1", reference, baked, *opacities, METRICS)], 4.0, "title")
    exposure = auto_exposure(reference)
    error = mpl.colormaps["inferno"](1 + math.log10(3.5 / 3 / 4) / 4)[:3]
    expected = [
        tonemap(reference, exposure)[0, 0],
        tonemap(baked, exposure)[0, 0],
        np.array(error) * 255,
        [255, 255, 255],
        [102, 102, 102],
    ]
    for column, colour in enumerate(expected):
        assert np.abs(tile_pixels(sheet, column) - np.asarray(colour, float)).max() <= 4
    assert {"view 1 (exposure 0.225)", "opacity_rmse 0.0123"} < {*texts(sheet)}
    assert "psnr_linear 31.23 dB (black 16.10)" in texts(sheet)


def test_black_and_overflowing_views():
    black, opacity = np.zeros((16, 16, 3)), np.zeros((16, 16))
    metrics = {"psnr_linear": 31.234, "opacity_rmse": 0.0123}
    rows = [
        SheetRow("a", black, baked, opacity, opacity, metrics) for baked in (black, black + 1e9)
    ]
    sheet = draw_sheet(rows, 1.0, "title")
    assert "psnr_linear 31.23 dB" in texts(sheet)
    assert tile_pixels(sheet, 2).max() < 5
    assert tile_pixels(sheet, 7).max() > 250


# Direction of each face from the lamp, and what is up in its image.
UP = {
    "-x": ((-1, 0, 0), (0, 1, 0)),
    "+x": ((1, 0, 0), (0, 1, 0)),
    "-y": ((0, -1, 0), (0, 0, -1)),
    "+y": ((0, 1, 0), (0, 0, 1)),
    "-z": ((0, 0, -1), (0, 1, 0)),
    "+z": ((0, 0, 1), (0, 1, 0)),
    "touching": ((0, -1, 0), (0, 0, -1)),
}


def evaluation(explicit, baked):
    """Evaluation of irradiance [7, P, P], lx, without noise."""
    first, second = (
        Irradiance(np.tile(lux[None, ..., None] / LUMENS_PER_WATT, (BATCHES, 1, 1, 1, 3)))
        for lux in (explicit, baked)
    )
    return IrradianceEvaluation(1 << 20, first, second, irradiance_error(second, first))


def flat(*lux):
    """[7, P, P] of faces of uniform irradiance."""
    return np.tile(np.reshape(lux, (7, 1, 1)).astype(float), (1, PATCHES, PATCHES))


def test_tiles_show_irradiance_and_its_relative_difference(mi):
    explicit = flat(100, 200, 50, 0, 200, 20, 4000)
    baked = flat(110, 200, 40, 10, 240, 20, 3600)
    sheet = draw_irradiance(evaluation(explicit, baked), "lamp")
    shown = [tile_pixels(sheet, index).reshape(-1, 3) for index in range(21)]
    assert all((pixels == pixels[0]).all() for pixels in shown)
    light, difference = mpl.colormaps["viridis"], mpl.colormaps["RdBu_r"]
    expected = [
        [light(value) for value in (0.5, 1.0, 0.25, 0.0, 1.0, 0.1, 1.0)],
        [light(value) for value in (0.55, 1.0, 0.2, 0.05, 1.0, 0.1, 0.9)],
        [difference((value + 0.2) / 0.4) for value in (0.1, 0.0, -0.2, 1.0, 0.2, 0.0, -0.1)],
    ]
    expected[2][3] = (0.75, 0.75, 0.75, 1)
    colours = np.array([pixels[0] for pixels in shown]).reshape(3, 7, 3)
    assert np.abs(colours - 255 * np.array(expected)[..., :3]).max() < 4
    assert {"mean 100 lx", "mean 4,000 lx", "ratio 1.100 ± 0.000"} < {*texts(sheet)}
    assert {"RMS error 10.0% ± 0.0%", "ratio not known", "face -x"} < {*texts(sheet)}


@pytest.mark.parametrize("face", FACES)
def test_faces_are_seen_from_the_lamp(mi, face):
    forward, up = np.array(UP[face])
    right = np.cross(forward, up)
    axis = int(np.flatnonzero(forward)[0])
    steps = (np.arange(PATCHES) + 0.5) * 2 * CUBE_HALF_SIDE / PATCHES - CUBE_HALF_SIDE
    points = np.insert(np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1), axis, 0, -1)
    columns = figures._seen(face, points @ right)
    rows = figures._seen(face, points @ up)
    assert (columns == steps).all()
    assert (rows == steps[::-1, None]).all()


def test_a_lamp_without_light_is_drawn(mi):
    dark = flat(*[0] * 7)
    found = evaluation(dark, dark)
    assert found.metrics == {}
    assert found.report()["ratio_error"] is None
    assert found.report()["faces"]["touching"] == {
        "explicit_lux": 0, "baked_lux": 0, "ratio": None, "ratio_error": None, "rms": None,
        "rms_error": None,
    }  # fmt: skip
    assert texts(draw_irradiance(found, "dark")).count("RMS error not known") == 7
