"""Assets from photometric files and ray files, against the intensities that the files state."""

import numpy as np
import pytest

import lumitree
from lumitree.asset.light_field import unpack
from lumitree.core.device import on_device
from lumitree.core.frames import rotation, similarity
from lumitree.core.octahedral import bin_of, interpolated, middle_directions
from lumitree.core.photometry import blackbody_colour, luminance
from lumitree.formats import light_field as baking
from lumitree.formats.ies import write_ies
from lumitree.formats.ldt import write_ldt
from lumitree.formats.light_field import (
    POINT_SIZE,
    bake_distribution,
    bake_rays,
)
from lumitree.formats.opening import Opening
from lumitree.formats.tm25 import Rays, write_tm25
from lumitree.formats.type_c import Grid, IntensityDistribution, direction_of, z_up
from lumitree.rendering.asset_flux import asset_lumens, asset_watts
from lumitree.trace.light_field_config import LightFieldConfig
from support.slow import slow
from support.walls import irradiance


def spot(power=4.0, peak=1000.0, step=2.5, opening=(0.0, 0.0, 0.0)):
    """A spot light: peak · cosⁿ γ, times a factor that depends on C."""
    grid = Grid(step)
    c, gamma = np.meshgrid(np.deg2rad(grid.c), np.deg2rad(grid.gamma), indexing="ij")
    # The factor fades at the pole, where all C are one direction.
    factor = 1 + 0.5 * np.sin(gamma) * np.cos(c - 0.7)
    intensity = peak * np.maximum(np.cos(gamma), 0) ** power * factor
    return IntensityDistribution("spot", grid.c, grid.gamma, intensity, Opening(opening), 5000.0)


def analytic(direction, power=4.0, peak=1000.0):
    """Intensity of `spot` in a direction."""
    x, y, z = np.moveaxis(np.asarray(direction) / np.linalg.norm(direction), -1, 0)
    return peak * max(-y, 0) ** power * (1 + 0.5 * (x * np.cos(0.7) - z * np.sin(0.7)))


def bin_intensity(asset, direction):
    """Luminous intensity [N], cd, of the bins of all cells together."""
    mi = pytest.importorskip("mitsuba")
    field = asset.light_field
    table = field.dense(luminance(unpack(field.intensity))).sum(axis=0) * field.scale
    directions = np.asarray(direction)
    vectors = on_device(mi.Vector3f, directions.reshape(-1, 3))
    bins = np.array(bin_of(vectors, field.resolution)).reshape(directions.shape[:-1])
    return table[bins] * asset.frame.scale**2


@pytest.mark.parametrize("opening", [(0, 0, 0), (0.6, 0, 0.2), (1.0, 2.0, 0.5)])
def test_a_distribution_keeps_its_flux_and_its_intensities(mi, opening):
    distribution = spot(opening=opening)
    asset = bake_distribution(distribution)
    assert asset_lumens(asset) == pytest.approx(distribution.lumens, rel=1e-3)
    sides = (
        [max(side, max(opening) * 1e-3) for side in opening] if any(opening) else [POINT_SIZE] * 3
    )
    assert asset.frame.size == pytest.approx(sides)
    assert asset.frame.centre.tolist() == [0, 0, 0]
    c, gamma = np.meshgrid(np.arange(3, 360, 7), np.arange(1, 70, 3))
    direction = direction_of(c, gamma).reshape(-1, 3)
    # A direction is at most 2 degrees from the middle of its bin, and the intensity changes by at
    # most 2 peaks a radian.
    exact = [analytic(each) for each in direction]
    found = bin_intensity(asset, direction)
    assert found == pytest.approx(np.array(exact), abs=1000 * 2 * np.deg2rad(2))
    assert found.mean() == pytest.approx(np.mean(exact), rel=3e-3)


@pytest.mark.parametrize("power", [3, 10])
def test_smooth_intensities_are_right_in_the_planes_of_a_diagram(power):
    """C = 0 and C = 90 of cosⁿ γ, in the edges of the octahedral map, with few bins."""

    class Lobe:
        name, lumens = "lobe", 2 * np.pi / (power + 1)

        def at(self, direction):
            return np.maximum(-direction[..., 1] / np.linalg.norm(direction, axis=-1), 0) ** power

    values = baking.intensity_by_bin(Lobe())
    assert len(values) == 64**2
    gamma = np.arange(0, 80, 0.25)
    for c in (0, 45, 90, 180, 270):
        direction = direction_of(np.full_like(gamma, c), gamma)
        found = interpolated(values, direction)
        assert np.abs(found - Lobe().at(direction)).max() < 0.005


