"""Emission balanced on noisy rays of a field that is known."""

import numpy as np
import pytest
from field_rays import FieldRays, random_lines, truth_and_start


def shifted(field, shift):
    """The field with `shift` ([M]) added to what it has before the sigmoid, in all directions."""
    from lumitree.core.harmonics import Y_00

    coefficients = field.coefficient_array()
    coefficients[:, :, 0] += np.asarray(shift)[:, None] / Y_00
    return field.with_leaves(field.cells, field.levels, field.log_density, coefficients)


def emission(field):
    """What leaves give on average over directions, but for the sigmoid's bend [M, 3]."""
    from lumitree.core.harmonics import Y_00

    return np.exp(field.coefficient_array()[:, :, 0] * Y_00)


def weights(mi, field):
    """How much of many rays each leaf makes up [M]."""
    import drjit as dr

    total = dr.zeros(mi.Float, field.num_leaves)
    origin, direction = random_lines(mi, 1 << 16, 3)
    field.share_out(origin, direction, mi.Float(1), total)
    return np.array(total)


def mean_log_ratio(field, truth, chosen, weight):
    ratio = np.log(emission(field) / emission(truth)).mean(axis=1)
    return np.average(ratio[chosen], weights=weight[chosen])


@pytest.mark.parametrize("split", [False, True])
@pytest.mark.parametrize("law", ["linear", "exponential"])
def test_a_region_that_is_too_bright_is_found(mi, law, split):
    """Half of the space gives twice the light, the other half too little."""
    from lumitree.direct.balance import balance

    truth, _ = truth_and_start(law)
    side = 2.0 ** (1 - truth.levels)
    right = (truth.cells[:, 0] + 0.5) * side > 1
    field = shifted(truth, np.where(right, np.log(2), -np.log(1.5)))
    weight = weights(mi, truth)
    balance(field, FieldRays(mi, truth, split=split), 1.0)
    assert mean_log_ratio(field, truth, right, weight) == pytest.approx(0, abs=0.1)
    assert mean_log_ratio(field, truth, ~right, weight) == pytest.approx(0, abs=0.1)


def test_balancing_what_is_right_adds_little_noise(mi):
    from lumitree.direct.balance import balance

    truth, _ = truth_and_start("exponential")
    field = truth.copy()
    balance(field, FieldRays(mi, truth, split=True), 1.0)
    weight = weights(mi, truth)
    ratio = np.log(emission(field) / emission(truth))
    spread = np.sqrt(np.average((ratio**2).mean(axis=1), weights=weight))
    assert 0 < spread < 0.03


@pytest.mark.parametrize("split", [False, True])
def test_light_left_over_is_what_l_max_lacks(mi, split):
    """Of a field that shows the truth, where L_max is stated too small."""
    from lumitree.direct.balance import light_left_over

    truth, _ = truth_and_start("exponential")
    rays = FieldRays(mi, truth, split=split)
    assert light_left_over(truth, rays, 1.0, 0) == pytest.approx(1, rel=0.01)
    assert light_left_over(truth, rays, 0.8, 0) == pytest.approx(1.25, rel=0.01)
    # Light that meets no leaf is left over too.
    half = truth.cells[:, 0] < (1 << truth.levels) // 2
    density = np.array(truth.log_density)[half]
    coefficients = truth.coefficient_array()[half]
    part = truth.with_leaves(truth.cells[half], truth.levels[half], density, coefficients)
    origin, direction = random_lines(mi, 1 << 18, 9)
    whole, halved = (
        float(np.array(f.integrate(origin, direction)[0]).sum()) for f in (truth, part)
    )
    assert light_left_over(part, rays, 1.0, 0) == pytest.approx(whole / halved, rel=0.06)
