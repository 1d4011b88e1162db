"""Illuminance, against the analytical cases of CIE 171:2006 for electric light.

Numbers in parentheses name the cases. Configuration factors are by Lambert's formula for
polygons. Lengths are in metres, y is up.
"""

import numpy as np
import pytest

import lumitree
from lumitree.core.photometry import LUMENS_PER_WATT
from support.ies_text import ies_text
from support.slow import slow

UP, DOWN = (0, 1, 0), (0, -1, 0)
# Standard error that is asked for.
ERROR = 0.004


def agree(found, error, exact):
    """Each point within 0.5 % and four standard errors, and their mean within 0.5 %."""
    exact = np.broadcast_to(exact, np.shape(found))
    assert (error <= 0.006 * exact).all()
    assert (np.abs(found - exact) <= 0.005 * exact + 4 * error).all()
    assert np.mean(found) == pytest.approx(np.mean(exact), rel=0.005)


def soft(direction):
    """Luminous intensity, cd, of `soft_lamp`: linear in the unit direction [..., 3]."""
    x, y, z = np.moveaxis(np.asarray(direction, np.float64), -1, 0)
    return 300 + 120 * -y + 90 * x + 60 * z


def lamp_file(folder, intensity, name="lamp", opening=(0, 0, 0), step=5.0):
    """Path of an IES file of a function of the unit direction, every few degrees."""
    c, gamma = np.arange(0, 360 + step, step), np.arange(0, 180 + step, step)
    across, along = np.deg2rad(np.meshgrid(c, gamma, indexing="ij"))
    direction = np.stack(
        [np.sin(along) * np.cos(across), -np.cos(along), -np.sin(along) * np.sin(across)], axis=-1
    )
    path = folder / f"{name}.ies"
    path.write_text(ies_text(intensity(direction), c, gamma, opening))
    return path


def from_point(intensity, source, points, normals):
    """Illuminance [N], lx, of a point source: inverse square and cosine."""
    way = np.asarray(source) - points
    squared = (way**2).sum(axis=1)
    direction = way / np.sqrt(squared)[:, None]
    return intensity(-direction) * np.maximum((direction * normals).sum(axis=1), 0) / squared


def factor(points, normals, corners):
    """Configuration factor [N] of a polygon [..., K, 3] that is above the horizon of the points."""
    way = np.asarray(corners) - np.asarray(points)[..., None, :]
    following = np.roll(way, -1, axis=-2)
    cross = np.cross(way, following)
    length = np.linalg.norm(cross, axis=-1)
    angle = np.arctan2(length, (way * following).sum(axis=-1))
    along = (cross * np.asarray(normals)[..., None, :]).sum(axis=-1)
    # An edge towards the point adds nothing.
    cosine = along / np.maximum(length, 1e-300)
    return np.abs((angle * cosine).sum(axis=-1)) / (2 * np.pi)


def rectangle(centre, first, second):
    """Corners [4, 3] by two half edges."""
    centre, first, second = map(np.array, (centre, first, second))
    return np.array(
        [centre + i * first + j * second for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))], float
    )


def wall(mi, centre, first, second, reflectance=0.0, **more):
    """A diffuse rectangle by two half edges, whose cross product is its normal."""
    normal = np.cross(first, second)
    columns = [*np.array([first, second, normal / np.linalg.norm(normal), centre], float)]
    matrix = np.vstack([np.stack(columns, axis=1), [0, 0, 0, 1]])
    colour = {"type": "rgb", "value": reflectance}
    return {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f(matrix),
        "bsdf": {"type": "diffuse", "reflectance": colour},
        **more,
    }


def emission(luminance):
    """Emitter of an even luminance, cd/m²."""
    return {"type": "area", "radiance": {"type": "rgb", "value": luminance / LUMENS_PER_WATT}}


# Faces of a cube of half side 1: normal into the cube, and two edges whose cross product it is.
FACES = [
    (sign * np.eye(3)[axis], np.eye(3)[(axis + 1) % 3], sign * np.eye(3)[(axis + 2) % 3])
    for axis in range(3)
    for sign in (-1, 1)
]


def cube(mi, half, reflectance):
    """A scene of the inner faces of a cube around the origin."""
    faces = {
        f"face_{i}": wall(mi, -half * n, half * u, half * v, reflectance)
        for i, (n, u, v) in enumerate(FACES)
    }
    return mi.load_dict({"type": "scene", **faces})


