"""Flux of luminaires whose flux is known, by light paths, camera paths and captured views."""

import numpy as np
import pytest

from support.lamps import AREA, GLASS, cube, lamp_of, sphere
from support.slow import slow

RADIUS = 2.0
KNOWN = 4 * np.pi**2 * RADIUS**2 * np.array([3.0, 2.0, 1.0])
LUMENS = 683 * (KNOWN @ [0.2126, 0.7152, 0.0722])


@pytest.fixture
def lamp(mi, tmp_path):
    return lamp_of(tmp_path, sphere("lamp", RADIUS, (5, 1, 0), AREA))


# All light paths of a bare sphere carry the same, so that rounding is all of their error.
@pytest.mark.parametrize(("light_paths", "rounding"), [(True, 1e-4), slow(False, 0.0)])
def test_emissive_sphere_has_flux_4_pi2_r2_l(lamp, light_paths, rounding):
    from lumitree.trace.flux import estimate_flux
    from support.camera_flux import flux_by_camera_paths

    flux = (estimate_flux if light_paths else flux_by_camera_paths)(lamp, 1 << 20)
    assert flux.watts == pytest.approx(KNOWN, rel=0.01)
    assert flux.lumens == pytest.approx(LUMENS, rel=0.01)
    assert (np.abs(flux.watts - KNOWN) < 4 * np.array(flux.watts_error) + rounding * KNOWN).all()
    assert flux.paths == 1 << 20


def test_camera_paths_are_traced_once(lamp):
    """And not once for each of R, G and B."""
    import drjit as dr

    from lumitree.trace.flux import BATCH, flux_by_camera_paths

    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        dr.kernel_history_clear()
        flux_by_camera_paths(lamp, BATCH)
        kernels = dr.kernel_history([dr.KernelType.JIT])
    operations = [each["operation_count"] for each in kernels if each["size"] == BATCH]
    assert sum(each > max(operations) / 2 for each in operations) == 1


@pytest.mark.slow
def test_standard_error_is_the_spread_of_independent_estimates(lamp):
    from lumitree.trace.flux import BATCH
    from support.camera_flux import flux_by_camera_paths

    estimates = [flux_by_camera_paths(lamp, 1, seed=seed) for seed in range(12)]
    lumens = np.array([flux.lumens for flux in estimates])
    expected = np.mean([flux.lumens_error for flux in estimates])
    # Rays hit the sphere or miss it: the error of one estimate follows from the hit rate p.
    hit = 1 / lamp.bounding_radius**2
    assert expected == pytest.approx(LUMENS * np.sqrt((1 - hit) / hit / BATCH), rel=0.01)
    # 99.8 % interval of a spread from 12 samples (chi-square, 11 degrees of freedom).
    assert 0.33 < lumens.std(ddof=1) / expected < 1.69
    assert abs(lumens.mean() - LUMENS) < 4 * expected / np.sqrt(12)


MASK = '<bsdf type="mask"><float name="opacity" value="0.5"/><bsdf type="diffuse"/></bsdf>'


# Large, so that Mitsuba's distance of rays from surfaces is small; and a small emitter in a shade
# that lets half of its light through. A plate is below both.
@pytest.mark.slow
@pytest.mark.parametrize(
    ("shapes", "plate", "most"),
    [
        ((sphere("lamp", 20, inside=AREA), sphere("glass", 50, inside=GLASS)), (60, -55), 0.01),
        ((sphere("lamp", 1, inside=AREA), sphere("shade", 10, inside=MASK)), (30, -20), 0.06),
    ],
    ids=["glass", "alpha mask"],
)
def test_light_paths_and_camera_paths_agree(mi, tmp_path, shapes, plate, most):
    from lumitree.trace.flux import estimate_flux
    from support.camera_flux import flux_by_camera_paths

    half, y = plate
    lamp = lamp_of(tmp_path, *shapes, cube("plate", (half, 1, half), (0, y, 0)))
    light, seen = estimate_flux(lamp, 1 << 20), flux_by_camera_paths(lamp, 1 << 21)
    error = np.hypot(light.watts_error, seen.watts_error)
    assert (np.abs(np.subtract(light.watts, seen.watts)) < 4 * error).all()
    assert (error < most * np.array(light.watts)).all()


@pytest.mark.slow
def test_flux_of_captured_views_agrees(lamp, tmp_path):
    from lumitree.trace.cameras import capture

    dataset = capture(lamp, tmp_path / "d", views=4, resolution=64, spp=64)
    side = 2 * lamp.bounding_radius * lamp.frame.world_from_local[0, 0]
    mean = np.mean([view.radiance.mean(axis=(0, 1)) for view in dataset.views()], axis=0)
    assert 4 * np.pi * side**2 * mean == pytest.approx(KNOWN, rel=0.01)


@pytest.mark.slow
def test_bounces_that_are_cut_off_are_missed(mi, tmp_path):
    """Light crosses 6 surfaces of no glass: paths of 4 bounces miss all of it, of 8 none."""
    from lumitree.trace.flux import missed_by_depth

    nothing = '<bsdf type="dielectric"><float name="int_ior" value="1"/>'
    nothing += '<float name="ext_ior" value="1"/></bsdf>'
    shells = [sphere(f"shell{i}", 1 + 0.1 * i, inside=nothing) for i in range(1, 7)]
    lamp = lamp_of(tmp_path, sphere("lamp", 1, inside=AREA), *shells)
    missed = missed_by_depth(lamp, 1, (4, 8), 12)
    assert [each.path_depth for each in missed] == [4, 8]
    assert missed[0].share == 1
    assert 0 < missed[0].error < 0.01
    assert (missed[1].share, missed[1].error) == (0, 0)
