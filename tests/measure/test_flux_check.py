"""The flux by light paths against the flux by camera paths, which share only the scene."""

import json
import warnings

import numpy as np
import pytest

from lumitree.errors import LumitreeWarning
from lumitree.lamp.luminaire import load_luminaire
from lumitree.measure.irradiance import check_flux, luminaire_irradiance
from lumitree.trace.flux import estimate_flux, flux_by_camera_paths
from support.lamps import AREA, GLASS, cube, lamp_of, sphere
from support.slow import slow

BALL = 4 * np.pi**2 * np.array([3, 2, 1])
FOG = (
    '<medium type="homogeneous" name="interior"><rgb name="albedo" value="0.9,0.8,0.7"/>'
    '<float name="sigma_t" value="1"/></medium><bsdf type="null"/>'
)
GREY = '<bsdf type="diffuse"><rgb name="reflectance" value="0.5,0.5,0.5"/></bsdf>'


def test_the_flux_of_a_bare_ball_is_its_area_times_pi_radiance(mi, tmp_path):
    lamp = lamp_of(tmp_path, sphere("ball", 1, inside=AREA))
    found = flux_by_camera_paths(lamp, 1 << 20)
    assert (np.abs(found.watts - BALL) < 4 * np.array(found.watts_error)).all()
    assert (np.array(found.watts_error) < 0.002 * BALL).all()
    # The bounding sphere is the one around the box.
    assert found.hits == pytest.approx(found.paths / 3, rel=0.01)


@pytest.mark.parametrize("around", [GLASS, slow(FOG)])
def test_both_agree_through_glass_and_fog(mi, tmp_path, around):
    shapes = sphere("shell", 2, inside=around), cube("plate", (1, 0.1, 1), (0, -1, 0), GREY)
    lamp = lamp_of(tmp_path, sphere("ball", 0.5, inside=AREA), *shapes)
    light, camera = estimate_flux(lamp, 1 << 20), flux_by_camera_paths(lamp, 1 << 20)
    error = np.hypot(light.watts_error, camera.watts_error)
    assert (error < 0.02 * np.array(light.watts)).all()
    assert (np.abs(np.subtract(light.watts, camera.watts)) < 4 * error).all()


def test_the_check_is_silent_where_both_agree(mi, tmp_path):
    lamp = lamp_of(tmp_path, sphere("ball", 0.5, inside=AREA), cube("plate", 0.2, (1, 0, 0), GREY))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = check_flux(lamp, luminaire_irradiance(lamp, 1 << 16))
    for name in ("light_paths", "camera_paths"):
        assert found[name] == pytest.approx(estimate_flux(lamp, 1 << 20).lumens, rel=0.01)
        assert 0 < found[f"{name}_error"] < 0.01 * found[name]
    json.dumps(found, allow_nan=False)


def test_a_difference_is_told_with_both_numbers(mi):
    """Two squares in one place that face away from each other: rays hit either of them."""
    emitter = {"type": "area", "radiance": 1.0}
    turned = mi.ScalarTransform4f().rotate([1, 0, 0], 180)
    up = {"type": "rectangle", "emitter": emitter}
    lamp = load_luminaire({"type": "scene", "up": up, "down": {**up, "to_world": turned}})
    numbers = r"emits 17,16[\d.]+ ± [\d.]+ lm by light paths, but [\d,]+ ± \d+ lm by camera"
    with pytest.warns(LumitreeWarning, match=numbers):
        found = check_flux(lamp, luminaire_irradiance(lamp, 1 << 16))
    # π A L on both sides.
    assert found["light_paths"] == pytest.approx(2 * 4 * np.pi * 683, rel=1e-3)
    assert found["camera_paths"] < 0.9 * found["light_paths"]


@pytest.mark.slow
def test_a_difference_by_chance_is_estimated_again(mi):
    one = load_luminaire({"type": "sphere", "emitter": {"type": "area", "radiance": 1.0}})
    explicit = luminaire_irradiance(one, 1 << 16)
    doubled = type(explicit)(2 * explicit.batches)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = check_flux(one, doubled)
    assert found["light_paths"] == pytest.approx(4 * np.pi**2 * 683, rel=1e-3)


def test_an_emitter_that_is_hardly_ever_hit_says_nothing(mi, tmp_path):
    far = sphere("speck", 0.001, (0, 3, 0), inside=AREA), cube("body", 1, inside=GREY)
    lamp = lamp_of(tmp_path, *far)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = check_flux(lamp, luminaire_irradiance(lamp, 1 << 16))
    assert found["camera_paths"] is None
    assert found["camera_paths_error"] is None
