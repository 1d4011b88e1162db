"""Light paths and straight-through radiance together have the means of camera paths."""

import numpy as np
import pytest

from lumitree.core.frames import from_viewer
from support.lamps import AREA, GLASS, cube, sphere
from support.slow import slow, slow_but
from support.traced_lamps import (
    CLUTTER,
    DIFFUSE,
    MIRROR,
    TILE,
    arrays,
    binned_sum,
    cell_of,
    everywhere,
    fog,
    octant,
    source,
    stream,
)

RAYS = 1 << 19
FROSTED = (
    '<bsdf type="roughdielectric"><float name="alpha" value="0.3"/>'
    '<float name="int_ior" value="1.5"/><float name="ext_ior" value="1"/></bsdf>'
)


def medium(sigma_t, albedo):
    """An interior medium of the given colours, "r, g, b", at most 1; sigma_t times 3."""
    return (
        '<medium type="homogeneous" name="interior"><float name="scale" value="3"/>'
        f'<rgb name="sigma_t" value="{sigma_t}"/><rgb name="albedo" value="{albedo}"/></medium>'
    )


def pane(z):
    return cube("pane", (1, 1, 0.02), (0, 0, z), GLASS)


def coarse_ball(folder, centre, bsdf):
    """An icosphere of 80 triangles with interpolated normals; a shape element."""
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=1, radius=0.5)
    path = folder / "ball.ply"
    ball.export(path, vertex_normal=True)
    x, y, z = centre
    return (
        f'<shape type="ply" id="ball"><string name="filename" value="{path}"/>'
        f'<transform name="to_world"><translate x="{x}" y="{y}" z="{z}"/></transform>{bsdf}</shape>'
    )


def shapes_of(name, folder):
    lamp = sphere("lamp", 0.4, (0.1, 0, 0.2), AREA)
    return {
        "clutter": CLUTTER,
        "pane": (lamp, pane(0.8)),
        "frosted": (lamp, sphere("ball", 1, inside=FROSTED)),
        "beside fog": (lamp, sphere("fog", 0.5, (1, 0.2, 0), fog(3.0, 0.8))),
        "in fog": (lamp, sphere("fog", 1, inside=fog(1.5, 0.8))),
        "in milk": (
            lamp,
            sphere("milk", 1, inside=GLASS + medium("0.4, 0.4, 0.4", "0.9, 0.9, 0.9")),
        ),
        "in coloured milk": (
            lamp,
            sphere("milk", 1, inside=GLASS + medium("1, 0.5, 0.2", "0.95, 0.9, 0.7")),
        ),
        "coloured glass": (
            lamp,
            sphere("ball", 0.6, (0.2, 1.1, 0), GLASS + medium("0.2, 0.4, 1", "0, 0, 0")),
        ),
        "in coloured glass": (
            lamp,
            sphere("ball", 1, inside=GLASS + medium("0.1, 0.2, 0.6", "0, 0, 0")),
        ),
        "smooth diffuse": (lamp, coarse_ball(folder, (0.9, 0.3, 0.1), DIFFUSE)),
        "smooth mirror": (lamp, coarse_ball(folder, (0.9, 0.3, 0.1), MIRROR)),
        "smooth glass": (lamp, coarse_ball(folder, (0.9, 0.3, 0.1), GLASS)),
    }[name]


SCENES = [
    *("clutter", "pane", "frosted", "beside fog", "in fog", "in milk", "in coloured milk"),
    *("coloured glass", "in coloured glass", "smooth diffuse", "smooth mirror", "smooth glass"),
]
QUICK_SCENES = ["clutter", "beside fog", "smooth glass"]


def middle(origin, direction):
    """Points of rays closest to the centre [N, 3]: the same for all origins on a line."""
    return origin - (origin * direction).sum(axis=1, keepdims=True) * direction


def rays_by(binning, origin, direction):
    """Bins of rays and how many there are."""
    if binning == "all":
        return np.zeros(len(direction), int), 1
    if binning == "octant":
        return octant(direction), 8
    return cell_of(middle(origin, direction)), 64


def agree(sums, errors, expected, expected_errors):
    """Whether sums [B, 3] are the expected ones, within what their noise allows."""
    # A bin with few paths has no reliable standard error: all such bins count as one.
    few = (np.hypot(errors, expected_errors) > 0.1 * expected).any(axis=1)

    def pooled(values):
        return np.vstack([values[~few], values[few].sum(axis=0)])

    difference = pooled(sums - expected)
    error = np.sqrt(pooled(errors**2 + expected_errors**2))
    # Rays start a little off surfaces, which costs light in narrow places.
    error = np.hypot(error, 2e-4 * expected.sum(axis=0))
    z = difference / error
    assert np.abs(z).max() < 4.5, z
    # Channels share their paths and count as one.
    assert (z**2).mean() < 1 + 5 * np.sqrt(2 / len(z))