def patches(half, count):
    """Centres, normals [P, 3] and corners [P, 4, 3] of count² patches of each face of the cube."""
    middle = ((np.arange(count) + 0.5) / count * 2 - 1) * half
    s, t = (each.ravel()[:, None] for each in np.meshgrid(middle, middle))
    centres = np.concatenate([-half * n + s * u + t * v for n, u, v in FACES])
    normals = np.repeat([n for n, _, _ in FACES], count**2, axis=0)
    edges = [np.repeat([f[i] for f in FACES], count**2, axis=0) * half / count for i in (1, 2)]
    signs = ((-1, -1), (1, -1), (1, 1), (-1, 1))
    corners = np.stack([centres + i * edges[0] + j * edges[1] for i, j in signs], axis=1)
    return centres, normals, corners


def placed(path, at):
    """The lamp of a file, whose luminous opening is centred at a point."""
    return [lumitree.Placement(path, at=tuple(map(float, at)))]


def test_a_point_source_on_horizontal_and_vertical_planes(mi, tmp_path):
    """(5.2) Inverse square and cosine law."""
    path, source = lamp_file(tmp_path, soft), np.array([0.37, 3.0, -0.24])
    floor = [(x, 0, z) for x in (-2.0, -0.7, 0.3, 1.6) for z in (-1.5, 0.4, 2.0)]
    side = [(-2.5, y, z) for y in (0.3, 1.7, 2.9) for z in (-1.5, 0.1, 1.2)]
    points = np.array([*floor, *side], float)
    normals = np.array([UP] * len(floor) + [(1, 0, 0)] * len(side), float)
    room = mi.load_dict({"type": "scene", "floor": wall(mi, (0, -1, 0), (9, 0, 0), (0, 0, -9))})
    found = lumitree.illuminance(
        room, placed(path, source), points=points, normals=normals, error=ERROR
    )
    exact = from_point(soft, source, points, normals)
    agree(found.direct, found.direct_error, exact)
    # Nothing reflects.
    agree(found.total, found.total_error, exact)


HEIGHT, LUMINANCE = 2.0, 1000.0


def below_a_square(mi, shapes, lamps):
    """Direct illuminance below and beside a Lambertian square, 1 m, and what it is exactly."""
    floor = [(x, 0, z) for x in (0.0, 0.6, 1.5) for z in (0.0, 1.0, 2.2)]
    side = [(-1.5, y, z) for y in (0.2, 0.9, 1.5) for z in (0.0, 1.2)]
    points = np.array([*floor, *side], float)
    normals = np.array([UP] * len(floor) + [(1, 0, 0)] * len(side), float)
    found = lumitree.illuminance(
        mi.load_dict(
            {"type": "scene", "floor": wall(mi, (0, -1, 0), (9, 0, 0), (0, 0, -9)), **shapes}
        ),
        lamps,
        points=points,
        normals=normals,
        error=ERROR,
        direct=True,
    )
    corners = rectangle((0, HEIGHT, 0), (0.5, 0, 0), (0, 0, 0.5))
    return found, LUMINANCE * np.pi * factor(points, normals, corners)


def emitting_square(mi):
    return wall(mi, (0, HEIGHT, 0), (0.5, 0, 0), (0, 0, 0.5), emitter=emission(LUMINANCE))


@pytest.mark.parametrize("kind", ["emitter", "file"])
def test_an_area_source_on_parallel_and_perpendicular_planes(mi, tmp_path, kind):
    """(5.3) A Lambertian square by an emitter of the scene, and by an IES file."""
    if kind == "emitter":
        found, exact = below_a_square(mi, {"lamp": emitting_square(mi)}, [])
    else:
        path = lamp_file(
            tmp_path, lambda d: LUMINANCE * np.maximum(-d[..., 1], 0), "square", (1, 1, 0), step=2.5
        )
        found, exact = below_a_square(mi, {}, placed(path, (0, HEIGHT, 0)))
    agree(found.direct, found.direct_error, exact)


@pytest.mark.slow
def test_a_baked_area_source(mi):
    """(5.3) The light of a bake has noise, which independent bakes show."""
    ratios = []
    for seed in range(6):
        lamp = mi.load_dict({"type": "scene", "lamp": emitting_square(mi)})
        config = lumitree.BakeConfig(parts=("light",), irradiance_paths=0, seed=seed)
        asset = lumitree.bake(lamp, None, config).asset
        found, exact = below_a_square(mi, {}, [lumitree.Placement(asset, at=(0, HEIGHT, 0))])
        ratios.append(found.direct / exact)
    # Each bake. A value has a standard deviation of 0.2 to 2 %, by its point.
    assert (np.sqrt(np.square(np.array(ratios) - 1).mean(axis=1)) < 0.02).all()
    # All points together, and each, but for noise, by the spread of all: six values say little.
    for values in (np.mean(ratios, axis=1), np.array(ratios)):
        error = np.sqrt(np.var(values, axis=0, ddof=1).mean() / len(values))
        assert (np.abs(np.mean(values, axis=0) - 1) < 0.005 + 4 * error).all()


