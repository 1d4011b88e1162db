"""View transforms: AgX against published values, and plain sRGB."""

import numpy as np
import pytest

from lumitree.core.images import tonemap
from lumitree.rendering.view_transform import agx, displayed

# Linear sRGB before and after AgX as three.js 0.160 and Filament have it, whose curve is a
# polynomial: it differs from the curve that AgX defines by up to 0.013.
PUBLISHED = [
    ((0.18, 0.18, 0.18), (0.2145, 0.2145, 0.2145)),
    ((1, 1, 1), (0.5902, 0.5901, 0.5901)),
    ((4, 4, 4), (0.8610, 0.8609, 0.8608)),
    ((1, 0, 0), (0.7233, 0.1058, 0.0667)),
    ((0, 0, 5), (0.2761, 0.4454, 1.0)),
    ((0.5, 0.2, 0.05), (0.4448, 0.2331, 0.1010)),
    ((16, 8, 2), (1.0, 0.9357, 0.8389)),
    ((0.01, 0.02, 0.03), (0.0059, 0.0193, 0.0327)),
]


@pytest.mark.parametrize(("colour", "expected"), PUBLISHED)
def test_agx_shows_the_published_colours(colour, expected):
    assert agx(np.array(colour, float)) == pytest.approx(expected, abs=0.014)


def test_agx_keeps_greys_and_the_order_of_levels_far_beyond_white():
    levels = np.geomspace(1e-3, 15, 200)
    shown = agx(np.repeat(levels[:, None], 3, axis=1))
    assert np.ptp(shown, axis=1).max() < 2e-3
    assert (np.diff(shown[:, 0]) > 0).all()
    assert agx(np.array([np.nan, np.inf, -1.0])).shape == (3,)
    assert agx(np.zeros(3)) == pytest.approx(0)
    assert agx(np.full(3, 1e6)) == pytest.approx(1)


def test_srgb_is_clipped():
    image = np.random.default_rng(0).uniform(0, 2, (5, 6, 3))
    assert np.array_equal(displayed(image, "srgb"), tonemap(image))
    assert (displayed(image, "agx") != displayed(image, "srgb")).any()
