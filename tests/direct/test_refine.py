"""Descent on noisy rays of a field that is known."""

import numpy as np
import pytest

from fields import leaf_field, make_asset, random_asset, uniform_asset
from lumitree.errors import LumitreeError

LINES = 1 << 12


def random_lines(mi, count, seed):
    """Lines through the ball of radius 1.2, uniform."""
    random = np.random.default_rng(seed)
    direction = random.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    origin = random.normal(size=(count, 3))
    origin -= (origin * direction).sum(axis=1, keepdims=True) * direction
    origin *= 1.2 * np.sqrt(random.random((count, 1))) / np.linalg.norm(origin, axis=1)[:, None]
    origin -= 2 * direction
    return mi.Point3f(*origin.T), mi.Vector3f(*direction.T)


class FieldRays:
    """Noisy rays of a known field: all or nothing half the time, so that the mean is right.

    `split` gives half of the light as rays that stand for no line, as paths from emitters do.
    """

    def __init__(self, mi, truth, noise=True, split=False):
        self._mi, self._truth, self._noise, self._split = mi, truth, noise, split

    def draw(self, count, batch, wanted):
        import drjit as dr

        from lumitree.direct.rays import Rays

        mi = self._mi
        origin, direction = random_lines(mi, count, batch)
        chosen = dr.compress(wanted(origin, direction))
        lines = dr.width(chosen)
        origin = dr.gather(mi.Point3f, origin, chosen)
        direction = dr.gather(mi.Vector3f, direction, chosen)
        dr.eval(origin, direction)
        if not lines:
            return Rays(origin, direction, mi.Float(), mi.Color3f(mi.Float()), mi.Float())
        radiance, through, _ = self._truth.integrate(origin, direction)
        # Opaque, or every step would compile kernels of its own.
        part = dr.opaque(mi.Float, 1 / lines)
        share = part * dr.ones(mi.Float, lines)
        light = self._noisy(radiance, batch) * part
        if not self._split:
            return Rays(origin, direction, share, light, through)
        # Lines of their own, the unwanted among them.
        other = random_lines(mi, count, batch + 10**5)
        brought = self._noisy(self._truth.integrate(*other)[0], batch + 10**5) * part
        none = dr.zeros(mi.Float, count)
        return Rays(
            mi.Point3f(*np.hstack([np.array(origin), np.array(other[0])])),
            mi.Vector3f(*np.hstack([np.array(direction), np.array(other[1])])),
            dr.concat([share, none]),
            mi.Color3f(*(np.hstack([np.array(light), np.array(brought)]) / 2)),
            dr.concat([through, none]),
        )

    def straight(self, count, batch, wanted):
        rays = FieldRays(self._mi, self._truth, noise=False).draw(count, batch, wanted)
        return rays.origin, rays.direction, rays.transmittance

    def pairs(self, count, batch, paths):
        from lumitree.direct.rays import Pairs

        origin, direction = random_lines(self._mi, count, batch)
        radiance, through, _ = self._truth.integrate(origin, direction)
        noisy = [self._noisy(radiance, [batch, half]) for half in range(2)]
        return Pairs(origin, direction, *noisy, through)

    def _noisy(self, radiance, seed):
        if not self._noise:
            return radiance
        random = np.random.default_rng([7, *np.atleast_1d(seed)])
        return radiance * self._mi.Float(2.0 * (random.random(radiance.shape[1]) < 0.5))


@pytest.fixture(autouse=True)
def few_blame_lines(mi, monkeypatch):
    monkeypatch.setattr("lumitree.direct.refine._BLAME_LINES", 1 << 14)


def refiner(mi, start, truth, *, noise=True, split=False, **options):
    from lumitree.direct.refine import RefineConfig, Refiner

    rays = FieldRays(mi, truth, noise, split)
    return Refiner(start, rays, 1.0, RefineConfig(lines=LINES, **options))


def truth_and_start(law, seed=3, l_max=1):
    """A field with radiance below 0.5, and one of the same leaves that is all wrong."""
    asset = random_asset(seed, tree_depth=3, l_max=l_max, law=law, max_radiance=1)
    random = np.random.default_rng(seed)
    coefficients = 0.5 * asset.coefficients.astype(float)
    coefficients[..., 0] -= 5
    truth, start = leaf_field(asset), leaf_field(asset)
    truth = truth.with_leaves(
        truth.cells, truth.levels, truth.log_density, coefficients.astype(np.float32).ravel()
    )
    start = start.with_leaves(
        start.cells,
        start.levels,
        np.array(start.log_density) + random.choice([-1.0, 1.0], start.num_leaves),
        np.zeros(coefficients.size, np.float32),
    )
    return truth, start


def score(mi, truth, field):
    """PSNR and RMSE of the transmittance, on rays of no step."""
    from lumitree.direct.heldout import HeldOut

    origin, direction = random_lines(mi, 1 << 14, 10**6)
    radiance, through, _ = truth.integrate(origin, direction)
    psnr = HeldOut(origin, direction, radiance, radiance, through).score(field).psnr
    difference = np.array(field.integrate(origin, direction)[1]) - np.array(through)
    return psnr, np.sqrt((difference**2).mean())


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


