"""Light paths whose gain has a limit, against the same without one."""

import numpy as np
import pytest
import trimesh

from lumitree.core.photometry import luminance
from lumitree.trace.cameras import PATH_DEPTH
from lumitree.trace.light_paths import trace_light
from lumitree.trace.segments import EndingConfig
from support.lamps import AREA, GLASS, lamp_of, sphere

BELOW_ROULETTE = 8
COUNT = 1 << 16


@pytest.fixture
def facetted(tmp_path):
    """A ball beside one of glass, which has 80 faces: grazing light gains much at its normals."""
    glass = trimesh.creation.icosphere(subdivisions=1, radius=1.0)
    glass.export(tmp_path / "glass.ply", vertex_normal=True)
    mesh = f'<shape type="ply"><string name="filename" value="glass.ply"/>{GLASS}</shape>'
    return lamp_of(tmp_path, sphere("ball", 0.2, (1.3, 0, 0), inside=AREA), mesh)


def trace(mi, lamp, path_depth, limit, seed=1):
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, COUNT)
    return trace_light(
        lamp,
        sampler,
        COUNT,
        path_depth,
        all_light=True,
        ending=EndingConfig(3, 2),
        flux_limit=limit,
    )


def flux(rays):
    return np.array(rays.flux, np.float64)


def test_the_sum_of_the_flux_is_the_same(mi, facetted):
    """The paths are too short for Russian roulette, which the limit changes."""
    whole, limited = (trace(mi, facetted, BELOW_ROULETTE, limit) for limit in (None, 2))
    assert flux(limited).sum(axis=1) == pytest.approx(flux(whole).sum(axis=1), rel=1e-4)
    # One segment is chosen of each path, before the flux that was cut off is restored.
    ends = (luminance(flux(each.ending).T).sum() for each in (limited, whole))
    assert next(ends) == pytest.approx(next(ends), rel=1e-3)


@pytest.mark.slow
def test_straight_light_is_as_without_a_limit(mi, facetted):
    """Flux that was cut off is given to bent light, whose gain it was."""
    whole, limited = (trace(mi, facetted, BELOW_ROULETTE, limit) for limit in (None, 2))
    straight = np.array(whole.straight)
    assert 0.1 < straight.mean() < 0.9
    assert np.array_equal(np.array(limited.straight), straight)
    assert np.array_equal(flux(limited)[:, straight], flux(whole)[:, straight])
    assert not np.allclose(flux(limited)[:, ~straight], flux(whole)[:, ~straight], rtol=1e-3)


@pytest.mark.slow
def test_no_path_is_much_above_the_limit(mi, facetted):
    """But by what is given to all of them."""
    start = 0.04 * 4 * np.pi**2 * 3 / COUNT / facetted.frame.scale**2
    gains = [flux(trace(mi, facetted, PATH_DEPTH, limit))[0].max() / start for limit in (None, 4)]
    assert gains[0] > 8
    assert 4 < gains[1] < 4.4


def test_a_limit_that_none_reaches_changes_nothing(mi, facetted):
    whole, limited = (trace(mi, facetted, PATH_DEPTH, limit) for limit in (None, 1e9))
    for name in ("origin", "direction"):
        assert np.array_equal(np.array(getattr(whole, name)), np.array(getattr(limited, name)))
    np.testing.assert_allclose(flux(limited), flux(whole), rtol=1e-5)


def test_paths_without_loss_are_not_ended(mi, tmp_path):
    """Roulette at a survival below 1 would multiply their flux at every event."""
    mirror = '<bsdf type="conductor"><string name="material" value="none"/></bsdf>'
    lamp = lamp_of(
        tmp_path,
        sphere("ball", 0.1, inside=AREA),
        # Open above; light leaves after many reflections.
        '<shape type="cylinder"><point name="p0" x="0" y="-1" z="0"/><point name="p1" x="0" y="4"'
        f' z="0"/><float name="radius" value="0.5"/><bsdf type="twosided">{mirror}</bsdf></shape>',
    )
    found = flux(trace(mi, lamp, PATH_DEPTH, None))[0]
    assert found.max() < 1.001 * found[found > 0].min()
