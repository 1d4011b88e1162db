"""Refining an asset: better, of the same kind, within the budget, and resumable."""

import dataclasses
import signal

import numpy as np
import pytest
from test_bake import interrupt_after, small_config

from lumitree.core.frames import similarity
from lumitree.errors import LumitreeError
from lumitree.fit.octree.config import HeldOutConfig
from lumitree.octree.build import leaf_cells
from support.fields import leaf_field, make_asset
from support.lamps import AREA, cube, sphere

RAYS, STEP_RAYS = 1 << 19, 1 << 11


@pytest.fixture
def ball(lamp):
    return lamp(sphere("lamp", 2, (1, 0, 0), AREA))


def rough(luminaire, l_max=1, law="exponential", **options):
    """An asset of grey fog in the box of a luminaire, with leaves that may be split once."""
    cells = np.stack(np.meshgrid(*[np.arange(8)] * 3, indexing="ij"), -1).reshape(-1, 3)
    return make_asset(
        cells,
        np.full(512, 3),
        np.ones(512),
        np.zeros((512, 3, (l_max + 1) ** 2)),
        law=law,
        **{
            "max_radiance": 12.0,
            "world_from_local": luminaire.frame.world_from_local,
            "half_extents": luminaire.frame.half_extents,
            **options,
        },
    )


def score(luminaire, asset):
    """Held-out score of an asset, by rays of a seed that the refinement does not use."""
    from lumitree.fit.octree.descent import HeldOut
    from lumitree.fit.octree.rays import TracedRays

    source = TracedRays(luminaire, 1 / 32, seed=99)
    return HeldOut.trace(source, asset.max_radiance, HeldOutConfig(rays=1 << 12)).score(
        leaf_field(asset)
    )


@pytest.mark.slow
@pytest.mark.parametrize(("law", "l_max"), [("linear", 0), ("exponential", 1)])
def test_a_rough_asset_becomes_better(ball, tmp_path, law, l_max):
    from lumitree.fit.octree.bake import refine

    asset = rough(ball, l_max, law)
    # The asset keeps its law, bands and depth, whatever the settings are.
    other = small_config(law="linear" if law == "exponential" else "exponential", l_max=2)
    result = refine(asset, ball, other, tmp_path)
    found = result.asset
    assert (found.law, found.l_max, found.tree_depth) == (law, l_max, asset.tree_depth)
    assert found.num_leaves > asset.num_leaves
    assert leaf_cells(found.children, found.num_leaves)[1].max() == asset.tree_depth
    assert found.luminaire == ball.name
    assert np.array_equal(found.frame.world_from_local, ball.frame.world_from_local)
    before, after = score(ball, asset), score(ball, found)
    assert after.psnr > before.psnr + 5
    assert after.opacity_psnr > before.opacity_psnr + 5
    # At most a step's rays of both kinds and its light paths more.
    assert RAYS <= result.rays < RAYS + 6 * STEP_RAYS
    assert result.stopped_by is None


def test_the_asset_that_is_refined_stays_as_it_was(ball, tmp_path):
    from lumitree.fit.octree.bake import refine

    asset = rough(ball)
    before = asset.children.copy(), asset.density.copy(), asset.coefficients.copy()
    refine(asset, ball, small_config(rays=1 << 14), tmp_path)
    for array, old in zip((asset.children, asset.density, asset.coefficients), before, strict=True):
        assert np.array_equal(array, old)


def test_an_asset_of_another_box_is_refused(ball, lamp, tmp_path):
    from lumitree.fit.octree.bake import refine

    moved = ball.frame.world_from_local.copy()
    moved[0, 3] += 0.1
    for asset, luminaire in (
        (rough(ball, half_extents=np.array([1, 0.5, 1])), ball),
        (rough(ball, world_from_local=moved), ball),
        (rough(ball, world_from_local=np.eye(4)), ball),
        (rough(ball), lamp(cube("lamp", (2, 2, 1), (1, 0, 0), AREA))),
    ):
        with pytest.raises(LumitreeError, match="have different bounding boxes") as refusal:
            refine(asset, luminaire, small_config(), tmp_path)
        assert "\n" not in str(refusal.value)
    assert not list(tmp_path.glob("*.npz"))


def test_a_small_lamp_is_told_from_one_of_another_size_or_place(lamp, tmp_path):
    """The lengths of its file may be tiny beside a unit."""
    from lumitree.fit.octree.bake import refine

    small = lamp(sphere("lamp", 1e-3, inside=AREA))
    for matrix in (similarity(np.eye(3), 5e-4), similarity(np.eye(3), 1e-3, [1e-4, 0, 0])):
        with pytest.raises(LumitreeError, match="have different bounding boxes"):
            refine(rough(small, world_from_local=matrix), small, small_config(), tmp_path)


def test_a_dark_luminaire_is_refused(lamp, tmp_path):
    from lumitree.fit.octree.bake import refine

    black = '<bsdf type="diffuse"><rgb name="reflectance" value="0"/></bsdf>'
    dark = lamp(sphere("lamp", 1, inside=AREA), sphere("shell", 2, inside=black))
    with pytest.raises(LumitreeError, match="no light"):
        refine(rough(dark), dark, small_config(), tmp_path)


@pytest.mark.slow
def test_an_interrupted_refinement_continues(ball, tmp_path, monkeypatch):
    from lumitree.fit.octree.bake import refine

    asset = rough(ball)
    steps = interrupt_after(monkeypatch, 5)
    first = refine(asset, ball, small_config(), tmp_path / "folder")
    assert first.stopped_by == signal.SIGINT
    assert 0 < first.rays < RAYS
    # Not with another asset, even one of the same structure, nor with another seed.
    darker = dataclasses.replace(asset, coefficients=asset.coefficients - np.float16(1))
    for other, seed in ((darker, 0), (asset, 1)):
        with pytest.raises(LumitreeError, match="unfinished bake with other inputs"):
            refine(other, ball, small_config(), tmp_path / "folder", seed)
    second = refine(asset, ball, small_config(), tmp_path / "folder")
    assert second.stopped_by is None
    assert steps == list(range(1, len(steps) + 1))
    assert second.rays >= RAYS
    # As if it had never been interrupted, to the last bit.
    whole = refine(asset, ball, small_config(), tmp_path / "whole")
    assert whole.score == second.score
    for name in ("children", "density", "coefficients"):
        assert np.array_equal(getattr(whole.asset, name), getattr(second.asset, name))
