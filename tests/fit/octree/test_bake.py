"""The whole octree fit of tiny lamps: result, budget, interruption and refusals."""

import dataclasses
import signal

import numpy as np
import pytest

from lumitree.errors import LumitreeError, LumitreeWarning
from support.fields import leaf_field, uniform_asset
from support.kernels import kernels_of
from support.lamps import AREA, cube, sphere
from support.slow import slow
from support.tiny_bakes import SMALLEST, octree_config
from support.traced_lamps import stream

RAYS = 1 << 19
KNOWN = 4 * np.pi**2 * np.array([3.0, 2.0, 1.0])


def config(**options):
    return octree_config(**{"tree_depth": 4, "rays": RAYS, **options})


def small_config(**options):
    return config(**{**SMALLEST, **options})


@pytest.fixture
def ball(lamp):
    """Uniform emissive sphere of radius 2, 1 local unit."""
    return lamp(sphere("lamp", 2, (1, 0, 0), AREA))


@pytest.mark.parametrize("law", [slow("linear"), "exponential"])
def test_baked_flux_is_the_traced_flux(ball, law, tmp_path):
    from lumitree.fit.octree.bake import bake
    from lumitree.fit.octree.rays import TracedRays
    from lumitree.octree.field import Field

    # The correction's eight million rays estimate it to ±0.5 %, as the million below.
    result = bake(ball, config(law=law, flux={"draws": 8, "rays": 1 << 20}), tmp_path)
    assert result.stopped_by is None
    # At most a step's rays of both kinds and its light paths more.
    assert RAYS <= result.rays < RAYS + 6 * (1 << 14)
    assert result.seconds > 0
    asset = result.asset
    assert (asset.tree_depth, asset.l_max, asset.law) == (4, 1, law)
    assert asset.max_radiance == pytest.approx(4 * 3, rel=0.1)
    assert np.array_equal(asset.frame.world_from_local, ball.frame.world_from_local)

    source = TracedRays(ball, 1 / 64, seed=77)
    origin, direction = source.random_rays(1 << 20, stream(1))
    radiance = np.array(Field(asset).emission(origin, direction)[0])
    traced = np.array(source.trace(origin, direction, stream(1), 1)[0])
    flux, expected = (source.measure * values.mean(axis=1) for values in (radiance, traced))
    assert expected == pytest.approx(KNOWN, rel=0.015)
    # Cells of an eighth of the radius: a channel may have a larger error than all together.
    assert flux == pytest.approx(expected, rel=0.02)
    assert flux.sum() == pytest.approx(expected.sum(), rel=0.015)


def test_steps_run_the_same_kernels(ball):
    """Numbers of rays, which differ, in the code of a kernel would compile another each step."""
    from lumitree.fit.octree.descent import HeldOut, Refiner
    from lumitree.fit.octree.rays import TracedRays

    settings = small_config()
    source = TracedRays(ball, 1 / 8, seed=3)
    refiner = Refiner(
        leaf_field(uniform_asset(0.5, (0.2, 0.2, 0.2))), source, 12, settings.refine, settings.split
    )

    def step():
        counts.append(refiner.advance(0.5))
        HeldOut.trace(source, 10 + refiner.step, settings.held_out).score(refiner.field)

    counts = []
    known = kernels_of(step) | kernels_of(step)
    assert kernels_of(step) <= known
    assert len(set(counts)) == 3


def test_a_field_that_cannot_be_bright_enough_is_told(lamp, tmp_path):
    """A dim sphere before which a small bright one has most of the light."""
    from lumitree.fit.octree.bake import bake

    dim, bright = (AREA.replace("3,2,1", f"{value}") for value in ("1,1,1", "4e5,4e5,4e5"))
    luminaire = lamp(sphere("dim", 2, inside=dim), sphere("bright", 0.01, (0, 0, 2.02), bright))
    # So few rays do not find it, so many do.
    few = small_config(rays=1 << 12, max_radiance={"rays": 1 << 12}, flux={"rays": 1 << 21})
    with pytest.warns(LumitreeWarning, match=r"[89]\d% of the light of .* is radiance above L_max"):
        bake(luminaire, few, tmp_path / "state")


def test_a_budget_that_the_first_estimate_spends_is_a_warning(ball, tmp_path):
    from lumitree.fit.octree.bake import bake

    with pytest.warns(LumitreeWarning, match=r"lamp: 0\.001 s were over before the gradient"):
        result = bake(ball, small_config(time=1e-3, rays=None), tmp_path)
    assert result.rays == 0


