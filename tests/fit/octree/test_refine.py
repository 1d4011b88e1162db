"""Descent on noisy rays of a field that is known."""

import numpy as np
import pytest

from lumitree.fit.octree.config import RefineConfig, SplitConfig
from support.field_rays import FieldRays, random_rays, truth_and_start
from support.fields import leaf_field, make_asset, uniform_asset

RAYS = 1 << 12


def refiner(mi, start, truth, *, noise=True, split=False, max_leaves=100_000, **options):
    """A refiner; `split` is as for `FieldRays`."""
    from lumitree.fit.octree.descent import Refiner

    rays = FieldRays(mi, truth, noise, split)
    splitting = SplitConfig(indicator_rays=1 << 14, max_leaves=max_leaves)
    return Refiner(start, rays, 1.0, RefineConfig(rays=RAYS, **options), splitting)


def score(mi, truth, field):
    """PSNR and RMSE of the transmittance, on rays of no step."""
    from lumitree.fit.octree.descent import HeldOut

    origin, direction = random_rays(mi, 1 << 14, 10**6)
    radiance, through, _ = truth.integrate(origin, direction)
    psnr = HeldOut(origin, direction, radiance, radiance, through).score(field).psnr
    difference = np.array(field.integrate(origin, direction)[1]) - np.array(through)
    return psnr, np.sqrt((difference**2).mean())


@pytest.mark.slow
@pytest.mark.parametrize("split", [False, True])
@pytest.mark.parametrize("law", ["linear", "exponential"])
def test_a_wrong_start_becomes_the_truth(mi, law, split):
    truth, start = truth_and_start(law)
    before, opacity_before = score(mi, truth, start)
    descent = refiner(mi, start, truth, split=split, coefficient_rate=0.06)
    steps = 400
    for step in range(steps):
        assert descent.advance(step / steps) > 0
    after, opacity_after = score(mi, truth, descent.field)
    assert descent.step == steps
    # At most a tenth of the error (20 dB), although every ray has twice the radiance or none.
    assert after > before + 20
    assert opacity_after < opacity_before / 2


@pytest.mark.slow
def test_smoothing_reduces_noise(mi):
    """A descent that starts at the truth, whose leaves are all equal."""
    cells = np.stack(np.meshgrid(*[np.arange(8)] * 3, indexing="ij"), -1).reshape(-1, 3)
    coefficients = np.zeros((512, 3, 4))
    coefficients[..., 0] = -5
    truth = leaf_field(
        make_asset(
            cells, np.full(512, 3), np.ones(512), coefficients, tree_depth=3, law="exponential"
        )
    )
    noise = []
    for smoothing in (0.0, 0.5):
        descent = refiner(mi, truth.copy(), truth, smoothing=smoothing, final_rate=1.0)
        for _ in range(40):
            descent.advance(0.0)
        noise.append(np.std(descent.field.coefficient_array() - truth.coefficient_array()))
    assert noise[0] > 0.05
    assert noise[1] < noise[0] / 2


def parameters(descent):
    return {name: np.array(value, np.float64) for name, value in descent.state().items()}


def same(first, second):
    """Whether two descents agree, up to rounding, which Adam's first steps amplify."""
    first, second = parameters(first), parameters(second)
    assert first.keys() == second.keys()
    for name, value in first.items():
        assert second[name] == pytest.approx(value, rel=2e-3, abs=2e-4), name


def test_equal_seeds_give_equal_fields(mi):
    truth, start = truth_and_start("exponential")
    first, second = (refiner(mi, start.copy(), truth) for _ in range(2))
    for step in range(20):
        first.advance(step / 20)
        second.advance(step / 20)
    same(first, second)
    moved = np.array(first.field.coefficients) - np.array(start.coefficients)
    assert np.abs(moved).max() > 0.1


@pytest.mark.parametrize("l_max", [1, 2])
def test_restored_state_continues_as_if_never_interrupted(mi, l_max):
    """With coefficients that fill their rows, and with some that do not."""
    truth, start = truth_and_start("linear", l_max=l_max)
    whole, first = (refiner(mi, start.copy(), truth) for _ in range(2))
    for step in range(20):
        whole.advance(step / 20)
        if step < 8:
            first.advance(step / 20)
    state = first.state()
    second = refiner(mi, truth_and_start("linear", seed=5, l_max=l_max)[1], truth)
    second.restore(state)
    assert second.step == 8
    for name, value in second.state().items():
        assert np.array_equal(value, state[name]), name
    for step in range(8, 20):
        second.advance(step / 20)
    same(whole, second)


