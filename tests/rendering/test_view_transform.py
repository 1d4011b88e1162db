"""The exposure of a room, and what displays show of it."""

import numpy as np
import pytest

from lumitree.core.images import auto_exposure, tonemap
from lumitree.errors import LumitreeError
from lumitree.rendering import view_transform
from lumitree.rendering.view_transform import check_view, displayed, room_exposure

NEEDS_OPENCOLORIO = "the optional dependency filmic is not installed"


def test_the_log_average_of_a_room_becomes_the_key():
    """It averages blocks, so that it does not depend on noise; images may have odd sizes."""
    random = np.random.default_rng(0)
    grey = np.full((21, 35, 3), 0.02)
    assert room_exposure(grey) == pytest.approx(0.15 / 0.02)
    noisy = grey * random.exponential(size=(21, 35, 1))
    assert room_exposure(noisy) == pytest.approx(0.15 / 0.02, rel=0.05)
    halves = grey.copy()
    halves[:, 16:] *= 0.25
    share = 3 / 5  # of the columns of blocks
    assert room_exposure(halves) == pytest.approx(0.15 / 0.02 * 4**share)


def test_a_bright_lamp_hardly_changes_the_exposure():
    room = np.full((240, 320, 3), 0.02)
    with_lamp = room.copy()
    with_lamp[80:104, 120:160] = 1000.0
    assert room_exposure(with_lamp) > 0.85 * room_exposure(room)


def test_black_blocks_do_not_count():
    image = np.zeros((32, 32, 3))
    assert room_exposure(image) == 1
    image[:8, :8] = 0.3
    assert room_exposure(image) == pytest.approx(0.5)


def test_pixels_that_are_no_numbers_do_not_count():
    image = np.full((64, 64, 3), 0.2)
    expected = room_exposure(image)
    for value in (np.nan, np.inf, -np.inf):
        image[3, 4] = value
        assert room_exposure(image) == pytest.approx(expected, rel=0.01)
        assert auto_exposure(image) == pytest.approx(0.9 / 0.2)
    # Another image can be shown alike.
    for level in (1e-30, 1e30):
        check_view("standard", room_exposure(np.full((8, 8, 3), level)))


def test_the_standard_view_is_clipped_srgb():
    image = np.random.default_rng(0).uniform(0, 2, (5, 6, 3))
    assert np.array_equal(displayed(image, 0.7), tonemap(image, 0.7))


def test_the_filmic_view_keeps_greys_and_order_where_srgb_clips():
    pytest.importorskip("PyOpenColorIO", reason=NEEDS_OPENCOLORIO)
    levels = np.geomspace(0.01, 50, 40)
    shown = displayed(np.repeat(levels[None, :, None], 3, axis=2), 1.0, "filmic")[0]
    assert np.ptp(shown.astype(int), axis=1).max() <= 1
    steps = np.diff(shown[:, 0].astype(int))
    assert (steps >= 0).all()
    beyond = (levels > 1.2) & (levels < 10)
    assert np.unique(shown[beyond, 0]).size > 3
    assert np.unique(tonemap(levels[beyond])).size == 1


def test_views_are_checked(monkeypatch):
    check_view("standard")
    with pytest.raises(LumitreeError, match="expected standard, filmic"):
        check_view("neon")  # type: ignore[arg-type]
    monkeypatch.setitem(__import__("sys").modules, "PyOpenColorIO", None)
    view_transform._filmic.cache_clear()
    with pytest.raises(LumitreeError, match=r"lumitree\[filmic\]"):
        check_view("filmic")
    view_transform._filmic.cache_clear()
