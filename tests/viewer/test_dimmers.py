"""The page with dimmers, and its codes by a decoder that shares no code with it."""

import base64
import json
import re
import zlib

import numpy as np
import pytest

import lumitree
from lumitree.cli import main
from lumitree.errors import LumitreeError
from lumitree.rendering.photograph import automatic_ev, white_radiance
from support.mixed_layers import wall, write_wall

LUMA = np.array([0.2126, 0.7152, 0.0722])


def content(page):
    return json.loads(re.search(r'<script type="application/json" id="content">(.*?)</sc', page)[1])


def joined(means, differences):
    """Lines of which the wavelet 5/3 has made these; beyond the ends it takes the last one."""
    lines = np.zeros((len(means) + len(differences), *means.shape[1:]), np.int64)
    last = len(differences) - 1
    for i, mean in enumerate(means):
        sides = differences[max(i - 1, 0)] + differences[min(i, last)] if last >= 0 else -2
        lines[2 * i] = mean - (sides + 2) // 4
    for i, difference in enumerate(differences):
        after = lines[min(2 * i + 2, 2 * len(means) - 2)]
        lines[2 * i + 1] = difference + (lines[2 * i] + after) // 2
    return lines


def planes(found):
    """Codes [planes, H, W] of a page."""
    height, width, levels = found["height"], found["width"], found["levels"]
    data = np.frombuffer(zlib.decompress(base64.b64decode(found["block"])), np.uint8)
    count = 3 * (len(found["lamps"]) + 1)
    low, high = data[: 2 * count * height * width].reshape(2, count, -1).astype(np.int64)
    codes = low + 256 * high
    codes = np.where(codes % 2, -(codes + 1) // 2, codes // 2)
    sizes = [(height, width)]
    for _ in range(levels):
        sizes.append(tuple((side + 1) // 2 for side in sizes[-1]))
    for number, plane in enumerate(codes):
        step = 1 if number < 3 else found["step"] * (2 if number % 3 else 1)
        start = sizes[-1][0] * sizes[-1][1]
        image = plane[:start].reshape(sizes[-1])
        for level in reversed(range(levels)):
            h, w = sizes[level]
            shapes = ((h // 2, (w + 1) // 2), ((h + 1) // 2, w // 2), (h // 2, w // 2))
            bands = []
            for shape in shapes:
                size = shape[0] * shape[1]
                band = plane[start : start + size].reshape(shape)
                bands.append(band * max(1, step // 2**level))
                start += size
            below, beside, both = bands
            upper = joined(image.T, beside.T).T
            image = joined(upper, joined(below.T, both.T).T)
        yield image


def decoded(found):
    """The sum [H, W, 3] and the layers by name, relative to white."""
    colours = [
        np.stack([green + red, green, green + blue], axis=-1)
        for green, red, blue in zip(*[planes(found)] * 3, strict=True)
    ]

    def radiance(codes):
        return found["least"] * (2 ** np.maximum(codes * found["unit"], 0) - 1)

    whole = radiance(2 * colours[0])
    layers = {
        lamp["name"]: radiance(2 * colours[0] + codes)
        for lamp, codes in zip(found["lamps"], colours[1:], strict=True)
    }
    total = sum(layers.values())
    scale = np.divide(whole, total, out=np.zeros_like(whole), where=total > 0)
    return whole, {name: layer * scale for name, layer in layers.items()}


@pytest.mark.parametrize(
    ("noise", "most", "size"), [(0.0, 0.015, (90, 161)), (0.05, 0.15, (64, 95))]
)
def test_the_sum_is_within_a_percent_and_layers_are_near(mi, tmp_path, noise, most, size):
    """The page keeps less of noisy layers: they add up, but their noise is smoothed."""
    layers, _ = wall(*size, noise=noise)
    page = tmp_path / "wall.html"
    lumitree.mix(layers).save(page)
    found = content(page.read_text("utf-8"))
    total = sum(layers.values()).astype(np.float64)
    white = white_radiance(automatic_ev(total))
    whole, parts = decoded(found)
    lit = total > 1e-3 * white
    assert lit.mean() > 0.99
    assert np.abs(whole * white / total - 1)[lit].max() < 0.01
    for name, layer in layers.items():
        expected, got = layer @ LUMA, parts[name] @ LUMA * white
        lit = expected > 1e-3 * white
        error = np.sqrt(((got / np.where(lit, expected, 1) - 1)[lit] ** 2).mean())
        assert error < most
        assert got.mean() == pytest.approx(expected.mean(), rel=0.02)
    most_bytes = 4 / 3 * total[..., 0].size * (1 + 0.42 * len(layers))
    assert len(found["block"]) < (1.2 if noise == 0 else 1.5) * most_bytes


def test_the_page_has_what_the_photograph_needs(mi, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_wall("wall.exr")
    options = ["--gain", "desk=0.5", "--exposure", "ev=6", "--white-balance", "3000"]
    assert main(["mix", "wall.exr", "-o", "wall.html", *options]) == 0
    page = (tmp_path / "wall.html").read_text("utf-8")
    assert not re.search(r"https?://|src=|<link", page)
    found = content(page)
    automatic = lumitree.mix("wall.exr").ev
    assert found["initial"] == {
        "stops": pytest.approx(automatic - 6, abs=1e-3),
        "balance": 3000,
        "view": "agx",
        "bloom": 0.06,
    }
    desk, hall, room = found["lamps"]
    assert (desk["level"], desk["tint"]) == (0.5, [1, 1, 1])
    # The colour of the flux, and without it the colour of the layer.
    assert np.array(desk["colour"]) / desk["colour"][0] == pytest.approx([1, 2 / 3, 0.3], rel=1e-4)
    assert hall["colour"][0] > hall["colour"][1] > hall["colour"][2]
    table = '[lamps."desk"]\nasset = "lamp.lumitree"\nat = [1, 2.5, 0]\nsize = 0.5\n'
    assert desk["placement"] == table
    assert "bake it" in hall["placement"]
    assert room["placement"] is None
    assert (desk["factors"], room["factors"]) == ([2, 1, 1], [1, 1, 1])
    assert [each["column"] for each in found["lamps"]] == [0, -1, 2]


def test_negative_radiance_counts_as_0_in_images_and_pages(mi, tmp_path):
    """As filters with negative lobes give it."""
    layers = {"desk": np.full((4, 5, 3), 2, np.float32), "room": np.ones((4, 5, 3), np.float32)}
    layers["room"][0, 0, 1] = -3
    with pytest.warns(lumitree.LumitreeWarning, match="0.0083 of the numbers in the image are neg"):
        mixed = lumitree.mix(layers, {"room": 2})
    assert mixed.pixels[0, 0].tolist() == [4, 2, 4]
    mixed.save(tmp_path / "page.html")
    _, found = decoded(content((tmp_path / "page.html").read_text()))
    assert found["room"][0, 0, 1] < 1e-3 * found["room"][0, 0, 0]


def test_black_layers_are_left_out_and_too_large_images_refused(mi, tmp_path, capsys):
    layers, _ = wall(12, 20)
    page = tmp_path / "wall.html"
    lumitree.mix({"room": layers["room"], "off": np.zeros_like(layers["desk"]), **layers}).save(
        page
    )
    assert [each["name"] for each in content(page.read_text("utf-8"))["lamps"]] == sorted(layers)
    with pytest.raises(LumitreeError, match="all layers are black"):
        lumitree.mix({"off": np.zeros((4, 4, 3), np.float32)}).save(page)
    many = {f"lamp{i}": layers["desk"] for i in range(65)}
    with pytest.raises(LumitreeError, match="65 layers of 20 x 12 pixels; a page shows at most 64"):
        lumitree.mix(many).save(page)
    with pytest.raises(LumitreeError, match=r"neither .exr .* nor .html \(with dimmers\)"):
        lumitree.mix(layers).save(tmp_path / "wall.jpg")
