"""The first octree against fields whose density and emission are known."""

import numpy as np
import pytest

from lumitree.fit.octree.config import EstimateConfig
from support.lamps import AREA, cube, sphere

RADIANCE = np.array([3.0, 2.0, 1.0])
RAYS = 1 << 20


def settings(rays):
    return EstimateConfig(rays=rays, growth_rays=rays)


def source(luminaire):
    from lumitree.fit.octree.rays import TracedRays

    return TracedRays(luminaire, 1 / 64)


def all_cells(level):
    side = 1 << level
    return np.stack(np.meshgrid(*[np.arange(side)] * 3, indexing="ij"), -1).reshape(-1, 3)


def corner_distances(cells, level):
    """Smallest and largest distance [M] of cells from the centre, local units."""
    low = cells * (2 / (1 << level)) - 1
    high = low + 2 / (1 << level)
    nearest = np.clip(0, low, high)
    farthest = np.maximum(np.abs(low), np.abs(high))
    return np.linalg.norm(nearest, axis=1), np.linalg.norm(farthest, axis=1)


def has(cells, others):
    """Whether each of `others` is among the cells."""
    found = {tuple(cell) for cell in cells.tolist()}
    return np.array([tuple(cell) in found for cell in others.tolist()])


@pytest.mark.parametrize("law", ["linear", "exponential"])
def test_density_of_fog_gives_the_measured_opacity(lamp, law):
    """The opacity of a cell, mean over all chords, is the law's opacity of its mean chord."""
    from lumitree.fit.octree.estimate import estimate

    level, sigma = 4, 0.75
    fog = (
        '<bsdf type="null"/><medium type="homogeneous" name="interior">'
        f'<float name="sigma_t" value="{sigma}"/><float name="albedo" value="0"/></medium>'
    )
    rays = source(lamp(sphere("fog", 2, inside=fog), sphere("lamp", 0.01, inside=AREA)))
    result = estimate(rays, all_cells(level), level, 0, law, 10.0, settings(RAYS))
    nearest, farthest = corner_distances(result.cells, level)
    assert (nearest < 1 + 1e-4).all()
    inside = (farthest < 1) & (nearest > 0.02)
    assert inside.sum() > 1000
    chords = cube_chords(2 / (1 << level))
    opacity = (1 - np.exp(-2 * sigma * chords)).mean()
    depth = opacity if law == "linear" else -np.log(1 - opacity)
    rate = depth / chords.mean()
    density = result.density[inside]
    error = density.std(ddof=1) / np.sqrt(len(density))
    assert error < 0.003 * rate
    assert abs(density.mean() - rate) < 4 * error


def cube_chords(side):
    """Lengths in a cube of random rays that meet it."""
    random = np.random.default_rng(4)
    direction = random.normal(size=(1 << 20, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    middle = random.normal(size=direction.shape)
    middle -= (middle * direction).sum(axis=1, keepdims=True) * direction
    middle *= (np.sqrt(random.random((len(middle), 1))) * np.sqrt(3) * side / 2) / np.linalg.norm(
        middle, axis=1, keepdims=True
    )
    planes = np.stack([(sign * side / 2 - middle) / direction for sign in (-1, 1)])
    length = planes.max(axis=0).min(axis=1) - planes.min(axis=0).max(axis=1)
    return length[length > 0]


def opaque_sphere(lamp):
    return source(lamp(sphere("lamp", 2, (1, 0, 0), AREA)))


@pytest.mark.slow
@pytest.mark.parametrize("l_max", [0, 2])
def test_emission_of_an_opaque_surface_is_its_radiance(lamp, l_max):
    """On the outside. The leaves of the interior, which no ray enters, are kept and opaque."""
    from lumitree.core.harmonics import basis_array
    from lumitree.fit.octree.estimate import estimate
    from lumitree.fit.octree.leaf_field import OPAQUE_DEPTH

    level, max_radiance = 4, 10.0
    result = estimate(
        opaque_sphere(lamp),
        all_cells(level),
        level,
        l_max,
        "exponential",
        max_radiance,
        settings(8 * RAYS),
    )
    nearest, farthest = corner_distances(result.cells, level)
    side = 2 / (1 << level)
    interior = farthest < 1 - 1e-4
    expected = all_cells(level)
    expected = expected[corner_distances(expected, level)[1] < 1 - 1e-4]
    assert interior.sum() == len(expected)
    assert result.density[interior] == pytest.approx(OPAQUE_DEPTH / side)

    # No cell is outside, and every cell with a large enough part of the surface is there.
    assert (nearest < 1 + 1e-4).all()
    centres = (result.cells + 0.5) * side - 1
    distance = np.linalg.norm(centres, axis=1)
    seen = np.abs(distance - 1) < side / 4
    outwards = centres[seen] / distance[seen, None]
    y = basis_array(outwards, l_max)
    raw = np.einsum("mck,mk->mc", result.coefficients[seen], y)
    emission = max_radiance / (1 + np.exp(-raw))
    assert seen.sum() > 300
    # The pseudo-count of the prior is 20 paths; several thousand rays terminate in such a leaf.
    assert emission == pytest.approx(np.tile(RADIANCE, (seen.sum(), 1)), rel=0.02)


def test_what_ends_at_the_border_is_as_dense_as_its_mirror_image(lamp):
    """Plates whose outer faces lie on the proxy box: on the last cells' far border for one."""
    from lumitree.fit.octree.estimate import estimate, inside_box

    level = 4
    plates = [cube(f"plate{sign}", (2, 2, 0.04), (0, 0, 0.96 * sign), AREA) for sign in (-1, 1)]
    rays = source(lamp(*plates))
    half = rays.subject.frame.half_extents
    assert half == pytest.approx([1, 1, 0.5])
    cells = all_cells(level)[inside_box(all_cells(level), level, half)]
    result = estimate(rays, cells, level, 0, "exponential", 10.0, settings(RAYS))
    inner = ((result.cells[:, :2] > 0) & (result.cells[:, :2] < 15)).all(axis=1)
    low, high = (result.density[inner & (result.cells[:, 2] == layer)] for layer in (4, 11))
    assert len(low) == len(high) == 14 * 14
    assert low.mean() * 2 / (1 << level) > 1
    assert high.mean() == pytest.approx(low.mean(), rel=0.03)


def test_grow_keeps_what_the_surface_touches(lamp):
    from lumitree.fit.octree.estimate import grow

    level = 6
    cells = grow(opaque_sphere(lamp), level, settings(RAYS))
    assert len(np.unique(cells, axis=0)) == len(cells)
    nearest, farthest = corner_distances(cells, level)
    centres = (all_cells(level) + 0.5) * (2 / (1 << level)) - 1
    touched = np.abs(np.linalg.norm(centres, axis=1) - 1) < 0.5 / (1 << level)
    assert has(cells, all_cells(level)[touched]).all()
    # Empty cells are dropped, except for the other children of a parent.
    parent_side = 4 / (1 << level)
    assert (nearest < 1 + np.sqrt(3) * parent_side).all()
    assert (farthest > 1 - np.sqrt(3) * parent_side).all()
    assert len(cells) < 0.2 * 8**level


def test_grow_stays_in_the_proxy_box(lamp):
    from lumitree.fit.octree.estimate import grow

    rays = source(lamp(cube("lamp", (1, 0.5, 0.1), (0, 0, 3), AREA)))
    cells = grow(rays, 3, settings(RAYS))
    low = cells / 4 - 1
    half = rays.luminaire.frame.half_extents
    assert ((low < half) & (low + 0.25 > -half)).all()
    # At the start level all that reach into the box.
    assert len(cells) == 8 * 4 * 2
