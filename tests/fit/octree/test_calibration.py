"""Calibration and flux correction, with noisy rays of a field that is known."""

import numpy as np
import pytest

from lumitree.fit.octree.config import CalibrationConfig, FluxConfig
from support.field_rays import FieldRays, random_rays, truth_and_start
from support.slow import slow
from support.traced_lamps import stream

# A million rays: the noise of the factor is 0.2 %.
FLUX = FluxConfig(draws=4, rays=1 << 18)


def shifted(field, shift):
    """The field with `shift` ([M]) added to its logits, in all directions."""
    from lumitree.core.harmonics import Y_00

    coefficients = field.coefficient_array()
    coefficients[:, :, 0] += np.asarray(shift)[:, None] / Y_00
    return field.with_leaves(field.cells, field.levels, field.log_density, coefficients)


def emission(field):
    """Mean emission of leaves over directions [M, 3], as if the sigmoid were an exponential."""
    from lumitree.core.harmonics import Y_00

    return np.exp(field.coefficient_array()[:, :, 0] * Y_00)


def weights(mi, field):
    """Summed weights of each leaf in many rays [M]."""
    from lumitree.fit.octree.leaf_field import accumulate_by_weight

    origin, direction = random_rays(mi, 1 << 16, 3)
    return np.array(accumulate_by_weight(field, origin, direction, mi.Float(1)))


def mean_log_ratio(field, truth, chosen, weight):
    ratio = np.log(emission(field) / emission(truth)).mean(axis=1)
    return np.average(ratio[chosen], weights=weight[chosen])


@pytest.mark.parametrize("split", [False, slow(True)])
@pytest.mark.parametrize(("law", "l_max"), [("linear", 1), slow("exponential", 1), ("linear", 0)])
def test_a_region_that_is_too_bright_is_found(mi, law, l_max, split):
    """Half of the space gives twice the light, the other half too little."""
    from lumitree.fit.octree.calibration import calibrate

    truth, _ = truth_and_start(law, l_max=l_max)
    side = 2.0 ** (1 - truth.levels)
    right = (truth.cells[:, 0] + 0.5) * side > 1
    field = shifted(truth, np.where(right, np.log(2), -np.log(1.5)))
    weight = weights(mi, truth)
    calibrate(field, FieldRays(mi, truth, split=split), 1.0, CalibrationConfig(), stream(0))
    assert mean_log_ratio(field, truth, right, weight) == pytest.approx(0, abs=0.1)
    assert mean_log_ratio(field, truth, ~right, weight) == pytest.approx(0, abs=0.1)


@pytest.mark.parametrize("split", [False, slow(True)])
def test_a_field_far_too_dark_gets_there(mi, split):
    """The prior depends on the light of the luminaire, not on the light of the dark field."""
    from lumitree.fit.octree.calibration import calibrate

    truth, _ = truth_and_start("exponential")
    field = shifted(truth, np.full(truth.num_leaves, -np.log(30)))
    calibrate(field, FieldRays(mi, truth, split=split), 1.0, CalibrationConfig(), stream(0))
    left = mean_log_ratio(field, truth, slice(None), weights(mi, truth))
    assert left == pytest.approx(0, abs=0.15)


@pytest.mark.parametrize("law", ["linear", slow("exponential")])
def test_light_towards_the_wrong_side_is_found(mi, law):
    """The field has the flux of the truth, but is brighter upwards."""
    from lumitree.fit.octree.calibration import calibrate

    truth, _ = truth_and_start(law)
    tilt = np.array([0, 0.3, -0.8, 0])
    wrong = truth.coefficient_array() + tilt.astype(np.float32)
    field = truth.with_leaves(truth.cells, truth.levels, truth.log_density, wrong)
    weight = weights(mi, truth)
    calibrate(field, FieldRays(mi, truth, split=True), 1.0, CalibrationConfig(), stream(0))
    left = (field.coefficient_array() - truth.coefficient_array()).mean(axis=1)
    assert np.average(left, axis=0, weights=weight) == pytest.approx(0, abs=0.1)