@pytest.mark.parametrize("name", slow_but(QUICK_SCENES, SCENES))
def test_straight_through_radiance_and_light_paths_are_all_light(lamp, tmp_path, name):
    """In total, by direction, and by position: as traced by `path` and `volpath`."""
    rays = source(lamp(*shapes_of(name, tmp_path)))
    origin, direction = rays.random_rays(RAYS, stream(2))
    traced = np.array(rays.trace(origin, direction, stream(2), 1)[0], np.float64).T
    o, d = arrays(origin, direction)
    drawn = rays.draw(RAYS, stream(3), everywhere, 0.5)
    drawn_o, drawn_d, drawn_light = arrays(drawn.origin, drawn.direction, drawn.light)
    light = rays.light_paths(RAYS, stream(1))
    seen_along = from_viewer(light.direction)
    light_o, light_d, flux = arrays(light.origin, seen_along, light.flux)
    assert np.isfinite(flux).all()
    assert (flux >= 0).all()
    assert np.linalg.norm(light_d, axis=1) == pytest.approx(1, abs=1e-4)
    scale = rays.measure / RAYS
    for binning in ("all", "octant", "cell"):
        bins, count = rays_by(binning, o, d)
        expected, expected_error = binned_sum(traced * scale, bins, count, TILE)
        bins, _ = rays_by(binning, drawn_o[:RAYS], drawn_d[:RAYS])
        seen, seen_error = binned_sum(drawn_light[:RAYS] * rays.measure, bins, count, TILE)
        bins, _ = rays_by(binning, light_o, light_d)
        brought, brought_error = binned_sum(flux, bins, count)
        assert (brought.sum(axis=0) > 0).all()
        agree(seen + brought, np.hypot(seen_error, brought_error), expected, expected_error)


@pytest.mark.parametrize(
    "name",
    ["clutter", "pane", slow("frosted"), slow("smooth diffuse"), "smooth mirror", "smooth glass"],
)
def test_light_paths_have_the_termination_points_of_camera_paths(lamp, tmp_path, name):
    """Radiance by cell of the termination point and by direction."""
    from support.camera_paths import trace_to_termination

    rays = source(lamp(*shapes_of(name, tmp_path)))
    traced, points, terminated, direction = trace_to_termination(rays, RAYS, 2)
    assert (traced[~terminated] == 0).all()
    ends = rays.draw_terminated(RAYS, stream(3))
    seen_direction, seen_point, seen_light = arrays(ends.direction, ends.point, ends.radiance)
    light = rays.light_paths(RAYS, stream(1))
    seen_along = from_viewer(light.direction)
    light_direction, light_point, flux = arrays(seen_along, light.termination, light.flux)
    assert np.abs(light_point).max() < 1.001
    scale = rays.measure / RAYS
    for by_octant in (False, True):

        def bins(points, directions, with_octant=by_octant):
            cells = cell_of(points)
            return 8 * cells + octant(directions) if with_octant else cells

        num_bins = 512 if by_octant else 64
        expected, expected_error = binned_sum(
            traced * scale, bins(points, direction), num_bins, TILE
        )
        seen, seen_error = binned_sum(
            seen_light * scale, bins(seen_point, seen_direction), num_bins, TILE
        )
        brought, brought_error = binned_sum(flux, bins(light_point, light_direction), num_bins)
        agree(seen + brought, np.hypot(seen_error, brought_error), expected, expected_error)


def test_origin_and_direction_are_a_ray_of_the_camera(mi, lamp, tmp_path):
    """The camera ray that meets a light path hits the path's origin first."""
    from support.camera_paths import frame

    rays = source(lamp(*shapes_of("clutter", tmp_path)))
    light = rays.light_paths(1 << 16, stream(1))
    scale, centre = frame(rays.luminaire)
    direction = from_viewer(light.direction)
    outside = mi.Point3f(light.origin - 4 * direction)
    ray = mi.Ray3f(outside * scale + mi.Vector3f(centre), direction)
    si = rays.luminaire.scene.ray_intersect(ray)
    # Rays that graze the edge of a mesh may miss it, in single precision.
    assert np.array(si.is_valid()).mean() > 0.999
    distance = np.array(si.t) / scale
    # Rays that graze a surface may hit it far away, in single precision.
    assert (np.abs(distance - 4) < 1e-2).mean() > 0.995
    # Light that leaves an emitter straight through is left out: no path starts at the lamp.
    place = np.array(light.origin).T * scale + centre
    on_lamp = np.abs(np.linalg.norm(place, axis=1) - 0.5) < 1e-3
    assert not on_lamp.any()


def test_equal_seeds_give_equal_paths_and_other_batches_do_not(lamp, tmp_path):
    luminaire = lamp(*shapes_of("in milk", tmp_path))

    def traced(seed, batch):
        light = source(luminaire, seed=seed).light_paths(1 << 12, stream(batch))
        return np.column_stack(arrays(light.origin, light.direction, light.flux, light.termination))

    first = traced(1, 2)
    assert len(first) > 1000
    assert np.array_equal(first, traced(1, 2))
    for other in (traced(1, 3), traced(2, 2)):
        assert len(np.unique(np.concatenate([first, other]), axis=0)) == len(first) + len(other)


def test_a_lamp_seen_straight_through_has_no_light_paths(lamp):
    rays = source(lamp(sphere("lamp", 2, (1, 0, 0), AREA)))
    light = rays.light_paths(1 << 10, stream(1))
    assert (np.array(light.flux) == 0).all()
    drawn = rays.draw(1 << 10, stream(2), everywhere, 0.5)
    flux = rays.measure * np.array(drawn.light, np.float64).sum(axis=1)
    assert flux == pytest.approx(4 * np.pi**2 * np.array([3, 2, 1]), rel=0.25)


def test_directions_are_those_of_travel(lamp, tmp_path):
    """A lamp over a white floor, whose light goes up."""
    floor = cube("floor", (1, 1, 0.1), (0, 0, -1), DIFFUSE)
    rays = source(lamp(sphere("lamp", 0.1, inside=AREA), floor))
    light = rays.light_paths(1 << 14, stream(1))
    direction, flux = arrays(light.direction, light.flux)
    assert (direction[:, 2] > -1e-6).all()
    assert flux.sum() > 0
