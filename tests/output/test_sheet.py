import dataclasses
import math
import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from PIL import Image

from lumitree.core.images import auto_exposure, tonemap
from lumitree.errors import LumitreeError
from lumitree.output import sheet
from lumitree.output.sheet import SheetRow, draw_sheet, relative_error, sheet_layout

METRICS = {"psnr_linear": 31.234, "opacity_rmse": 0.0123}


def row(height=32, width=32, **changes):
    rng = np.random.default_rng(0)
    radiance, opacity = rng.random((height, width, 3)), rng.random((height, width))
    made = SheetRow("view 100001", radiance, 0.9 * radiance, opacity, 0.9 * opacity, METRICS)
    return dataclasses.replace(made, **changes)


def cell(image, column):
    """Pixels of a cell of the first row, without its edge."""
    layout = sheet_layout(1)
    left, top, end = layout.left(column) + 2, layout.top(0) + 2, layout.tile - 4
    return np.asarray(image)[top : top + end, left : left + end, :3]


@pytest.mark.parametrize("num_rows", range(1, sheet.MAX_ROWS + 1))
def test_size(tmp_path, num_rows):
    draw_sheet([row()] * num_rows, 1.0, "title").save(tmp_path / "sheet.png")
    with Image.open(tmp_path / "sheet.png") as image:
        assert image.format == "PNG"
        assert image.size == sheet_layout(num_rows).size
    assert [path.name for path in tmp_path.iterdir()] == ["sheet.png"]


def test_cells_show_what_they_say(tmp_path):
    reference, baked = np.full((16, 16, 3), [4.0, 2.0, 1.0]), np.full((16, 16, 3), [2.0, 1.0, 0.5])
    view = row(
        reference=reference,
        baked=baked,
        reference_opacity=np.full((16, 16), 1.0),
        baked_opacity=np.full((16, 16), 0.4),
    )
    draw_sheet([view], 4.0, "title").save(tmp_path / "sheet.png")
    with Image.open(tmp_path / "sheet.png") as image:
        shown = [cell(image, column).reshape(-1, 3) for column in range(5)]
    exposure = auto_exposure(reference)
    error = mpl.colormaps["inferno"](1 + math.log10(3.5 / 3 / 4) / 4)[:3]
    expected = [
        tonemap(reference, exposure)[0, 0],
        tonemap(baked, exposure)[0, 0],
        np.array(error) * 255,
        [255, 255, 255],
        [102, 102, 102],
    ]
    for pixels, colour in zip(shown, expected, strict=True):
        assert np.abs(pixels - np.asarray(colour, float)).max() <= 4


def test_relative_error():
    reference, baked = np.zeros((2, 2, 3)), np.full((2, 2, 3), [-0.3, 0.6, 0.0])
    assert relative_error(baked, reference, 3.0) == pytest.approx(np.full((2, 2), 0.1))


@pytest.mark.parametrize("shape", [(20, 40), (40, 20), (1, 1)])
def test_images_keep_their_proportions(tmp_path, shape):
    white = row(*shape, reference_opacity=np.ones(shape))
    draw_sheet([white], 1.0, "title").save(tmp_path / "sheet.png")
    with Image.open(tmp_path / "sheet.png") as image:
        covered = (cell(image, 3)[..., 0] > 128).mean()
    assert covered == pytest.approx(min(shape) / max(shape), abs=0.02)


def test_black_and_overflowing_views(tmp_path):
    black = np.zeros((16, 16, 3))
    dark = row(16, 16, reference=black, baked=black)
    bright = row(16, 16, baked=np.full((16, 16, 3), 1e9))
    draw_sheet([dark, bright], 1.0, "title").save(tmp_path / "sheet.png")
    assert (tmp_path / "sheet.png").exists()


def test_text_is_taken_literally(tmp_path):
    draw_sheet([row(name=r"a$b_{")], 1.0, r"lamp $\frac{ 100%").save(tmp_path / "sheet.png")
    assert (tmp_path / "sheet.png").exists()


def test_same_input_gives_same_bytes_whatever_the_users_settings(tmp_path):
    draw_sheet([row()], 1.0, "title").save(tmp_path / "one.png")
    with mpl.rc_context({"savefig.dpi": 30, "savefig.bbox": "tight", "figure.dpi": 50}):
        draw_sheet([row()], 1.0, "title").save(tmp_path / "two.png")
    assert (tmp_path / "one.png").read_bytes() == (tmp_path / "two.png").read_bytes()


def test_leaves_pyplot_alone(tmp_path):
    if "matplotlib.pyplot" in sys.modules:
        pytest.skip("another test has loaded pyplot")
    draw_sheet([row()], 1.0, "title").save(tmp_path / "sheet.png")
    assert "matplotlib.pyplot" not in sys.modules


def test_caption_says_what_black_scores():
    assert sheet._psnr_caption(METRICS) == "psnr_linear 31.23 dB"
    assert sheet._psnr_caption(METRICS | {"psnr_linear_black": 16.1}).endswith("(black 16.10)")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"baked": np.zeros((8, 8, 3))}, "baked has shape"),
        ({"reference": np.zeros((32, 32))}, "reference has shape"),
        ({"reference_opacity": np.zeros((32, 32, 3))}, "reference_opacity has shape"),
        ({"baked_opacity": np.full((32, 32), np.nan)}, "baked_opacity holds NaN"),
        ({"reference": np.full((32, 32, 3), np.inf)}, "reference holds NaN or infinity"),
        ({"metrics": {"psnr_linear": 1.0}}, "lack opacity_rmse"),
    ],
)
def test_bad_rows(tmp_path, changes, message):
    with pytest.raises(LumitreeError, match=message) as caught:
        draw_sheet([row(), row(**changes)], 1.0, "title").save(tmp_path / "sheet.png")
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("num_rows", [0, 7])
def test_number_of_rows(tmp_path, num_rows):
    with pytest.raises(LumitreeError, match="1 to 6 views"):
        draw_sheet([row()] * num_rows, 1.0, "title").save(tmp_path / "sheet.png")


@pytest.mark.parametrize("max_radiance", [0.0, -1.0, math.nan])
def test_l_max(tmp_path, max_radiance):
    with pytest.raises(LumitreeError, match="L_max"):
        draw_sheet([row()], max_radiance, "title").save(tmp_path / "sheet.png")


def test_other_formats_are_refused(tmp_path):
    with pytest.raises(LumitreeError, match=r"does not end in \.png"):
        draw_sheet([row()], 1.0, "title").save(tmp_path / "sheet.jpg")


def test_leaves_nothing_behind_when_writing_fails(tmp_path, monkeypatch):
    def fail(path, data):
        write(path, data[: len(data) // 2])
        raise OSError(28, "No space left on device")

    (tmp_path / "sheet.png").write_bytes(b"old")
    write = Path.write_bytes
    monkeypatch.setattr(Path, "write_bytes", fail)
    with pytest.raises(LumitreeError, match="No space left on device"):
        draw_sheet([row()], 1.0, "title").save(tmp_path / "sheet.png")
    assert [path.name for path in tmp_path.iterdir()] == ["sheet.png"]
    assert (tmp_path / "sheet.png").read_bytes() == b"old"


def test_folder_that_cannot_be_made(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(LumitreeError, match="cannot write"):
        draw_sheet([row()], 1.0, "title").save(tmp_path / "file" / "sheet.png")
