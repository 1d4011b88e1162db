"""The preview's sheet: what is seen from where, its sizes, its labels."""

import dataclasses

import numpy as np
import pytest

from lumitree.core.images import tonemap
from support.figures import texts, tile_pixels
from support.lamps import AREA, cube, lamp_of, sphere
from support.slow import slow

# A lit ball to the right, above and in front of the middle of a box of side 4.
BALL = (1.0, 0.5, 1.5)
WALLS = cube("box", 2, inside='<bsdf type="null"/>')


@pytest.fixture
def preview(mi, tmp_path):
    from lumitree.measure.preview import take_preview

    def take(*shapes, resolution=48):
        return take_preview(lamp_of(tmp_path, *shapes), resolution, 4)

    return take


def test_every_view_is_taken_from_where_it_says(preview):
    x, y, z = BALL
    # Right and up in the picture.
    expected = {
        "from the front, +z": (x, y),
        "from the right, +x": (-z, y),
        "from the back, -z": (-x, y),
        "from the left, -x": (z, y),
        "from above, +y": (x, -z),
        "from below, -y": (x, z),
    }
    pictures = preview(sphere("ball", 0.3, BALL, AREA), WALLS).images
    assert list(pictures) == list(expected)
    pixel = 2 * 2 * np.sqrt(3) / 48
    for name, picture in pictures.items():
        row, column = np.argwhere(picture.radiance[..., 0] > 2.9).mean(axis=0)
        place = (column - 23.5) * pixel, (23.5 - row) * pixel
        assert place == pytest.approx(expected[name], abs=0.05), name


@pytest.mark.parametrize(("resolution", "side"), [(16, 192), slow(700, 640)])
def test_views_show_pixels_one_to_one_where_legible(resolution, side):
    from lumitree.measure.preview import VIEWS, Preview, draw_preview
    from lumitree.trace.cameras import ViewImages

    opacity = np.ones((resolution, resolution), np.float32)
    radiance = np.repeat(opacity[..., None], 3, axis=-1)
    views = dict.fromkeys(VIEWS, ViewImages(radiance, opacity, opacity))
    sheet = draw_preview(Preview(views, [tonemap(radiance)] * 6), "lamp", [])
    box = sheet.axes[0].get_window_extent()
    assert (box.width, box.height) == pytest.approx((side, side))


def test_sheet_shows_soft_light_radiance_twice_and_both_opacities(preview):
    from lumitree.measure.preview import draw_preview

    taken = preview(sphere("lamp", 1, inside=AREA))
    sheet = draw_preview(taken, "lamp", ["1 emitter"])
    assert taken.exposure == pytest.approx(0.3)
    colours = [
        tonemap(np.array([3, 2, 1]), 2 * 0.3),
        tonemap(np.array([3, 2, 1]), 0.3),
        tonemap(np.array([3, 2, 1]), 0.3 * 2**taken.more_stops),
        [255, 255, 255],
        [255, 255, 255],
    ]
    for row, colour in enumerate(colours):
        for column in range(6):
            middle = tile_pixels(sheet, 6 * row + column)[94, 94].astype(float)
            assert np.abs(middle - colour).max() <= 4
    backdrop = tile_pixels(sheet, 5)[3, 3].astype(int)
    assert np.abs(backdrop - tonemap(np.array(0.125))).max() <= 1
    assert tile_pixels(sheet, 29)[3, 3].tolist() == [0, 0, 0]


def test_labels(preview):
    from lumitree.measure.preview import VIEWS, draw_preview

    taken = preview(sphere("lamp", 1, inside=AREA), sphere("dark", 0.5, (4, 0, 0)))
    shown = texts(draw_preview(taken, r"a $lamp_{", ["2 shapes", "12 lm"]))
    rows = [
        "in soft light",
        "radiance",
        f"radiance, {taken.more_stops} stops brighter",
        "geometric opacity",
        "straight-through opacity",
    ]
    facts = f"2 shapes   ·   12 lm   ·   EV {taken.ev:.1f} in all views"
    assert {r"a $lamp_{", facts, *VIEWS, *rows} == {*shown}


def test_the_brighter_row_brings_what_is_lit_to_middle_grey():
    from lumitree.measure.preview import Preview
    from lumitree.trace.cameras import ViewImages

    radiance = np.zeros((10, 10, 3), np.float32)
    radiance[:9] = 0.01
    radiance[0] = 50.0
    opacity = np.ones((10, 10), np.float32)
    preview = Preview({"a": ViewImages(radiance, opacity, opacity)}, [])
    assert preview.exposure == pytest.approx(0.9 / 50)
    # 0.01 is to become 0.18: 1000 times the exposure of what emits.
    assert preview.more_stops == 10
    black = Preview({"a": ViewImages(np.zeros_like(radiance), opacity, opacity)}, [])
    assert (black.exposure, black.more_stops) == (pytest.approx(1), 2)
    darker = dataclasses.replace(preview, exposed=-1.0)
    assert darker.ev == pytest.approx(preview.ev + 1)
    assert darker.exposure == pytest.approx(0.45 / 50)
    assert dataclasses.replace(preview, exposed="ev=3").ev == 3