def test_the_walls_of_a_box_get_the_flux_of_the_lamp(mi, tmp_path):
    """(5.4) Luminous flux is conserved."""
    half, count = 1.5, 20
    lamps = placed(lamp_file(tmp_path, soft), (0, 0, 0))
    centres, normals, _ = patches(half * (1 - 1e-4), count)
    found = lumitree.illuminance(
        cube(mi, half, 0.0), lamps, points=centres, normals=normals, error=0.01, direct=True
    )
    # The sum over middles of patches differs from the integral by 0.06 %.
    area = (2 * half / count) ** 2
    error = np.sqrt((found.direct_error**2).sum()) * area
    agree(found.direct.sum() * area, error, 4 * np.pi * 300)


def test_light_through_a_clear_pane(mi):
    """(5.5) Fresnel's transmittance by angle, of a pane between a Lambertian square and points.

    A renderer without polarisation has (1 - R) / (1 + R) with R the mean of both polarisations. At
    60 degrees that is 1.5 % less than the mean of both transmittances.
    """
    height, level, index = 2.0, 1000.0, 1.5
    room = mi.load_dict(
        {
            "type": "scene",
            "lamp": wall(mi, (0, height, 0), (1, 0, 0), (0, 0, 1), emitter=emission(level)),
            "pane": {
                "type": "rectangle",
                "to_world": mi.ScalarTransform4f().translate([0, 1, 0]).rotate([1, 0, 0], 90)
                @ mi.ScalarTransform4f().scale(20),
                "bsdf": {"type": "thindielectric", "int_ior": index, "ext_ior": 1.0},
            },
        }
    )
    points = np.array([(0.0, 0, 0), (1.5, 0, 0.5), (2.5, 0, -1.0)])
    normals = np.tile(UP, (len(points), 1)).astype(float)
    found = lumitree.illuminance(room, points=points, normals=normals, error=ERROR)
    middle = (np.arange(200) + 0.5) / 100 - 1
    on_lamp = np.stack(np.broadcast_arrays(middle[:, None], height, middle), axis=-1).reshape(-1, 3)
    way = on_lamp - points[:, None]
    distance = np.linalg.norm(way, axis=-1)
    cosine = way[..., 1] / distance
    inside = np.sqrt(1 - (1 - cosine**2) / index**2)
    senkrecht = (cosine - index * inside) / (cosine + index * inside)
    parallel = (index * cosine - inside) / (index * cosine + inside)
    reflected = (senkrecht**2 + parallel**2) / 2
    light = level * (1 - reflected) / (1 + reflected) * (cosine / distance) ** 2
    agree(found.total, found.total_error, light.mean(axis=1) * 4)


@pytest.mark.slow
@pytest.mark.parametrize("obstructed", [False, slow(True)])
def test_light_that_a_diffuse_square_reflects(mi, tmp_path, obstructed):
    """(5.6, 5.7) An evenly lit square, 2 m, lights a ceiling and a wall; a plate may hide some."""
    reflectance, lit, height = 0.8, 500.0, 4.0
    # Even on the plane below: E = I cos³ γ / h². It ends beyond the square's corners.
    path = lamp_file(
        tmp_path,
        lambda d: np.where(-d[..., 1] > 0.93, lit * height**2 / np.abs(d[..., 1]) ** 3, 0),
        step=1.0,
    )
    shapes = {"square": wall(mi, (0, 0, 0), (1, 0, 0), (0, 0, -1), reflectance)}
    points = np.array([(x, 1.2, z) for x in (1.4, 1.8) for z in (0.0, 0.7)] + [(1.5, 0.7, 0.2)])
    normals = np.array([DOWN] * 4 + [(-1, 0, 0)], float)
    seen = factor(points, normals, rectangle((0, 0, 0), (1, 0, 0), (0, 0, 1)))
    if obstructed:
        # The plate, of x from 0.95 to 2.2 and |z| < 2, is at half the height: points of the ceiling
        # see the square up to twice its left edge less their own x.
        plate = ((1.575, 0.6, 0), (0.625, 0, 0))
        shapes["plate"] = wall(mi, *plate, (0, 0, -2))
        shapes["its other side"] = wall(mi, *plate, (0, 0, 2))
        points, normals = points[:4], normals[:4]
        end = 2 * 0.95 - points[:, 0]
        parts = [rectangle(((e - 1) / 2, 0, 0), ((e + 1) / 2, 0, 0), (0, 0, 1)) for e in end]
        seen = factor(points, normals, np.array(parts))
    found = lumitree.illuminance(
        mi.load_dict({"type": "scene", **shapes}),
        placed(path, (0, height, 0)),
        points=points,
        normals=normals,
        error=0.0055,
    )
    assert not found.direct.any()
    agree(found.total, found.total_error, reflectance * lit * seen)