def test_moments_are_those_of_each_cell_alone(mi):
    """A cell alone is the field with all other leaves black; sums are NumPy's."""
    from lumitree.core.device import on_device
    from lumitree.core.frames import towards_viewer
    from lumitree.core.harmonics import Y_00, basis_array
    from lumitree.fit.octree.leaf_field import emission_moments

    truth, _ = truth_and_start("exponential")
    cell = np.arange(truth.num_leaves) % 3
    origin, direction = random_rays(mi, 1 << 10, 5)
    random = np.random.default_rng(2)
    light, share = random.random((3, 1 << 10)), random.random(1 << 10)
    device = on_device(mi.Color3f, light.T), on_device(mi.Float, share), on_device(mi.UInt32, cell)
    moments = emission_moments(truth, origin, direction, *device, 4)
    y = basis_array(np.array(mi.Vector3f(*towards_viewer(direction))).T, 1)

    def seen(chosen, step=0.0):
        coefficients = truth.coefficient_array()
        coefficients[:, :, 0] += np.where(chosen, step, -60)[:, None] / Y_00
        field = truth.with_leaves(truth.cells, truth.levels, truth.log_density, coefficients)
        return np.array(field.integrate(origin, direction)[0], np.float64)

    products = np.stack([y[:, j] * y[:, k] for j in range(4) for k in range(j + 1)], -1)
    for index in range(3):
        below, shown, over = (seen(cell == index, step) for step in (-0.1, 0.0, 0.1))
        # Phi' = Phi (1 - Phi) and Phi'' = Phi' (1 - 2 Phi); products want half of their sum.
        slope, bend = (over - below) / 0.2, (over + below - 2 * shown) / 0.01
        expected = [(slope * (light - share)) @ y, ((slope + bend) / 2 * share) @ products]
        scale = np.abs(moments[index]).max()
        np.testing.assert_allclose(moments[index], np.hstack(expected), atol=0.02 * scale)


def test_calibration_of_a_correct_field_adds_little_noise(mi):
    from lumitree.fit.octree.calibration import calibrate

    truth, _ = truth_and_start("exponential")
    field = truth.copy()
    calibrate(field, FieldRays(mi, truth, split=True), 1.0, CalibrationConfig(), stream(0))
    weight = weights(mi, truth)
    ratio = np.log(emission(field) / emission(truth))
    spread = np.sqrt(np.average((ratio**2).mean(axis=1), weights=weight))
    assert 0 < spread < 0.03


@pytest.mark.parametrize("split", [False, slow(True)])
def test_flux_correction_factor_is_what_l_max_lacks(mi, split):
    """The factor is measured on the true field, with an L_max that is too small."""
    from lumitree.fit.octree.calibration import flux_correction

    truth, _ = truth_and_start("exponential")
    rays = FieldRays(mi, truth, split=split)

    def factor(field, max_radiance):
        return flux_correction(field, rays, max_radiance, FLUX, 0).factor

    assert factor(truth, 1.0) == pytest.approx(1, rel=0.01)
    assert factor(truth, 0.8) == pytest.approx(1.25, rel=0.01)
    # Also the light of rays that cross no leaf.
    half = truth.cells[:, 0] < (1 << truth.levels) // 2
    density = np.array(truth.log_density)[half]
    coefficients = truth.coefficient_array()[half]
    part = truth.with_leaves(truth.cells[half], truth.levels[half], density, coefficients)
    origin, direction = random_rays(mi, 1 << 18, 9)
    whole, halved = (
        float(np.array(f.integrate(origin, direction)[0]).sum()) for f in (truth, part)
    )
    assert factor(part, 1.0) == pytest.approx(whole / halved, rel=0.06)


def test_both_end_after_a_first_part_when_the_time_is_over(mi):
    """A bake keeps to its time, and nothing of it is left out."""
    from lumitree.fit.octree.calibration import calibrate, flux_correction

    truth, _ = truth_and_start("exponential")
    drawn = []

    class Counted(FieldRays):
        def draw(self, count, stream, wanted, light_paths_per_ray=0.0):
            drawn.append(count)
            return super().draw(count, stream, wanted, light_paths_per_ray)

    rays = Counted(mi, truth, split=True)
    config = CalibrationConfig(rays=1 << 12)
    for over, rounds, draws in ((lambda: True, 1, 1), (lambda: False, 4, FLUX.draws)):
        calibrate(truth, rays, 1.0, config, stream(0), over)
        assert drawn == [1 << 12] * 2 * rounds
        flux_correction(truth, rays, 1.0, FLUX, 0, over)
        assert drawn[2 * rounds :] == [FLUX.rays] * draws
        drawn.clear()


def test_the_time_is_over_when_it_is_spent_and_not_reserved(mi):
    from lumitree.fit.octree.descent import Budget
    from support.tiny_bakes import octree_config

    budget = Budget(octree_config(time=100.0, rays=None), 50.0, 0)
    budget.reserved = 60.0
    assert (budget.progress, budget.is_over) == (1, False)
    assert Budget(octree_config(time=100.0, rays=None), 101.0, 0).is_over
    assert not Budget(octree_config(time=None, rays=5), 1e9, 0).is_over
