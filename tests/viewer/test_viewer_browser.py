"""The page in a browser shows what the field on the device returns."""

import base64
import dataclasses
import json

import numpy as np
import pytest

from lumitree.asset.asset import light_field_asset
from lumitree.asset.geometry import AssetGeometry, Medium, UnitShape
from lumitree.asset.light_field import make_light_field
from lumitree.asset.materials import (
    Conductor,
    Dielectric,
    Diffuse,
    RoughConductor,
    RoughDielectric,
    Texture,
    ThinDielectric,
    TwoSided,
)
from lumitree.core.device import on_device
from lumitree.core.frames import LocalFrame, rows_of, similarity
from lumitree.core.octahedral import middle_directions
from lumitree.viewer.view import make_page
from support.browser import CHROMIUM, evaluate
from support.fields import random_asset
from support.geometry_assets import NOTHING, with_geometry
from support.light_fields import random_light_field

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="no program chromium"),
]


def floats(text):
    return np.frombuffer(base64.b64decode(text), np.float32)


def camera_rays(eye, target, up, fov, width, height):
    """Origin and directions [H, W, 3] of the pixels, bottom row first."""
    forward = np.subtract(target, eye) / np.linalg.norm(np.subtract(target, eye))
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    tangent = np.tan(fov / 2)
    x = (2 * (np.arange(width) + 0.5) / width - 1) * tangent * width / height
    y = (2 * (np.arange(height) + 0.5) / height - 1) * tangent
    direction = forward + x[None, :, None] * right + y[:, None, None] * np.cross(right, forward)
    return direction / np.linalg.norm(direction, axis=-1, keepdims=True)


CHECKED = Texture(image=0, raw=False, to_uv=rows_of(np.diag([3.0, 3, 1, 1])))
MATERIALS = (
    Dielectric(int_ior=1.5, ext_ior=1.0),
    Diffuse(reflectance=0.2),
    TwoSided(nested=(Conductor(material="Cu"),)),
    RoughConductor(material="Al", alpha=0.3),
    ThinDielectric(int_ior=1.5, ext_ior=1.0),
    Diffuse(reflectance=CHECKED),
    RoughDielectric(int_ior=1.4, ext_ior=1.0, alpha=0.15),
    RoughConductor(material="Au", alpha=0.2, distribution="ggx"),
)


def model_shapes():
    """A bulb of absorbing glass, a mirror, a rough and a diffuse ball, and a pane, by materials."""

    def placed(kind, material, scale, at, **options):
        place = rows_of(similarity(np.eye(3), scale, at))
        return UnitShape(type=kind, to_world=place, material=material, **options)

    return (
        placed("sphere", 0, 0.3, (-0.2, 0.2, 0.1), interior=Medium((0.2, 1.0, 2.0))),
        placed("sphere", 1, 0.12, (-0.2, 0.2, 0.1), radiance=(6.0, 5.0, 4.0)),
        placed("rectangle", 2, 0.6, (0.1, 0, -0.7)),
        placed("sphere", 3, 0.25, (0.4, -0.3, 0.1)),
        placed("rectangle", 4, 0.2, (0.5, 0.4, 0.4)),
        placed("sphere", 5, 0.2, (-0.5, -0.5, 0.2)),
        placed("sphere", 6, 0.15, (0.0, -0.4, 0.5)),
        placed("sphere", 7, 0.15, (0.2, 0.6, 0.0)),
    )