@pytest.mark.parametrize("reflectance", [0.3, slow(0.8)])
def test_light_that_a_cube_reflects(mi, tmp_path, reflectance):
    """(5.8) Points of the inner faces of a cube, by radiosity with configuration factors."""
    half, source = 2.0, np.array([0.57, 0.6, -0.43])
    lamps = placed(lamp_file(tmp_path, soft), source)
    centres, normals, _ = patches(half * (1 - 1e-4), 4)
    found = lumitree.illuminance(
        cube(mi, half, reflectance), lamps, points=centres, normals=normals, error=ERROR
    )
    indirect, exact = found.total - found.direct, radiosity(half, reflectance, source, centres)
    agree(found.total, found.total_error, from_point(soft, source, centres, normals) + exact)
    error = np.hypot(found.total_error, found.direct_error)
    assert (np.abs(indirect - exact) <= 0.005 * exact + 4 * error).all()
    agree(indirect.mean(), np.sqrt((error**2).mean() / len(error)), exact.mean())


def test_the_radiosity_of_a_cube_has_its_mean_illuminance():
    """(5.8) Φ ρ / (A (1 - ρ)) is the mean of the reference that rendered light is compared with."""
    half, reflectance, source = 2.0, 0.8, np.array([0.57, 0.6, -0.43])
    found = radiosity(half, reflectance, source, patches(half, 12)[0])
    mean = 4 * np.pi * 300 * reflectance / (6 * (2 * half) ** 2 * (1 - reflectance))
    # Constant patches of a twelfth of a side do not conserve flux exactly.
    assert found.mean() == pytest.approx(mean, rel=0.005)


def radiosity(half, reflectance, source, points, count=12):
    """Indirect illuminance [N] of points on a cube's faces, by constant patches."""
    centres, normals, corners = patches(half, count)
    fine = patches(half, 4 * count)
    direct = from_point(soft, source, *fine[:2])
    # Mean over the 16 parts of each patch.
    direct = direct.reshape(6, count, 4, count, 4).mean(axis=(2, 4)).ravel()
    between = factors(centres, normals, normals, corners)
    system = np.eye(len(centres)) - reflectance * between
    total = np.linalg.solve(system, direct)
    at = normals[np.argmin(((points[:, None] - centres) ** 2).sum(axis=2), axis=1)]
    return factors(points, at, normals, corners) @ (reflectance * total)


def factors(points, normals, patch_normals, corners):
    """Configuration factors [N, P] of patches of a cube; 0 of those in the plane of the point."""
    found = factor(points[:, None], normals[:, None], corners[None])
    return np.where(normals @ patch_normals.T > 0.5, 0, found)


@pytest.mark.parametrize("reflectance", [0.5, 0.9])
def test_an_integrating_sphere(mi, tmp_path, reflectance):
    """(5.8, of a sphere) Φ ρ / (4 π r² (1 - ρ)) everywhere, wherever the source is."""
    radius, source = 1.0, np.array([0.2, 0.3, -0.1])
    sphere = {
        "type": "sphere",
        "radius": radius,
        "flip_normals": True,
        "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": reflectance}},
    }
    outward = np.random.default_rng(3).normal(size=(8, 3))
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    points = 0.999 * radius * outward
    found = lumitree.illuminance(
        mi.load_dict({"type": "scene", "sphere": sphere}),
        placed(lamp_file(tmp_path, soft), source),
        points=points,
        normals=-outward,
        error=ERROR,
    )
    direct = from_point(soft, source, points, -outward)
    agree(found.direct, found.direct_error, direct)
    indirect = 4 * np.pi * 300 * reflectance / (4 * np.pi * radius**2 * (1 - reflectance))
    agree(found.total, found.total_error, direct + indirect)