@pytest.mark.slow
def test_score_is_that_of_the_asset_even_where_descent_makes_it_worse(ball, tmp_path):
    """With far too large steps, the field that is returned is the one of the score."""
    from lumitree.fit.octree.bake import bake
    from lumitree.fit.octree.descent import HeldOut
    from lumitree.fit.octree.rays import TracedRays

    wild = config(refine={"density_rate": 30.0, "coefficient_rate": 30.0, "final_rate": 1.0})
    result = bake(ball, wild, tmp_path)
    source = TracedRays(ball, 2 / 16)
    # Such steps lead to densities that underflow to 0.
    with np.errstate(divide="ignore"):
        field = leaf_field(result.asset)
    score = HeldOut.trace(source, result.asset.max_radiance, wild.held_out).score(field)
    # Coefficients are rounded to half precision.
    assert score.psnr == pytest.approx(result.score.psnr, abs=0.1)


def interrupt_after(monkeypatch, steps):
    """Presses Ctrl-C during the step of that number; returns the list of steps done."""
    from lumitree.fit.octree.descent import Refiner

    advance, done = Refiner.advance, []

    def press(self, progress):
        done.append(self.step + 1)
        if len(done) == steps:
            signal.raise_signal(signal.SIGINT)
        return advance(self, progress)

    monkeypatch.setattr(Refiner, "advance", press)
    return done


@pytest.mark.slow
def test_interrupted_bake_continues(ball, tmp_path, monkeypatch):
    from lumitree.fit.octree.bake import bake

    steps = interrupt_after(monkeypatch, 5)
    first = bake(ball, config(), tmp_path)
    assert first.stopped_by == signal.SIGINT
    assert steps == [1, 2, 3, 4, 5]
    assert 0 < first.rays < RAYS
    assert (tmp_path / "octree.npz").exists()

    def refuse(*_):
        raise AssertionError("a continued bake makes no first estimate again")

    monkeypatch.setattr("lumitree.fit.octree.bake._first_field", refuse)
    second = bake(ball, config(), tmp_path)
    assert second.stopped_by is None
    assert steps == list(range(1, len(steps) + 1))
    assert second.rays >= RAYS
    assert second.seconds > first.seconds
    # Except for the closing calibration, which an interrupted bake omits.
    assert second.asset.max_radiance == pytest.approx(first.asset.max_radiance, rel=0.1)
    # As if it had never been interrupted.
    monkeypatch.undo()
    whole = bake(ball, config(), tmp_path / "whole")
    assert second.score.psnr == pytest.approx(whole.score.psnr, abs=0.1)
    assert second.asset.num_leaves == whole.asset.num_leaves


@pytest.mark.slow
def test_budget_may_be_raised_other_settings_may_not(ball, lamp, tmp_path, monkeypatch):
    from lumitree.fit.octree.bake import bake

    steps = interrupt_after(monkeypatch, 2)
    bake(ball, config(), tmp_path)
    other = lamp(cube("lamp", 2, (1, 0, 0), AREA))
    for luminaire, settings in (
        (other, config()),
        (ball, config(l_max=2)),
        (ball, config(law="linear")),
        (ball, config(refine={"epsilon": 0.01})),
        (ball, config(held_out={"rays": 1 << 14})),
    ):
        with pytest.raises(LumitreeError, match="unfinished bake with other inputs") as refusal:
            bake(luminaire, settings, tmp_path)
        assert "\n" not in str(refusal.value)
    with pytest.raises(LumitreeError, match="unfinished bake with other inputs"):
        bake(ball, config(), tmp_path, seed=1)
    assert len(steps) == 2
    more = dataclasses.replace(config(), rays=RAYS + (1 << 15), time=600.0)
    assert bake(ball, more, tmp_path).rays >= RAYS + (1 << 15)
    assert steps[:4] == [1, 2, 3, 4]


def test_lamp_without_light_is_refused(lamp, tmp_path):
    from lumitree.fit.octree.bake import bake

    black = '<bsdf type="diffuse"><rgb name="reflectance" value="0"/></bsdf>'
    dark = lamp(sphere("lamp", 1, inside=AREA), sphere("shell", 2, inside=black))
    with pytest.raises(LumitreeError, match="no light"):
        bake(dark, config(), tmp_path)
