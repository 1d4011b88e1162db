"""Emission balanced on noisy rays of a field that is known."""

import numpy as np
import pytest
from field_rays import FieldRays, random_lines, truth_and_start
from lines import stream


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
    origin, direction = random_lines(mi, 1 << 16, 3)
    return np.array(field.share_out(origin, direction, mi.Float(1)))


def mean_log_ratio(field, truth, chosen, weight):
    ratio = np.log(emission(field) / emission(truth)).mean(axis=1)
    return np.average(ratio[chosen], weights=weight[chosen])


@pytest.mark.parametrize("split", [False, True])
@pytest.mark.parametrize(("law", "l_max"), [("linear", 1), ("exponential", 1), ("linear", 0)])
def test_a_region_that_is_too_bright_is_found(mi, law, l_max, split):
    """Half of the space gives twice the light, the other half too little."""
    from lumitree.direct.balance import balance

    truth, _ = truth_and_start(law, l_max=l_max)
    side = 2.0 ** (1 - truth.levels)
    right = (truth.cells[:, 0] + 0.5) * side > 1
    field = shifted(truth, np.where(right, np.log(2), -np.log(1.5)))
    weight = weights(mi, truth)
    balance(field, FieldRays(mi, truth, split=split), 1.0, stream(0))
    assert mean_log_ratio(field, truth, right, weight) == pytest.approx(0, abs=0.1)
    assert mean_log_ratio(field, truth, ~right, weight) == pytest.approx(0, abs=0.1)


@pytest.mark.parametrize("split", [False, True])
def test_a_field_far_too_dark_gets_there(mi, split):
    """The prior weighs what a path brings of light, not of what the dark field shows."""
    from lumitree.direct.balance import balance

    truth, _ = truth_and_start("exponential")
    field = shifted(truth, np.full(truth.num_leaves, -np.log(30)))
    balance(field, FieldRays(mi, truth, split=split), 1.0, stream(0))
    left = mean_log_ratio(field, truth, slice(None), weights(mi, truth))
    assert left == pytest.approx(0, abs=0.15)


@pytest.mark.parametrize("law", ["linear", "exponential"])
def test_light_sent_to_the_wrong_side_is_found(mi, law):
    """The field is as bright as the truth, but brighter upwards."""
    from lumitree.direct.balance import balance

    truth, _ = truth_and_start(law)
    tilt = np.array([0, 0.3, -0.8, 0])
    wrong = truth.coefficient_array() + tilt.astype(np.float32)
    field = truth.with_leaves(truth.cells, truth.levels, truth.log_density, wrong)
    weight = weights(mi, truth)
    balance(field, FieldRays(mi, truth, split=True), 1.0, stream(0))
    left = (field.coefficient_array() - truth.coefficient_array()).mean(axis=1)
    assert np.average(left, axis=0, weights=weight) == pytest.approx(0, abs=0.1)


def test_moments_are_those_of_cells_seen_alone(mi):
    """A cell shows what the field does whose other leaves are black, summed in NumPy."""
    from lumitree.core.device import on_device
    from lumitree.core.frames import towards_viewer
    from lumitree.core.harmonics import Y_00, basis_array

    truth, _ = truth_and_start("exponential")
    cell = np.arange(truth.num_leaves) % 3
    origin, direction = random_lines(mi, 1 << 10, 5)
    random = np.random.default_rng(2)
    light, share = random.random((3, 1 << 10)), random.random(1 << 10)
    moments = truth.emission_moments(
        origin, direction, mi.Color3f(*light), mi.Float(share), on_device(mi.UInt32, cell), 4
    )
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


def test_balancing_what_is_right_adds_little_noise(mi):
    from lumitree.direct.balance import balance

    truth, _ = truth_and_start("exponential")
    field = truth.copy()
    balance(field, FieldRays(mi, truth, split=True), 1.0, stream(0))
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
