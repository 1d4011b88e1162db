"""Glare of views, against the formula of CIE 117."""

import dataclasses
import math

import numpy as np
import pytest

import lumitree

pytest.importorskip("pyradiance", reason="glare needs pyradiance")


@pytest.mark.parametrize(("offset", "side"), [((0, 0), 0.12), ((0, 0.35), 0.2)])
def test_ugr_of_a_square_source(mi, offset, side):
    """A square at a distance of 2 before a grey background, on the line of sight and above it."""
    lit, grey = 5000.0, 50.0
    scene = {
        "type": "scene",
        "square": {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f()
            .translate([offset[0], offset[1], -2])
            .scale([side / 2, side / 2, 1]),
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": lit / 683}},
        },
        "background": {"type": "constant", "radiance": {"type": "rgb", "value": grey / 683}},
        "camera": {
            "type": "perspective",
            "fov": 60,
            "to_world": mi.ScalarTransform4f().look_at([0, 0, 0], [0, 0, -1], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 256, "height": 256, "rfilter": {"type": "box"}},
        },
        "integrator": {"type": "path"},
    }
    image = lumitree.render(scene, samples_per_pixel=4)
    assert image.camera is not None
    assert (image.camera.horizontal, image.camera.vertical) == pytest.approx((60, 60), abs=1e-3)
    assert image.camera.direction == pytest.approx((0, 0, -1), abs=1e-6)
    found = lumitree.glare(image, vertical_illuminance=200)
    distance = math.hypot(2, *offset)
    omega = side**2 * 2 / distance**3
    # Position index above the line of sight by Luckiesh and Guth, as CIE 117 has it.
    sigma, tau = math.degrees(math.atan(offset[1] / 2)), 0.0
    position = math.exp(
        (35.2 - 0.31889 * tau - 1.22 * math.exp(-2 * tau / 9)) * 1e-3 * sigma
        + (21 + 0.26667 * tau - 0.002963 * tau**2) * 1e-5 * sigma**2
    )
    expected = 8 * math.log10(0.25 / grey * lit**2 * omega / position**2)
    # With the pixels that its border crosses.
    assert found.source_solid_angle == pytest.approx(omega, rel=0.1)
    assert found.ugr == pytest.approx(expected, abs=0.4)
    assert found.vertical_illuminance == pytest.approx(200, rel=1e-3)


def view_of(values):
    """A render of luminances [H, W], cd/m², at 60 degrees; it is only looked at."""
    pixels = np.repeat(np.asarray(values, np.float32)[..., None] / 683, 3, axis=2)
    film = {"type": "hdrfilm", "width": 256, "height": 256}
    camera = {"type": "perspective", "fov": 60, "film": film}
    light = {"type": "constant", "radiance": {"type": "rgb", "value": 1}}
    scene = {"type": "scene", "light": light, "camera": camera, "integrator": {"type": "path"}}
    return dataclasses.replace(lumitree.render(scene, samples_per_pixel=1), pixels=pixels)


@pytest.mark.parametrize(
    ("lamp", "background"), [(1500, 30), (1900, 30), (2100, 30), (20_000, 2500), (8000, 300)]
)
def test_ugr_of_dim_lamps_and_of_bright_rooms(mi, lamp, background):
    """Whether a source is above 2,000 cd/m² does not matter, nor whether the walls are."""
    values = np.full((256, 256), float(background))
    values[118:138, 118:138] = lamp
    found = lumitree.glare(view_of(values), vertical_illuminance=200)
    pixel = 2 * math.tan(math.radians(30)) / 256
    expected = 8 * math.log10(0.25 / background * lamp**2 * (20 * pixel) ** 2)
    assert found.ugr == pytest.approx(expected, abs=0.3)


def test_before_black_there_is_no_rating(mi):
    """Its formula divides by the background."""
    values = np.zeros((256, 256))
    values[100:140, 100:140] = 20_000.0
    found = lumitree.glare(view_of(values), vertical_illuminance=200)
    assert math.isnan(found.ugr)
    assert found.background == 0
    assert found.source_luminance == pytest.approx(20_000, rel=0.01)


@pytest.mark.parametrize("vertical", [math.nan, math.inf, 0.0, -1.0])
def test_without_vertical_illuminance_there_is_no_probability(mi, vertical):
    """It is not known inside solids. The rating does not depend on it."""
    values = np.full((256, 256), 30.0)
    values[118:138, 118:138] = 8000
    found = lumitree.glare(view_of(values), vertical)
    assert math.isnan(found.dgp)
    assert found.ugr == lumitree.glare(view_of(values), 200).ugr