def test_image_is_that_of_the_model(mi, tmp_path):
    """All kinds of surfaces look as in `lumitree_path`; the background is not hidden."""
    from lumitree.rendering.register import shape
    from lumitree.rendering.studio import BACKDROP, portrait_half_width, studio_lights

    shapes = model_shapes()
    checks = np.where((np.indices((64, 64)) // 32).sum(axis=0) % 2, 230, 60).astype(np.uint8)
    checks = (checks[..., None] * [1, 0.6, 0.3]).astype(np.uint8)
    members = {**NOTHING, "images": (checks,)}
    geometry = AssetGeometry(**members, shapes=shapes, materials=MATERIALS)
    asset = with_geometry(geometry, LocalFrame(np.ones(3), np.eye(4)))
    view = {"eye": [0.6, 0.5, 3.4], "target": [0, 0, 0], "up": [0, 1, 0], "fov": 0.6}
    size = {"width": 48, "height": 48}
    call = f"await lumitree.image({json.dumps(view | size | {'samples': 512})})"
    found = evaluate(make_page(asset), call, tmp_path / "profile")
    pixels = floats(found["radiance"]).reshape(48, 48, 4)[::-1]
    film = {"type": "hdrfilm", **size, "pixel_format": "rgba", "rfilter": {"type": "box"}}
    to_world = mi.ScalarTransform4f().look_at(view["eye"], view["target"], view["up"])
    sensor = {"type": "perspective", "fov": np.degrees(0.6), "film": film, "to_world": to_world}
    lamp = shape(asset, np.eye(4), appearance="geometry")
    scene = mi.load_dict({"type": "scene", "sensor": sensor, "lamp": lamp})
    integrator = mi.load_dict({"type": "lumitree_path", "max_depth": 64})
    expected = np.array(mi.render(scene, integrator=integrator, spp=2048))
    # By blocks of pixels, because both are noisy.
    blocks = [each.reshape(12, 4, 12, 4, 4).mean(axis=(1, 3)) for each in (pixels, expected)]
    shown, wanted = (each[..., :3] for each in blocks)
    assert shown.mean(axis=(0, 1)) == pytest.approx(wanted.mean(axis=(0, 1)), rel=0.03)
    assert np.abs(shown - wanted).mean() < 0.04 * wanted.mean()
    # Rays that meet nothing pass; glass lets through what it does not reflect.
    nothing = expected[..., 3] == 0
    assert nothing.any()
    assert (pixels[..., 3][nothing] > 0.98).all()
    assert pixels[..., 3][expected[..., 3] == 1].mean() < 0.5
    # Absorbing glass tints it: the most of red.
    seen = floats(found["seen"]).reshape(48, 48, 4)[::-1, :, :3]
    np.testing.assert_allclose(seen.mean(axis=-1), pixels[..., 3], atol=1e-5)
    tinted = seen[expected[..., 3] == 1].mean(axis=0)
    assert tinted[0] > 1.1 * tinted[1] > 1.1 * tinted[2]

    # In the studio, with the lamp switched off. Cameras of the page see no softboxes.
    off = tuple(dataclasses.replace(each, radiance=None) for each in shapes)
    unlit = dataclasses.replace(asset, geometry=dataclasses.replace(geometry, shapes=off))
    lamp = shape(unlit, np.eye(4), appearance="geometry")
    lights = studio_lights(portrait_half_width(asset), 1.0)
    scene = mi.load_dict({"type": "scene", "sensor": sensor, "lamp": lamp, **lights})
    expected = np.array(mi.render(scene, integrator=integrator, spp=2048))[..., :3]
    soft = floats(found["soft"]).reshape(48, 48, 4)[::-1, :, :3]
    np.testing.assert_allclose(soft[nothing], BACKDROP, rtol=1e-5)
    surface = np.where(nothing[..., None], 0, 1).reshape(12, 4, 12, 4, 1).min(axis=(1, 3))
    shown, wanted = (
        surface * each.reshape(12, 4, 12, 4, 3).mean(axis=(1, 3)) for each in (soft, expected)
    )
    assert shown.mean(axis=(0, 1)) == pytest.approx(wanted.mean(axis=(0, 1)), rel=0.03)
    assert np.abs(shown - wanted).mean() < 0.04 * wanted.mean()


@pytest.mark.parametrize(("law", "l_max"), [("linear", 2), ("exponential", 4)])
def test_image_is_that_of_the_field(mi, tmp_path, law, l_max):
    asset = random_asset(5, tree_depth=6, law=law, l_max=l_max, half_extents=(1, 0.8, 0.9))
    asset = dataclasses.replace(asset, light_factors=(0.5, 3.0, 1.0))
    view = {"eye": [2.5, 1.7, -3.1], "target": [0.1, 0, 0], "up": [0.2, 1, 0.1], "fov": 0.6}
    size = {"width": 120, "height": 80}
    call = f"await lumitree.image({json.dumps(view | size)})"
    found = evaluate(make_page(asset), call, tmp_path / "profile")
    pixels = floats(found["radiance"]).reshape(80, 120, 4)
    direction = camera_rays(**view, **size).reshape(-1, 3)
    radiance, transmittance = asset.eval(np.tile(view["eye"], (len(direction), 1)), direction)
    expected = np.concatenate([radiance, transmittance[:, None]], axis=1).reshape(80, 120, 4)
    for channel in range(4):
        difference = np.abs(pixels - expected)[..., channel].mean()
        assert difference < 0.01 * expected[..., channel].mean()
    assert floats(found["details"]).reshape(80, 120, 4)[..., 2].max() > 3


def test_image_of_a_light_field(mi, tmp_path):
    """Without a field the page shows the light itself, and has an exposure for it."""
    light = make_light_field(*_cosine_cells(), 2)
    asset = light_field_asset(light, LocalFrame(np.array([1, 0.5, 0.5]), np.eye(4)), "light")
    view = {"eye": [0.3, -2.7, 0.5], "target": [0, 0, 0], "up": [1, 0, 0], "fov": 0.6}
    size = {"width": 60, "height": 40}
    page = make_page(asset)
    found = evaluate(page, f"await lumitree.image({json.dumps(view | size)})", tmp_path / "profile")
    pixels = floats(found["radiance"]).reshape(40, 60, 4)
    direction = camera_rays(**view, **size).reshape(-1, 3)
    from lumitree.rendering.device import DeviceAsset

    origin = on_device(mi.Point3f, np.tile(view["eye"], (len(direction), 1)))
    rays = origin, origin, on_device(mi.Vector3f, direction)
    expected = np.array(DeviceAsset(asset).light.eval(*rays)[0], np.float64).reshape(3, 40, 60)
    difference = np.abs(pixels[..., :3] - np.moveaxis(expected, 0, -1)).mean()
    assert difference < 0.05 * expected.mean()
    shown = "document.getElementById('figure-Shown').textContent"
    assert evaluate(page, f"lumitree.ready.then(() => {shown})", tmp_path / "second") == (
        "light field"
    )


def _cosine_cells():
    """Cells [8, 3] and their intensities [8, R², 3]: cos γ, downwards."""
    cells = np.array([0, 1, 1]) + np.indices((4, 2, 2)).reshape(3, -1).T[::2]
    cosine = np.maximum(-middle_directions(32)[:, 1], 0)
    colours = np.random.default_rng(0).uniform(0.2, 1, (len(cells), 1, 3))
    return cells, colours * cosine[:, None]


def test_illuminance_is_the_sum_over_cells(mi, tmp_path):
    from lumitree.measure.irradiance import asset_irradiance

    light_field = random_light_field(4, count=40)
    asset = dataclasses.replace(
        random_asset(5), light_field=light_field, light_factors=(0.5, 3.0, 1.0)
    )
    call = "await lumitree.illuminance({room: [3, 3, 3], samples: 16, patches: 48})"
    found = evaluate(make_page(asset), call, tmp_path / "profile")
    patches = floats(found["lux"]).reshape(48, 6, 48)
    means = patches.mean(axis=(0, 2))
    expected = asset_irradiance(asset, 1 << 20).lux[:6].mean(axis=(1, 2))
    assert means == pytest.approx(expected, rel=0.02)