def test_an_edge_of_the_light_does_not_ring(mi):
    """100 cd below, dark above: no bin gets more, and the flux is a half sphere's."""
    gamma = np.array([0.0, 90, 90.001, 180])
    lamp = IntensityDistribution("half", np.zeros(1), gamma, np.array([[100.0, 100, 0, 0]]))
    asset = bake_distribution(lamp)
    found = bin_intensity(asset, middle_directions(256))
    assert 0 <= found.min() <= found.max() < 100.5
    assert asset_lumens(asset) == pytest.approx(200 * np.pi, rel=2e-3)


def even(opening, gamma_power=0.0):
    """100 cosⁿ γ cd below; n = 0 is 100 cd in all directions."""
    grid = Grid(2.5)
    cosine = np.cos(np.deg2rad(grid.gamma))
    rows = np.maximum(cosine, 0) ** gamma_power if gamma_power else np.ones_like(cosine)
    return IntensityDistribution(
        "even", grid.c, grid.gamma, np.broadcast_to(100 * rows, (len(grid.c), len(rows))), opening
    )


RADIUS = 0.2
SPHERE = Opening((2 * RADIUS,) * 3, "ellipsoid")
DISK = Opening((2 * RADIUS, 0.0, 2 * RADIUS), "cylinder")
SQUARE = Opening((2 * RADIUS, 0.0, 2 * RADIUS))
ROD = Opening((2.0, 0.1, 0.1), "cylinder", 0)
UPRIGHT = Opening((0.0, 2 * RADIUS, 2 * RADIUS), "cylinder", 0)


def square_corner(x, y):
    """Configuration factor of a rectangle x by y from a point at unit distance below its corner."""
    a, b = np.hypot(1, x), np.hypot(1, y)
    return (x / a * np.arctan(y / a) + y / b * np.arctan(x / b)) / (2 * np.pi)


def rod_lux(distance):
    """Irradiance beside the middle of a line of length 2 with 100 cd in all directions."""
    along = np.linspace(-1, 1, 20001)
    return np.mean(100 * distance / np.hypot(distance, along) ** 3)


@pytest.mark.parametrize(
    ("opening", "power", "point", "exact"),
    [
        # A sphere of even radiance has the irradiance of a point at its centre.
        (SPHERE, 0, [0, -1.2 * RADIUS, 0], 100 / (1.2 * RADIUS) ** 2),
        slow(SPHERE, 0, [0, -2 * RADIUS, 0], 100 / (2 * RADIUS) ** 2),
        # π L r² / (r² + h²), where 100 cd are π r² L.
        (DISK, 1, [0, -RADIUS / 2, 0], 100 / (1.25 * RADIUS**2)),
        slow(DISK, 1, [0, -RADIUS, 0], 100 / (2 * RADIUS**2)),
        # π L times four corners, where 100 cd are 4 r² L.
        slow(SQUARE, 1, [0, -RADIUS, 0], 100 / (4 * RADIUS**2) * np.pi * 4 * square_corner(1, 1)),
        slow(ROD, 0, [0, -0.5, 0], rod_lux(0.5)),
        slow(UPRIGHT, 0, [2 * RADIUS, 0, 0], None),
    ],
)
def test_near_an_opening(mi, tmp_path, opening, power, point, exact):
    """Where inverse squares do not hold: against closed forms."""
    asset = bake_distribution(even(opening, power))
    assert asset_lumens(asset) == pytest.approx(even(opening, power).lumens, rel=2e-3)
    path = tmp_path / "lamp.lumitree"
    lumitree.save(asset, path)
    if exact is None:
        # All parts of the disk send 100 cd in proportion to their area.
        radius = np.sqrt((np.arange(4000) + 0.5) / 4000) * RADIUS
        exact = np.mean(100 * point[0] / (point[0] ** 2 + radius**2) ** 1.5)
    lamp, normal = lumitree.shape(path), [-x for x in point]
    found, error = irradiance(mi, {"lamp": lamp}, point, normal, samples=1 << 16)
    lux, noise = luminance(found), luminance(error)
    assert noise < 0.008 * exact
    # The first point is nearer to the sphere than a cell is wide.
    assert lux == pytest.approx(exact, rel=0.05 if exact > 1000 else 0.025)


# Where the light falls, relative to the lamp; the second is off the axis, in a known C.
POINTS = {"below": ([0, -2, 0], [0, 1, 0]), "aside": ([0.8, -1.2, 0.5], [-0.5, 1, 0])}