@pytest.mark.parametrize("split", [False, True])
@pytest.mark.parametrize("law", ["linear", "exponential"])
def test_a_wrong_start_becomes_the_truth(mi, law, split):
    truth, start = truth_and_start(law)
    before, opacity_before = score(mi, truth, start)
    descent = refiner(mi, start, truth, split=split)
    steps = 400
    for step in range(steps):
        assert descent.advance(step / steps) > 0
    after, opacity_after = score(mi, truth, descent.field)
    assert descent.step == steps
    # A tenth of the error (20 dB) and less, although every ray is twice too bright or black.
    assert after > before + 20
    assert opacity_after < opacity_before / 2


def parameters(descent):
    return {name: np.array(value, np.float64) for name, value in descent.state().items()}


def same(first, second):
    """Sums of a step are added up in any order, which Adam's first steps make more of."""
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


def lengths_seen(mi, field):
    origin, direction = random_lines(mi, 1 << 13, 99)
    radiance, through, _ = field.integrate(origin, direction)
    return np.array(radiance), np.array(through)


@pytest.mark.parametrize("law", ["linear", "exponential"])
def test_splitting_changes_nothing_at_first(mi, law):
    truth, start = truth_and_start(law)
    descent = refiner(mi, start, truth)
    for _ in range(5):
        descent.advance(0.0)
    radiance, through = lengths_seen(mi, descent.field)
    leaves, levels = descent.field.num_leaves, descent.field.levels
    volume = (8.0**-levels).sum()
    descent.split(3)
    assert descent.field.num_leaves > leaves
    assert (descent.field.num_leaves - leaves) % 7 == 0
    assert descent.field.levels.max() == 3
    assert (8.0**-descent.field.levels).sum() == pytest.approx(volume)
    after, through_after = lengths_seen(mi, descent.field)
    # Smaller leaves show less of themselves each, and what is below 1e-4 is left out; opaque rays
    # end within 1e-3.
    assert through_after == pytest.approx(through, abs=1e-5 if law == "linear" else 1e-3)
    assert after == pytest.approx(radiance, abs=1e-3)
    # The new leaves learn.
    assert descent.advance(0.0) > 0
    assert np.isfinite(np.array(descent.field.coefficients)).all()


def test_leaves_that_answer_for_most_are_split_first(mi):
    """Eight octants, one of them wrong: room for one split goes to it."""
    truth = leaf_field(uniform_asset(0.5, [0.2] * 3, law="exponential", max_radiance=1))
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
    # No room is left.
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
def test_pruning_drops_only_what_nobody_sees(mi, law):
    random = np.random.default_rng(2)
    cells = np.stack(np.meshgrid(*[np.arange(4)] * 3, indexing="ij"), -1).reshape(-1, 3)
    density = np.where(random.random(64) < 0.5, 1e-4, random.uniform(0.1, 5, 64))
    coefficients = random.normal(size=(64, 3, 1))
    asset = make_asset(
        cells, np.full(64, 2), density, coefficients, tree_depth=2, law=law, max_radiance=1
    )
    field = leaf_field(asset)
    descent = refiner(mi, field, field)
    before, through_before = lengths_seen(mi, field)
    descent.prune()
    assert np.array_equal(descent.field.cells, cells[density > 0.01])
    assert np.array(descent.field.log_density) == pytest.approx(
        np.log(density[density > 0.01]), abs=1e-5
    )
    after, through = lengths_seen(mi, descent.field)
    # A line crosses at most 10 of the 4³ cells; each dropped one hides up to 1e-4 · √3 / 2.
    assert through == pytest.approx(through_before, abs=1e-3)
    assert after == pytest.approx(before, abs=2e-3)
    assert descent.advance(0.0) > 0


def test_a_step_that_meets_no_leaf_changes_nothing(mi):
    """A speck that no line of a small batch meets."""
    asset = make_asset([(512, 512, 512)], [10], [1.0], np.zeros((1, 3, 1)), tree_depth=10)
    field = leaf_field(asset)
    descent = refiner(mi, field, field)
    assert descent.advance(0.5) == 0
    assert descent.step == 1
    assert np.array(descent.field.log_density) == pytest.approx([0.0])


@pytest.mark.parametrize(
    "settings",
    [
        {"lines": 0},
        {"lines": 100},
        {"epsilon": 0.0},
        {"density_rate": -1.0},
        {"coefficient_rate": 0.0},
        {"final_rate": 0.0},
        {"final_rate": 1.5},
    ],
)
def test_wrong_settings_are_refused(mi, settings):
    from lumitree.direct.refine import RefineConfig

    with pytest.raises(LumitreeError, match=next(iter(settings))):
        RefineConfig(**settings)
