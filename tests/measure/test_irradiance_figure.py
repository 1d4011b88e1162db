"""The sheet of the irradiance: its tiles show what they say, as seen from the lamp."""

import io

import matplotlib as mpl
import numpy as np
import pytest
from PIL import Image

from lumitree.core.photometry import LUMENS_PER_WATT
from lumitree.measure import irradiance_figure
from lumitree.measure.batches import BATCHES
from lumitree.measure.irradiance import (
    CUBE_HALF_SIDE,
    FACES,
    PATCHES,
    Irradiance,
    IrradianceEvaluation,
    irradiance_error,
)
from lumitree.measure.irradiance_figure import draw_irradiance, irradiance_layout

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
    """Of irradiance [7, P, P], lx, without noise."""
    first, second = (
        Irradiance(np.tile(lux[None, ..., None] / LUMENS_PER_WATT, (BATCHES, 1, 1, 1, 3)))
        for lux in (explicit, baked)
    )
    return IrradianceEvaluation(1 << 20, first, second, irradiance_error(second, first))


def flat(*lux):
    """[7, P, P] of faces of uniform irradiance."""
    return np.tile(np.reshape(lux, (7, 1, 1)).astype(float), (1, PATCHES, PATCHES))


def colour(image, row, column):
    """Colour of a tile of one colour."""
    layout = irradiance_layout()
    left, top, end = layout.left(column) + 2, layout.top(row) + 2, layout.tile - 4
    pixels = np.asarray(image)[top : top + end, left : left + end, :3].reshape(-1, 3)
    assert (pixels == pixels[0]).all()
    return pixels[0]


def test_tiles_show_irradiance_and_its_relative_difference(mi):
    explicit = flat(100, 200, 50, 0, 200, 20, 4000)
    baked = flat(110, 200, 40, 10, 240, 20, 3600)
    sheet = draw_irradiance(evaluation(explicit, baked), "lamp")
    with Image.open(io.BytesIO(sheet.png())) as image:
        assert image.size == irradiance_layout().size
        shown = np.array([[colour(image, row, face) for face in range(7)] for row in range(3)])
    light, difference = mpl.colormaps["viridis"], mpl.colormaps["RdBu_r"]
    expected = [
        [light(value) for value in (0.5, 1.0, 0.25, 0.0, 1.0, 0.1, 1.0)],
        [light(value) for value in (0.55, 1.0, 0.2, 0.05, 1.0, 0.1, 0.9)],
        [difference((value + 0.2) / 0.4) for value in (0.1, 0.0, -0.2, 1.0, 0.2, 0.0, -0.1)],
    ]
    expected[2][3] = (0.75, 0.75, 0.75, 1)
    assert np.abs(shown - 255 * np.array(expected)[..., :3]).max() < 4
    assert {"mean 100 lx", "mean 4 klx", "ratio 1.100 ± 0.000", "ratio not known"} < {*sheet.texts}
    assert {"RMS error 10.0 ± 0.0 %", "RMS error 20.0 ± 0.0 %", "face -x"} < {*sheet.texts}


@pytest.mark.parametrize("face", FACES)
def test_faces_are_seen_from_the_lamp(mi, face):
    forward, up = np.array(UP[face])
    right = np.cross(forward, up)
    axis = int(np.flatnonzero(forward)[0])
    steps = (np.arange(PATCHES) + 0.5) * 2 * CUBE_HALF_SIDE / PATCHES - CUBE_HALF_SIDE
    points = np.insert(np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1), axis, 0, -1)
    columns = irradiance_figure._seen(face, points @ right)
    rows = irradiance_figure._seen(face, points @ up)
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
    assert draw_irradiance(found, "dark").texts.count("RMS error not known") == 7
