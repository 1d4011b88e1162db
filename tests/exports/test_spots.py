"""Exports for Blender's importers: spots with the illumination of the lamp."""

import os

import numpy as np
import pytest

import lumitree
from lumitree.asset.asset import light_field_asset
from lumitree.asset.light_field import make_light_field
from lumitree.cli import main
from lumitree.core.frames import LocalFrame
from lumitree.core.octahedral import middle_directions, solid_angles

pytestmark = pytest.mark.usefixtures("mi")

blender = os.environ.get("LUMITREE_BLENDER_PYTHON")
RESOLUTION = 16


def lamp():
    """A downlight with a shade, one cell of which emits evenly; y up."""
    directions = middle_directions(RESOLUTION)
    down = np.maximum(-directions[:, 1], 0)
    intensity = np.zeros((2, RESOLUTION**2, 3))
    intensity[0] = (down * (down > 0.5))[:, None] * [1.0, 0.8, 0.5]
    intensity[1] = 0.02
    field = make_light_field(np.array([[1, 0, 1], [0, 1, 0]]), intensity, 1)
    frame = LocalFrame(np.ones(3), np.eye(4))
    return light_field_asset(field, frame, "downlight")


def irradiance(directions, intensity):
    """Sums over directions of intensity times cosine [16], to 16 sides; 0 where it is dark."""
    cosine = np.maximum(directions @ middle_directions(4).T, 0)
    return intensity @ (cosine * solid_angles(RESOLUTION)[:, None])


def test_spots_have_flux_and_illumination_of_the_lights():
    from lumitree.exports.light_profiles import spots_of
    from lumitree.exports.point_lights import place_lights, turn_up

    placed = place_lights(lamp(), turn_up("z", "y"), 2)
    directions = middle_directions(RESOLUTION) @ placed.rotation.T
    local = placed.local.intensity.sum(axis=0) @ [0.2126, 0.7152, 0.0722]
    expected = local * placed.scale**2
    found, flux = np.zeros(len(directions)), 0.0
    for spot in spots_of(placed):
        border = np.cos(np.radians(spot.half_angle))
        place = np.clip((directions @ spot.axis - border) / (1 - border), 0, 1)
        luminance = spot.candela / 683 * np.dot(spot.colour, [0.2126, 0.7152, 0.0722])
        flux += luminance * np.pi * (1 - border)
        found += luminance * (3 * place**2 - 2 * place**3)
        x, y, _, w = spot.rotation
        # The quaternion turns -z to the axis.
        np.testing.assert_allclose(
            [-2 * w * y, 2 * w * x, 2 * (x**2 + y**2) - 1], spot.axis, atol=1e-6
        )
    weight = solid_angles(RESOLUTION)
    assert flux == pytest.approx(expected @ weight, rel=1e-6)
    wanted = irradiance(directions, expected)
    lit = wanted > 0.1 * wanted.max()
    np.testing.assert_allclose(irradiance(directions, found)[lit], wanted[lit], rtol=0.04)


def test_exports_say_that_blender_makes_other_light_of_them(tmp_path, capsys):
    lumitree.save(lamp(), tmp_path / "lamp.lumitree")
    arguments = ["export", str(tmp_path / "lamp.lumitree"), "-o", str(tmp_path / "lamp.glb")]
    assert main(arguments) == 0
    assert "note: Blender's importer makes other light of it" in capsys.readouterr().out
    assert main([*arguments, "--importer", "blender"]) == 0
    assert "makes other light" not in capsys.readouterr().out
    with pytest.raises(
        lumitree.LumitreeError, match=r"for .glb, .usda and .usdz, and the output is for Radiance"
    ):
        lumitree.export(lamp(), tmp_path / "lamp.rad", importer="blender")
