"""The preview of an asset: its views, its figures, and its contact sheet."""

import io

import numpy as np
import pytest
from PIL import Image

import lumitree
from lumitree.asset.asset import light_field_asset
from lumitree.cli import main
from support.fields import uniform_asset
from support.light_fields import random_light_field


def test_every_view_shows_the_side_it_names(mi):
    """A cube that is bright in one half of x: each view shows it where that half is."""
    import dataclasses

    from lumitree.measure.preview import VIEWS, take_asset_preview

    # Nearly opaque leaves; leaves of larger x emit.
    asset = uniform_asset(50.0, (5, 5, 5), law="exponential")
    coefficients = asset.coefficients.copy()
    from support.reference_field import leaf_boxes

    lower, _ = leaf_boxes(asset)
    coefficients[lower[:, 0] < -0.5] = -40
    asset = dataclasses.replace(asset, coefficients=coefficients)
    images = take_asset_preview(asset, 48, 1).images
    assert list(images) == list(VIEWS)
    for name, (backward, up) in VIEWS.items():
        radiance, opacity = images[name].radiance[..., 0], images[name].geometric
        right = np.cross(up, backward)
        assert opacity[24, 24] > 0.99
        assert opacity[0, 0] == 0
        halves = radiance[:, 24:].mean(), radiance[:, :24].mean()
        if right[0]:
            bright, dark = halves if right[0] > 0 else halves[::-1]
            assert dark < 0.01 * bright, name
        elif backward[0]:
            seen = radiance[24, 24] > 1
            assert seen == (backward[0] > 0), name
    # The cube's side of 2 in an image of 2 sqrt(3).
    front = images["from the front, +z"].geometric
    assert front.mean() == pytest.approx(1 / 3, abs=0.03)


def test_figures_and_sheet_of_an_asset(tmp_path, monkeypatch, mi, capsys):
    monkeypatch.chdir(tmp_path)
    field = uniform_asset(50.0, (5, 5, 5), law="exponential")
    lumitree.save(field, "lamp.lumitree")
    result = lumitree.preview("lamp.lumitree", sheet=True, resolution=32)
    # An opaque cube of side 2 and radiance 5: an area of 24 times 5 pi.
    assert result.lumens == pytest.approx(683 * 24 * 5 * np.pi, rel=0.02)
    assert result.size == (2, 2, 2)
    assert result.parts == ("field",)
    rows = {Image.open(io.BytesIO(result.png)).size}
    light_field = lumitree.preview(
        light_field_asset(random_light_field(2), field.frame, "x"), sheet=True, resolution=32
    )
    assert {Image.open(io.BytesIO(light_field.png)).size} == rows
    assert light_field.lumens > 0
    command = ["preview", "lamp.lumitree", "-o", "sheet.png", "--resolution", "32"]
    assert main([*command, "--sheet"]) == 0
    assert (tmp_path / "sheet.png").read_bytes() == result.png
    assert "luminous flux" in capsys.readouterr().out
    assert main(command) == 0
    photograph = Image.open(tmp_path / "sheet.png")
    assert photograph.size == (32, 32)
    assert (np.array(photograph)[16, 16] > np.array(photograph)[0, 0]).all()
    assert main([*command, "--bounces"]) == 2
    assert "an asset has no paths" in capsys.readouterr().err