def test_infinite_pixels_do_not_count(mi):
    values = np.full((256, 256), 30.0)
    values[118:138, 118:138] = 8000
    clean = lumitree.glare(view_of(values), 200)
    values[10, 10] = math.inf
    found = lumitree.glare(view_of(values), 200)
    assert found.ugr == pytest.approx(clean.ugr, abs=0.01)
    assert found.background == pytest.approx(clean.background, rel=0.01)


def test_an_even_view_has_no_source(mi):
    scene = {
        "type": "scene",
        "background": {"type": "constant", "radiance": {"type": "rgb", "value": 0.1}},
        "camera": {"type": "perspective", "fov": 60, "film": {"type": "hdrfilm", "width": 64}},
        "integrator": {"type": "path"},
    }
    scene["camera"]["film"]["height"] = 64
    found = lumitree.glare(lumitree.render(scene, samples_per_pixel=1), 200)
    assert math.isnan(found.ugr)
    assert found.source_solid_angle == 0
    assert found.background == pytest.approx(68.3, rel=0.02)


def test_the_corners_of_an_image_may_be_dark(mi):
    sphere = {"type": "sphere", "center": [0, 0, -2], "radius": 0.1}
    sphere["emitter"] = {"type": "area", "radiance": {"type": "rgb", "value": 10}}
    camera = {"type": "perspective", "fov": 60, "film": {"type": "hdrfilm", "width": 512}}
    camera["film"] |= {"height": 512}
    camera["to_world"] = mi.ScalarTransform4f().look_at([0, 0, 0], [0, 0, -1], [0, 1, 0])
    scene = {"type": "scene", "sphere": sphere, "camera": camera, "path": {"type": "path"}}
    found = lumitree.glare(lumitree.render(scene, samples_per_pixel=16), 1)
    assert found.source_solid_angle == pytest.approx(math.pi * 0.05**2, rel=0.1)
    assert found.source_luminance == pytest.approx(6830, rel=0.1)
    # Of pixels at the edge of the sphere.
    assert 0 <= found.background < 1


def test_what_evalglare_says_is_one_line(mi, monkeypatch):
    import pyradiance

    def fail(*_, **__):
        raise RuntimeError("An error occurred with exit code 1: first\nsecond")

    monkeypatch.setattr(pyradiance, "evalglare", fail)
    camera = {"type": "perspective", "film": {"type": "hdrfilm", "width": 64, "height": 64}}
    scene = {"type": "scene", "camera": camera, "light": {"type": "constant"}}
    image = lumitree.render(scene | {"path": {"type": "path"}}, samples_per_pixel=1)
    with pytest.raises(lumitree.LumitreeError, match=r"evalglare failed: .*: first second$"):
        lumitree.glare(image, 1)


@pytest.mark.parametrize(("offset", "seen"), [((96, 64), True), ((95, 60), False)])
def test_the_view_of_a_crop_window(mi, offset, seen):
    """The middle of an image is a narrower view; any other part is none."""
    film = {"type": "hdrfilm", "width": 256, "height": 256, "crop_width": 64, "crop_height": 128}
    film |= {"crop_offset_x": offset[0], "crop_offset_y": offset[1]}
    scene = {
        "type": "scene",
        "camera": {"type": "perspective", "fov": 90, "film": film},
        "light": {"type": "constant"},
        "path": {"type": "path"},
    }
    image = lumitree.render(scene, samples_per_pixel=1)
    assert image.resolution == (64, 128)
    if not seen:
        assert image.camera is None
        return
    angles = (image.camera.horizontal, image.camera.vertical)
    assert angles == pytest.approx([2 * math.degrees(math.atan(x)) for x in (0.25, 0.5)])


def test_what_has_no_glare_is_refused(mi):
    camera = {"type": "orthographic", "film": {"type": "hdrfilm", "width": 64, "height": 64}}
    scene = {"type": "scene", "camera": camera, "light": {"type": "constant"}}
    scene["integrator"] = {"type": "path"}
    image = lumitree.render(scene, samples_per_pixel=1)
    with pytest.raises(lumitree.LumitreeError, match="not a perspective one"):
        lumitree.glare(image, 100)
    assert np.isfinite(image.luminance).all()
