"""Polar curves of pages, against the intensities of a photometric file."""

import re

import numpy as np

import lumitree
from lumitree.viewer.polar import polar_svg
from support.fields import random_asset
from support.ies_text import ies_text


def test_a_polar_curve_has_the_intensities_of_its_file(mi, tmp_path):
    """100 cd straight down, more towards C = 0 than towards C = 180, and none upwards."""
    c, gamma = np.arange(0, 360, 15.0), np.append(np.arange(0, 91, 5.0), [90.1, 180])
    down = np.maximum(np.cos(np.deg2rad(gamma)), 0)
    values = np.outer(1 + 0.5 * np.cos(np.deg2rad(c)), 100 * down * np.sin(np.deg2rad(gamma)))
    path = tmp_path / "lamp.ies"
    path.write_text(ies_text(values + 100 * down, c, gamma, (0.1, 0.1, 0)))
    svg = polar_svg(lumitree.load(path))
    found = re.search(r">([\d.,]+) cd<", svg)
    assert found is not None
    largest = float(found[1].replace(",", ""))
    np.testing.assert_allclose(largest, (values + 100 * down).max(), rtol=0.02)
    curves = [
        np.array([point.split(",") for point in each.split()], float) * largest / 88
        for each in re.findall(r'points="([^"]*)"', svg)
    ]
    assert len(curves) == 2
    for curve, (right, left) in zip(curves, ((1.5, 0.5), (1.0, 1.0)), strict=True):
        # Right is the side of C, and down is down.
        for factor, at in ((right, 45), (left, 315)):
            expected = 100 * np.cos(np.pi / 4) * (1 + factor * np.sin(np.pi / 4))
            x, y = curve[at // 3]
            np.testing.assert_allclose(np.hypot(x, y), expected, rtol=0.02)
            assert (x > 0, y > 0) == (at == 45, True)
        np.testing.assert_allclose(curve[0], [0, 100], atol=2)
        assert np.abs(curve[180 // 3]).max() < 1
    page = lumitree.view(path).html
    assert svg in page


def test_without_a_light_field_there_is_no_curve():
    assert polar_svg(random_asset(0)) == ""
