"""The rays of a luminaire: light paths that leave it."""

import numpy as np
import pytest

from lumitree.errors import LumitreeError
from lumitree.trace.light_paths import LampRays
from lumitree.trace.segments import EndingConfig
from support.lamps import AREA, cube, lamp_of, sphere

RADIANCE = np.array([3.0, 2.0, 1.0])
COUNT = 1 << 12


@pytest.fixture(scope="module")
def lamp(mi, tmp_path_factory):
    """A sphere above a plate."""
    shapes = sphere("ball", 1, inside=AREA), cube("plate", (3, 0.1, 3), (0, -2, 0))
    return lamp_of(tmp_path_factory.mktemp("lamp"), *shapes)


def test_rays_of_a_bare_sphere_travel_outwards_with_its_flux(mi, tmp_path):
    rays = LampRays(lamp_of(tmp_path, sphere("ball", 1, (5, 0, 0), inside=AREA)))
    origin, direction, flux = rays.draw(COUNT, 1).arrays()
    assert origin.shape == direction.shape == flux.shape == (COUNT, 3)
    assert np.linalg.norm(origin, axis=1) == pytest.approx(1, abs=1e-3)
    assert np.linalg.norm(direction, axis=1) == pytest.approx(1, abs=1e-5)
    assert ((origin * direction).sum(axis=1) > -1e-3).all()
    assert flux.sum(axis=0) == pytest.approx(4 * np.pi**2 * RADIANCE, rel=1e-4)


def test_equal_seeds_give_equal_rays_with_and_without_ending_segments(lamp):
    rays = LampRays(lamp)
    first, second = rays.draw(COUNT, 1), rays.draw(COUNT, 1, ending=EndingConfig(4, 0))
    for one, other in zip(first.arrays(), second.arrays(), strict=True):
        assert np.array_equal(one, other)
    assert first.ending is None
    assert np.array(second.ending.flux).sum() > 0
    assert not np.array_equal(first.arrays()[1][:64], rays.draw(COUNT, 2).arrays()[1][:64])


def test_the_plate_absorbs_light_of_the_bare_emitter(lamp):
    rays = LampRays(lamp)
    expected = 4 * np.pi**2 * RADIANCE / lamp.frame.scale**2
    assert rays.bare_flux(COUNT, 1) == pytest.approx(expected, rel=1e-4)
    assert (rays.draw(COUNT, 1).arrays()[2].sum(axis=0) < 0.95 * expected).all()


def test_light_that_is_not_finite_is_refused(lamp, monkeypatch):
    from lumitree.trace import light_paths as module

    def broken(*arguments, **options):
        paths = trace_light(*arguments, **options)
        paths.flux *= np.nan
        return paths

    trace_light = module.trace_light
    monkeypatch.setattr(module, "trace_light", broken)
    with pytest.raises(LumitreeError, match="renders as NaN or infinity"):
        LampRays(lamp).draw(COUNT, 1)