def traced(mi, field):
    origin, direction = random_rays(mi, 1 << 13, 99)
    radiance, through, _ = field.integrate(origin, direction)
    return np.array(radiance), np.array(through)


@pytest.mark.parametrize("law", ["linear", "exponential"])
def test_splitting_changes_nothing_at_first(mi, law):
    truth, start = truth_and_start(law)
    descent = refiner(mi, start, truth)
    for _ in range(5):
        descent.advance(0.0)
    radiance, through = traced(mi, descent.field)
    leaves, levels = descent.field.num_leaves, descent.field.levels
    volume = (8.0**-levels).sum()
    descent.split(3)
    assert descent.field.num_leaves > leaves
    assert (descent.field.num_leaves - leaves) % 7 == 0
    assert descent.field.levels.max() == 3
    assert (8.0**-descent.field.levels).sum() == pytest.approx(volume)
    after, through_after = traced(mi, descent.field)
    # Smaller leaves have smaller weights, and those below 1e-4 are left out; rays end where T is
    # below 1e-3.
    assert through_after == pytest.approx(through, abs=1e-5 if law == "linear" else 1e-3)
    assert after == pytest.approx(radiance, abs=1e-3)
    # The new leaves learn.
    assert descent.advance(0.0) > 0
    assert np.isfinite(np.array(descent.field.coefficients)).all()


def test_leaves_with_the_largest_error_are_split_first(mi):
    """Eight octants, of which one is wrong: the only split allowed is its."""
    truth = leaf_field(uniform_asset(0.5, [0.2] * 3, law="exponential", max_radiance=1.0))
    coefficients = truth.coefficient_array()
    coefficients[5] += 3
    start = truth.with_leaves(truth.cells, truth.levels, truth.log_density, coefficients)
    start.tree_depth = 2
    start = start.with_leaves(start.cells, start.levels, start.log_density, start.coefficients)
    descent = refiner(
        mi, start, truth, noise=False, max_leaves=15, density_rate=1e-6, coefficient_rate=1e-6
    )
    descent.advance(0.0)
    descent.split(2)
    assert descent.field.num_leaves == 15
    fine = descent.field.cells[descent.field.levels == 2]
    assert np.unique(fine >> 1, axis=0).tolist() == [truth.cells[5].tolist()]
    # No further leaves are allowed.
    descent.advance(0.0)
    descent.split(2)
    assert descent.field.num_leaves == 15


def test_leaves_at_the_deepest_level_are_not_split(mi):
    truth, start = truth_and_start("linear")
    descent = refiner(mi, start, truth)
    descent.advance(0.0)
    descent.split(2)
    levels, before = descent.field.levels, start.levels
    assert (levels == 3).sum() == (before == 3).sum()
    assert (levels == 1).sum() < (before == 1).sum()


@pytest.mark.parametrize("law", ["linear", "exponential"])
def test_pruning_drops_only_what_is_invisible(mi, law):
    random = np.random.default_rng(2)
    cells = np.stack(np.meshgrid(*[np.arange(4)] * 3, indexing="ij"), -1).reshape(-1, 3)
    density = np.where(random.random(64) < 0.5, 1e-4, random.uniform(0.1, 5, 64))
    coefficients = random.normal(size=(64, 3, 1))
    asset = make_asset(
        cells, np.full(64, 2), density, coefficients, tree_depth=2, law=law, max_radiance=1.0
    )
    field = leaf_field(asset)
    descent = refiner(mi, field, field)
    before, through_before = traced(mi, field)
    descent.prune()
    assert np.array_equal(descent.field.cells, cells[density > 0.01])
    assert np.array(descent.field.log_density) == pytest.approx(
        np.log(density[density > 0.01]), abs=1e-5
    )
    after, through = traced(mi, descent.field)
    # A ray crosses at most 10 of the 4³ cells; the optical depth of a dropped one is up to
    # 1e-4 · √3 / 2.
    assert through == pytest.approx(through_before, abs=1e-3)
    assert after == pytest.approx(before, abs=2e-3)
    assert descent.advance(0.0) > 0


def test_a_step_that_crosses_no_leaf_changes_nothing(mi):
    """The only leaf is too small for any ray of a batch to cross it."""
    asset = make_asset([(512, 512, 512)], [10], [1.0], np.zeros((1, 3, 1)), tree_depth=10)
    field = leaf_field(asset)
    descent = refiner(mi, field, field)
    assert descent.advance(0.5) == 0
    assert descent.step == 1
    assert np.array(descent.field.log_density) == pytest.approx([0.0])
