"""Grids of images, and files of figures."""

import io

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.colors import LogNorm, Normalize
from PIL import Image

from lumitree.rendering.drawing import (
    ColourScale,
    Panel,
    Tile,
    image_grid,
    luminance_png,
    pdf_file,
    text_page,
    write_strip,
)
from lumitree.rendering.photograph import PhotoSettings
from support.figures import texts, tile_pixels


def images(*shape):
    rng = np.random.default_rng(0)
    return [[Tile(rng.integers(0, 256, (*shape, 3), np.uint8), "a\nb") for _ in range(2)], [Tile(
        rng.integers(0, 256, (*shape, 3), np.uint8))]]  # fmt: skip


@pytest.mark.parametrize("shape", [(40, 60), (200, 100)])
def test_images_are_shown_pixel_by_pixel_in_their_places(shape):
    rows = images(*shape)
    sheet = image_grid(
        rows, shape[1], title="x", subtitle="y", columns=["a", "b"], names=["c", "d"]
    )
    for index, tile in enumerate([*rows[0], *rows[1]]):
        assert (tile_pixels(sheet, index) == tile.image[2:-2, 2:-2]).all()


def test_text_is_taken_literally_in_any_script():
    rows = [[Tile(np.zeros((4, 4, 3)), r"a$b_{")]]
    sheet = image_grid(rows, 40, title=r"lamp $\frac{ 100%", subtitle="$x{")
    sheet.png()
    assert {r"a$b_{", r"lamp $\frac{ 100%", "$x{"} <= {*texts(sheet)}
    assert image_grid(rows, 40, title="吊灯").png()
    assert pdf_file([text_page("吊灯", 0.5, [[("name", "1 $x{")]], ["note"])])[:5] == b"%PDF-"


def test_same_figure_gives_same_bytes_whatever_the_users_settings():
    first = image_grid(images(8, 8), 40, title="title").png("settings")
    with mpl.rc_context({"savefig.dpi": 30, "savefig.bbox": "tight", "figure.dpi": 50}):
        assert image_grid(images(8, 8), 40, title="title").png("settings") == first
    with Image.open(io.BytesIO(first)) as image:
        assert image.info["Comment"] == "settings"


@pytest.mark.parametrize(
    ("norm", "numbers"),
    [
        (LogNorm(1e-4, 1, clip=True), ["1e\N{MINUS SIGN}04", "1e\N{MINUS SIGN}02", "1"]),
        # Less than a decade has numbers too.
        (LogNorm(20, 80, clip=True), ["20", "30", "40", "60"]),
        (Normalize(0, 1), ["0.0", "0.4", "1.0"]),
    ],
)
def test_a_colour_bar_has_its_unit_and_numbers(norm, numbers):
    scale = ColourScale(norm, "gray", "light, lx")
    sheet = image_grid([[Tile(np.zeros((9, 9, 3)))]], 300, bars={0: scale})
    sheet.png()
    assert "light, lx" in texts(sheet)
    assert {*numbers} <= {*texts(sheet)}


def test_numbers_that_are_not_known_are_grey():
    scale = ColourScale(Normalize(0, 2), "gray", "")
    assert scale(np.array([[0, 2, np.nan]]))[0, :, 0].tolist() == [0, 1, 0.75]


def test_a_strip_has_rows(tmp_path):
    rng = np.random.default_rng(1)
    rooms = [Panel(f"room {number}", rng.random((30, 500, 3))) for number in range(3)]
    settings = PhotoSettings(exposure="ev=-9", view="srgb", white_balance="off")
    write_strip(tmp_path / "strip.png", rooms, settings, "made so", columns=2)
    with Image.open(tmp_path / "strip.png") as image:
        assert image.info["Comment"] == "made so"
        pixels = np.asarray(image)[..., :3]
    for corner, (_, radiance, _) in zip(((16, 16), (16, 522), (72, 16)), rooms, strict=True):
        row, column = corner
        shown = pixels[row : row + 30, column : column + 500]
        assert (shown == settings.photograph(radiance).pixels).all()


def test_luminances_that_are_no_numbers_are_shown_dark():
    values = np.full((64, 64), 0.2)
    expected = luminance_png(values)
    values[10, 10] = np.nan
    assert len(luminance_png(values)) > 0.8 * len(expected)
