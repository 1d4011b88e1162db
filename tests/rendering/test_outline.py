"""A luminous opening in images: its outline, and the intensities of its file."""

import numpy as np
import pytest
from scipy.spatial import Delaunay

from lumitree.core.device import on_device
from lumitree.formats.opening import Opening
from lumitree.formats.type_c import IntensityDistribution
from lumitree.measure.floor_plan import opening_points
from lumitree.viewer.light_as_field import light_as_field
from support.slow import slow_but

OPENINGS = {
    "disc": Opening((0.3, 0.0, 0.3), "cylinder"),
    "ball": Opening((0.3, 0.3, 0.3), "ellipsoid"),
    "egg": Opening((0.4, 0.2, 0.3), "ellipsoid"),
    "tube": Opening((1.2, 0.05, 0.05), "cylinder", 0),
    "across": Opening((0.1, 0.1, 0.8), "cylinder", 2),
    "drum": Opening((0.4, 0.2, 0.3), "cylinder"),
    "box": Opening((0.6, 0.1, 0.3)),
}


def baked(opening):
    from lumitree.formats.light_field import bake_distribution

    gamma, c = np.linspace(0, 180, 37), np.arange(0, 360, 30.0)
    up = np.cos(np.deg2rad(gamma))
    intensity = 100 * (1.5 + up + 0.3 * np.sin(np.deg2rad(gamma)) * np.cos(np.deg2rad(c[:, None])))
    lamp = IntensityDistribution("lamp", c, gamma, intensity, opening)
    return lamp, bake_distribution(lamp)


def image(mi, asset, direction, count=96):
    """Radiance [count, count] of parallel rays, points across [count, count, 2], and their area."""
    from lumitree.rendering.device import DeviceAsset

    side = np.linalg.norm(asset.frame.half_extents) * 1.05
    place = side * (2 * (np.arange(count) + 0.5) / count - 1)
    u = np.cross(direction, [0.36, 0.48, 0.8])
    u /= np.linalg.norm(u)
    v = np.cross(direction, u)
    flat = np.stack(np.meshgrid(place, place), axis=-1)
    origin = flat.reshape(-1, 2) @ np.stack([u, v]) - 3 * direction
    found, through = DeviceAsset(asset).look(
        on_device(mi.Point3f, origin),
        on_device(mi.Vector3f, np.broadcast_to(direction, origin.shape)),
        True,
    )
    assert np.array(through).min() == 1
    radiance = np.array(found, np.float64).T.mean(axis=1).reshape(count, count)
    return radiance, flat @ np.stack([u, v]), (2 * side / count) ** 2


@pytest.mark.parametrize("name", slow_but(["disc", "egg", "tube"], OPENINGS))
def test_an_image_has_the_intensity_and_the_outline(mi, name):
    """The outline is the convex hull of points of the surface, of code that renders nothing."""
    lamp, asset = baked(OPENINGS[name])
    assert asset.appearance == "light"
    points = OPENINGS[name].surface()[0] / asset.frame.scale
    random = np.random.default_rng(3)
    for _ in range(3):
        direction = random.normal(size=3)
        # A flat opening is not seen from its edge.
        direction[1] = np.copysign(abs(direction[1]) + 0.5, direction[1])
        direction /= np.linalg.norm(direction)
        radiance, place, area = image(mi, asset, direction)
        watts = radiance.sum() * area * asset.frame.scale**2
        assert watts * 683 == pytest.approx(float(lamp.at(-direction)), rel=0.06)
        across = np.linalg.svd(direction[None])[2][1:]
        hull = Delaunay(points @ across.T)
        inside = hull.find_simplex(place.reshape(-1, 3) @ across.T).reshape(radiance.shape) >= 0
        differs = (radiance > 0) != inside
        # Pixels at the edge, since the points are inside of the surface.
        assert differs.sum() < 0.12 * inside.sum() + 8
        assert np.ptp(radiance[radiance > 0]) < 1e-4 * radiance.max()


def test_plans_and_pages_have_the_outline(mi):
    for name in ("disc", "ball", "drum"):
        _, asset = baked(OPENINGS[name])
        outline = asset.light_field.outline
        assert np.abs(np.linalg.norm(opening_points(outline)[:, [0, 2]], axis=1) - 1).min() < 1e-9
        shown = light_as_field(asset)
        # From above: no light in the corners of the box, the same as in the middle near its edge.
        half = asset.frame.half_extents * asset.frame.scale
        places = np.array([[0.8, 1, 0.8], [0.65, 1, 0.65], [0.0, 1, 0.0]])
        where = places * (half + np.array([0, 1, 0]))
        corner, edge, middle = shown.eval(where, np.tile([0.0, -1, 0], (3, 1)))[0].mean(axis=1)
        assert corner == 0
        assert edge > 0.2 * middle > 0
