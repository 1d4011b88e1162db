"""View transforms: AgX against published values, and plain sRGB."""

import numpy as np
import pytest

from lumitree.core.images import tonemap
from lumitree.rendering.view_transform import Look, agx, displayed

# Linear sRGB before and after AgX as Filament and three.js 0.160 have it, without a look and with
# "punchy" as B. Wrensch published it. Their curve is a polynomial, which differs from the curve
# that AgX defines: by up to 0.018 here.
PUBLISHED = [
    ((0.18, 0.18, 0.18), (0.2145, 0.2145, 0.2145), (0.1252, 0.1251, 0.1252)),
    ((1, 1, 1), (0.5902, 0.5901, 0.5901), (0.4908, 0.4907, 0.4907)),
    ((4, 4, 4), (0.8610, 0.8609, 0.8608), (0.8171, 0.8169, 0.8169)),
    ((1, 0, 0), (0.7233, 0.1058, 0.0667), (0.8318, 0.0, 0.0)),
    ((0, 0, 5), (0.2761, 0.4454, 1.0), (0.0878, 0.3304, 1.0)),
    ((0.5, 0.2, 0.05), (0.4448, 0.2331, 0.1010), (0.3960, 0.1269, 0.0112)),
    ((16, 8, 2), (1.0, 0.9357, 0.8389), (1.0, 0.9105, 0.7373)),
    ((0.01, 0.02, 0.03), (0.0059, 0.0193, 0.0327), (0.0, 0.0051, 0.0126)),
]


@pytest.mark.parametrize(("colour", "base", "punchy"), PUBLISHED)
def test_agx_shows_the_published_colours(colour, base, punchy):
    linear = np.array(colour, float)
    assert agx(linear, Look(1, 1)) == pytest.approx(base, abs=0.018)
    assert agx(linear) == pytest.approx(punchy, abs=0.018)


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