@pytest.mark.parametrize("name", POINTS)
@pytest.mark.parametrize("turned", [False, True])
def test_a_wall_gets_the_analytic_illuminance(mi, tmp_path, name, turned):
    """E = I cos θ / d², rendered from an IES file with next-event estimation."""
    path = tmp_path / "spot.ies"
    write_ies(path, spot())
    lumitree.bake(path, tmp_path / "spot.lumitree")
    matrix = rotation([1, 0, 0], 90) if turned else np.eye(3)
    point, normal = (matrix @ np.array(each, float) for each in POINTS[name])
    lamp = lumitree.shape(tmp_path / "spot.lumitree", similarity(matrix))
    found, error = irradiance(mi, {"lamp": lamp}, point, normal, samples=1 << 16)
    there, facing = (np.array(each, float) for each in POINTS[name])
    distance = np.linalg.norm(there)
    cosine = -there @ facing / distance / np.linalg.norm(facing)
    exact = analytic(there) * cosine / distance**2
    lux, noise = luminance(found), luminance(error)
    assert noise < 0.005 * exact
    # The bin in which the wall is has the mean intensity of its directions.
    assert lux == pytest.approx(exact, rel=0.03)
    assert np.ptp(found) < 1e-4 * found.max()


def test_files_of_all_kinds_have_one_flux(mi, tmp_path):
    distribution = spot(opening=(0.2, 0.1, 0.3))
    write_ies(tmp_path / "a.ies", distribution)
    write_ldt(tmp_path / "a.LDT", distribution)
    rays = uniform_rays(1 << 12)
    write_tm25(tmp_path / "a.ray", rays, "box")
    write_tm25(tmp_path / "a.tm25ray", rays, "box")
    for name, lumens in (
        ("a.ies", distribution.lumens),
        ("a.LDT", distribution.lumens),
        ("a.ray", luminance(rays.flux.sum(axis=0))),
        ("a.tm25ray", luminance(rays.flux.sum(axis=0))),
    ):
        result = lumitree.bake(tmp_path / name, tmp_path / "a.lumitree")
        assert asset_lumens(result.asset) == pytest.approx(float(lumens), rel=2e-3)
        assert result.asset.num_leaves == 0
        assert lumitree.load(result.path).light_field is not None
        assert result.held_out_psnr is None


def uniform_rays(count, seed=0):
    """Rays from all of a box, down and to the side, coloured."""
    random = np.random.default_rng(seed)
    origin = (random.random((count, 3)) - 0.5) * [0.4, 0.3, 0.15] + [1, 2, 3]
    direction = random.normal(size=(count, 3))
    direction[:, 1] = -np.abs(direction[:, 1])
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return Rays(origin, direction, random.random((count, 3)) * [3, 2, 1] / count)


def test_rays_become_a_histogram(mi):
    """Flux by cell and by hemisphere, and the box of the starting points."""
    rays = uniform_rays(1 << 14)
    config = LightFieldConfig(depth=2, resolution=8)
    asset = bake_rays(rays, "box", config)
    assert asset.frame.centre == pytest.approx([1, 2, 3], abs=1e-3)
    assert asset.frame.size == pytest.approx([0.4, 0.3, 0.15], rel=2e-3)
    assert asset_lumens(asset) == pytest.approx(luminance(rays.flux.sum(axis=0)), rel=2e-3)
    # Cells have a side of 0.1, so the box has 4, 4 and 2 along its sides.
    assert len(asset.light_field.cells) == 4 * 4 * 2
    ups = bin_intensity(asset, direction_of([0, 90, 200], [120, 150, 170]))
    assert ups.tolist() == [0, 0, 0]
    # White balance of the mean colour: 3 : 2 : 1.
    field = asset.light_field
    colour = unpack(field.intensity).mean(axis=0)
    assert colour / colour[2] == pytest.approx([3, 2, 1], rel=0.05)


def test_z_is_up_in_ray_files(mi, tmp_path):
    """Light along -z of the file goes down."""
    rays = Rays(np.zeros((1, 3)), np.array([[0.0, -1, 0]]), np.ones((1, 3)))
    assert z_up(rays.direction).tolist() == [[0, 0, -1]]
    path = tmp_path / "down.ray"
    write_tm25(path, rays, "down")
    asset = lumitree.bake(path).asset
    assert bin_intensity(asset, [[0.01, -1, 0.01]])[0] > 0
    assert bin_intensity(asset, [[0, 1, 0], [1, 0, 0]]).tolist() == [0, 0]


def test_lumens_and_temperature(mi, tmp_path):
    write_ies(tmp_path / "a.ies", spot())
    warm = lumitree.bake(tmp_path / "a.ies", lumens=800.0, temperature=2700.0).asset
    assert asset_lumens(warm) == pytest.approx(800, rel=1e-3)
    colour = asset_watts(warm)
    expected = np.array(blackbody_colour(2700.0))
    assert colour / colour[0] == pytest.approx(expected / expected[0], abs=5e-3)
