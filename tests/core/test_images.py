"""The sRGB transfer function, and damaged OpenEXR files."""

import numpy as np
import pytest

from lumitree.core.images import (
    check_image_name,
    linear_from_srgb,
    read_comment,
    read_exr,
    srgb_from_linear,
    write_exr,
)
from lumitree.errors import LumitreeError
from support.damage import damaged, refused


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


@pytest.fixture
def layers(tmp_path):
    """Path and content of a file of two layers with a comment."""
    path = tmp_path / "layers.exr"
    image = np.random.default_rng(0).random((5, 7, 3)).astype(np.float32)
    write_exr(path, {"room": image, "lamp": 2 * image}, "settings")
    return path, path.read_bytes()


def test_sides_without_pixels_reserve_no_memory(layers):
    path, good = layers
    # xMax and yMax of the data window: 6 and 4.
    window = good.index(b"dataWindow\0box2i\0") + len(b"dataWindow\0box2i\0") + 4 + 8
    assert good[window : window + 8] == (6).to_bytes(4, "little") + (4).to_bytes(4, "little")
    path.write_bytes(good[:window] + 2 * (2**20).to_bytes(4, "little") + good[window + 8 :])
    with pytest.raises(LumitreeError, match="1048577 x 1048577 pixels; expected"):
        read_exr(path)


def test_channels_count_before_they_are_read(layers, monkeypatch):
    path, _ = layers
    monkeypatch.setattr("lumitree.core.images._MAX_VALUES", 5 * 7 * 6)
    assert len(read_exr(path)) == 2
    monkeypatch.setattr("lumitree.core.images._MAX_VALUES", 5 * 7 * 6 - 1)
    with pytest.raises(LumitreeError, match="6 channels of 7 x 5 pixels; expected at most 209"):
        read_exr(path)


ROUNDS = 150


def test_damaged_exr_files_are_refused_or_read(layers):
    path, good = layers
    rng, outcomes = np.random.default_rng(0), set()
    # Pixels begin after the header and the table of offsets.
    header = len(good) - 900

    def check():
        for plane in read_exr(path).values():
            assert np.isfinite(plane).all()
        read_comment(path)

    for round_ in range(ROUNDS):
        data = bytearray(good)
        for place in rng.integers(0, header if round_ % 2 else len(data), rng.integers(1, 4)):
            data[place] = rng.integers(256)
        path.write_bytes(data if round_ % 3 else damaged(good, rng))
        outcomes.add(refused(check))
    assert outcomes == {True, False}


def test_nothing_is_printed_of_a_file_that_is_cut_off(tmp_path, capfd):
    noise = np.random.default_rng(0).random((40, 60, 3), np.float32)
    write_exr(tmp_path / "a.exr", {"RGB": noise})
    data = (tmp_path / "a.exr").read_bytes()
    (tmp_path / "a.exr").write_bytes(data[: len(data) // 2])
    with pytest.raises(LumitreeError, match="its pixels are damaged, or cut off"):
        read_exr(tmp_path / "a.exr")
    assert capfd.readouterr() == ("", "")


def test_exr_round_trip(tmp_path):
    random = np.random.default_rng(0)
    planes = {
        "RGB": random.normal(size=(5, 7, 3)).astype(np.float32),
        "geometric": random.random((5, 7), np.float32),
    }
    write_exr(tmp_path / "a.exr", planes)
    read = read_exr(tmp_path / "a.exr")
    assert read.keys() == planes.keys()
    assert all(np.array_equal(read[name], planes[name]) for name in planes)


def test_bad_exr_files_are_refused(tmp_path):
    with pytest.raises(LumitreeError, match="does not exist"):
        read_exr(tmp_path / "no.exr")
    (tmp_path / "text.exr").write_text("not an image")
    with pytest.raises(LumitreeError, match="not a readable OpenEXR"):
        read_exr(tmp_path / "text.exr")
    write_exr(tmp_path / "nan.exr", {"RGB": np.full((2, 2, 3), np.nan, np.float32)})
    with pytest.raises(LumitreeError, match="NaN"):
        read_exr(tmp_path / "nan.exr")


def test_image_names():
    for name in ("a.png", "folder/A.EXR"):
        check_image_name(name)
    with pytest.raises(LumitreeError, match=r"neither \.exr"):
        check_image_name("a.jpg")
