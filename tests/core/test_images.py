"""The sRGB transfer function."""

import numpy as np
import pytest

from lumitree.core.images import linear_from_srgb, srgb_from_linear


@pytest.mark.parametrize(
    ("linear", "encoded"),
    [
        (0.0, 0.0),
        (0.0031308, 0.04045),
        (0.001, 0.01292),
        (0.214041, 0.5),
        (0.5, 0.735357),
        (1.0, 1.0),
    ],
)
def test_known_values(linear, encoded):
    assert srgb_from_linear(linear) == pytest.approx(encoded, abs=1e-6)
    assert linear_from_srgb(encoded) == pytest.approx(linear, abs=1e-6)


def test_round_trip():
    codes = np.arange(256)
    again = srgb_from_linear(linear_from_srgb(codes / 255)) * 255
    np.testing.assert_allclose(again, codes, atol=1e-4)
    linear = np.linspace(0, 1, 1001)
    np.testing.assert_allclose(linear_from_srgb(srgb_from_linear(linear)), linear, atol=1e-6)


def test_values_are_clipped_and_keep_their_precision():
    np.testing.assert_allclose(srgb_from_linear([-1.0, 2.0]), [0, 1], atol=1e-12)
    for dtype in (np.float32, np.float64):
        values = np.array([0.001, 0.5], dtype)
        assert srgb_from_linear(values).dtype == dtype
        assert linear_from_srgb(values).dtype == dtype
