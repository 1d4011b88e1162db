"""The held-out score: unbiased under noise, with an honest uncertainty."""

import numpy as np
import pytest

from lumitree.core.device import on_device
from lumitree.fit.octree.config import HeldOutConfig
from support.fields import uniform_asset
from support.lamps import AREA, sphere
from support.traced_lamps import stream

TILE = 16


def uniform_field(radiance):
    """Opaque cube of one radiance / L_max."""
    from support.fields import leaf_field

    return leaf_field(uniform_asset(200.0, [radiance] * 3, law="exponential", max_radiance=1.0))


def random_rays(mi, random, count):
    """Rays from the centre."""
    import drjit as dr

    directions = random.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return dr.zeros(mi.Point3f, count), on_device(mi.Vector3f, directions)


@pytest.mark.parametrize("error", [0.0, 0.02, 0.1])
def test_noise_leaves_no_bias(mi, error):
    """Even if the noise is a hundred times as strong as the smaller error."""
    from lumitree.fit.octree.descent import HeldOut

    random = np.random.default_rng(1)
    count, truth = 1 << 18, 0.3
    origin, direction = random_rays(mi, random, count)

    def noisy():
        # As traced light is: mostly 0, rarely bright.
        return on_device(mi.Color3f, truth * (random.random((count, 3)) < 0.05) / 0.05)

    field = uniform_field(truth + error)
    shown = np.array(field.integrate(origin, direction)[0])[0].mean() - truth
    score = HeldOut(origin, direction, noisy(), noisy(), mi.Float(0)).score(field)
    squared = 10 ** (-score.psnr / 10)
    # Standard error of the mean product of two independent noises around `shown`.
    variance = truth**2 * (1 / 0.05 - 1)
    spread = np.sqrt((variance**2 + 2 * variance * shown**2) / (3 * count))
    assert abs(squared - shown**2) < 4 * spread
    if error:
        assert shown == pytest.approx(error, abs=1e-3)
        # The interval is what this spread is in dB.
        expected = 10 / np.log(10) * spread / squared
        assert score.uncertainty == pytest.approx(expected, rel=0.1)


def test_rank_counts_opacity_as_much_as_radiance(mi):
    from lumitree.fit.octree.descent import HeldOut

    random = np.random.default_rng(0)
    origin, direction = random_rays(mi, random, 1 << 12)
    truth = mi.Color3f(0.5) + 0 * mi.Color3f(origin)
    scores = []
    for shown, through in ((0.6, 0.1), (0.51, 0.1), (0.51, 0.01)):
        # The field is opaque.
        held_out = HeldOut(origin, direction, truth, truth, mi.Float(through) + 0 * origin.x)
        scores.append(held_out.score(uniform_field(shown)))
    assert [score.psnr for score in scores] == pytest.approx([20, 40, 40], abs=0.1)
    assert [score.opacity_psnr for score in scores] == pytest.approx([20, 20, 40], abs=0.1)
    assert [score.rank for score in scores] == pytest.approx([40, 60, 80], abs=0.2)


def test_uncertainty_counts_tiles_not_rays(mi):
    """The errors of the rays of a tile are correlated: a tile counts as one."""
    from lumitree.fit.octree.descent import HeldOut

    field = uniform_field(0.5)
    squared, uncertainties = [], []
    for seed in range(40):
        random = np.random.default_rng(seed)
        count = 1 << 12
        origin, direction = random_rays(mi, random, count)
        truth = mi.Color3f(
            on_device(mi.Float, np.repeat(random.uniform(0, 1, count // TILE), TILE))
        )
        score = HeldOut(origin, direction, truth, truth, mi.Float(0)).score(field)
        squared.append(10 ** (-score.psnr / 10))
        uncertainties.append(score.uncertainty)
    spread = 10 / np.log(10) * np.std(squared, ddof=1) / np.mean(squared)
    # 99.8 % interval of a spread from 40 samples (chi-square, 39 degrees of freedom).
    assert 0.67 < spread / np.mean(uncertainties) < 1.37


def test_held_out_rays_are_in_no_step(mi, lamp):
    from lumitree.fit.octree.descent import HeldOut
    from lumitree.fit.octree.rays import TracedRays

    source = TracedRays(lamp(sphere("lamp", 2.0, inside=AREA)), 1 / 32)
    held_out = HeldOut.trace(source, 10.0, HeldOutConfig(rays=1 << 15, paths=2))
    first, second = np.array(held_out.first), np.array(held_out.second)
    # The sphere has no noise: both estimates are 0.3, 0.2, 0.1 or 0, but for rays at its rim.
    seen = first[0] > 0
    assert first[:, seen] == pytest.approx(np.array([[0.3], [0.2], [0.1]]) * np.ones(seen.sum()))
    assert np.array_equal(first, second)
    held = {tuple(direction) for direction in np.array(held_out.direction).T[::TILE].tolist()}
    for batch in range(3):
        _, direction = source.random_rays(1 << 12, stream(batch))
        assert held.isdisjoint(map(tuple, np.array(direction).T[::TILE].tolist()))


def test_a_score_as_text():
    from lumitree.fit.octree.descent import Score

    assert str(Score(31.416, 0.0271, 20.0)) == "held-out PSNR 31.42 ± 0.03 dB"
