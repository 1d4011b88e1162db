"""The octree fit: a first field, gradient descent within a budget, and a closing calibration.

`bake`, `bake_stored` and `refine` differ in where the rays come from and in the field that they
start from; `_run` is the rest.
"""

import dataclasses
import math
import warnings
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.asset import Asset
from lumitree.core.checkpoint import Checkpoint
from lumitree.core.harmonics import Y_00, num_coefficients
from lumitree.core.interruption import deferred_interrupt
from lumitree.core.progress import progress
from lumitree.core.seeds import MAX_SEED, Purpose, SeedStream
from lumitree.errors import LumitreeError, LumitreeWarning
from lumitree.fit.octree.calibration import calibrate, flux_correction
from lumitree.fit.octree.config import OctreeConfig
from lumitree.fit.octree.descent import Budget, Descent, HeldOut, Refiner, Score
from lumitree.fit.octree.estimate import estimate, grow
from lumitree.fit.octree.leaf_field import LEAVES, LeafField
from lumitree.fit.octree.rays import RaySource, Subject, TracedRays
from lumitree.fit.octree.stored import StoredRays
from lumitree.lamp.dataset import Dataset
from lumitree.lamp.luminaire import Luminaire
from lumitree.octree.build import build_children, leaf_cells

# Part of the light above L_max from which images of the field show what makes up for it.
_MUCH_BEYOND = 1 / 3
# Makes the first field of a bake, and its L_max.
Start = Callable[[], tuple[LeafField, float]]


@dataclasses.dataclass(frozen=True)
class OctreeFitResult:
    """The best field after the closing calibration, and its score on the held-out rays.

    Rays and seconds include the runs that this one continued.
    """

    asset: Asset
    score: Score
    rays: int
    seconds: float
    stopped_by: int | None


def bake(
    luminaire: Luminaire, config: OctreeConfig, folder: Path, seed: int = 0
) -> OctreeFitResult:
    """Bake a luminaire; continues an interrupted bake whose state is in `folder`.

    Args:
        luminaire: what is baked.
        config: how.
        folder: where the state is kept while it runs.
        seed: root seed of all random numbers.

    Raises:
        LumitreeError: no light leaves the luminaire, or `folder` has the state of another bake.
    """
    source = _traced_rays(luminaire, config, seed)

    def start() -> tuple[LeafField, float]:
        max_radiance = config.max_radiance.headroom * _visible_radiance(source, config)
        return _first_field(source, config, max_radiance), max_radiance

    return _run(source, config, folder, seed, "bake", start)


def bake_stored(
    dataset: Dataset, config: OctreeConfig, folder: Path, seed: int = 0
) -> OctreeFitResult:
    """Bake the views of a dataset; otherwise as `bake`.

    Raises:
        LumitreeError: the views are black, too few or have nothing in common, or `folder` has the
            state of another bake.
    """
    source = StoredRays(dataset, config.views.held_out_stride, seed)
    rate = config.views.coefficient_rate_factor * config.refine.coefficient_rate
    descent = dataclasses.replace(config.refine, coefficient_rate=rate)
    config = dataclasses.replace(config, refine=descent)

    def start() -> tuple[LeafField, float]:
        field = _hull_field(source, config)
        if not field.num_leaves:
            raise LumitreeError(f"no part of the box is lit in every view of {dataset.folder}")
        return field, config.max_radiance.headroom * source.max_radiance()

    return _run(source, config, folder, seed, "bake", start)


def refine(
    asset: Asset, luminaire: Luminaire, config: OctreeConfig, folder: Path, seed: int = 0
) -> OctreeFitResult:
    """Continue from an asset, however it was made, with rays of its luminaire.

    Args:
        asset: where to start; its law and l_max stay, its leaves may be split.
        luminaire: the luminaire that it was baked from.
        config: how; its depth, l_max and law are replaced by the asset's.
        folder: where the state is kept while it runs.
        seed: root seed. The rays depend on the asset too, and differ from the rays that it was
            made with.

    Raises:
        LumitreeError: the bounding boxes of asset and luminaire differ, or `folder` has the state
            of another bake.
    """
    first, second = asset.frame, luminaire.frame
    moved = np.abs(first.world_from_local - second.world_from_local).max()
    near = moved <= 1e-3 * min(first.scale, second.scale)
    if not (near and np.allclose(first.half_extents, second.half_extents, atol=1e-3)):
        raise LumitreeError(
            f"the asset ({asset.luminaire}) and {luminaire.name} have different bounding boxes; "
            "refine an asset with the luminaire that it was baked from"
        )
    config = dataclasses.replace(
        config, tree_depth=asset.tree_depth, l_max=asset.l_max, law=asset.law
    )
    # Not the seed of the rays that the asset was made with.
    checksum = zlib.crc32(asset.coefficients.tobytes(), zlib.crc32(asset.density.tobytes()))
    seed = SeedStream(Purpose.CONTINUATION, checksum).seed(seed) & MAX_SEED
    source = _traced_rays(luminaire, config, seed)

    def start() -> tuple[LeafField, float]:
        # Refuses a luminaire without light.
        _visible_radiance(source, config)
        leaves = leaf_cells(asset.children, asset.num_leaves)
        field = _field(config, source, *leaves, asset.density, asset.coefficients)
        return field, asset.max_radiance

    return _run(source, config, folder, seed, "refine", start)


def _run(
    source: RaySource, config: OctreeConfig, folder: Path, seed: int, verb: str, start: Start
) -> OctreeFitResult:
    """Start, or continue from the state in `folder`; spend the budget and make the asset."""
    name = source.subject.name
    inputs = dataclasses.asdict(config)
    # A bake may continue with another budget.
    del inputs["time"], inputs["rays"]
    inputs |= {"luminaire": source.subject.fingerprint, "seed": seed}
    checkpoint = Checkpoint(folder / "octree.npz", inputs, "bake")
    saved = checkpoint.load()
    if saved is None:
        budget = Budget(config, 0.0, 0)
        field, max_radiance = start()
        refiner = Refiner(field, source, max_radiance, config.refine, config.split)
        best = refiner.field
    else:
        budget = Budget(config, float(saved["seconds"]), int(saved["rays"]))
        none, max_radiance = np.zeros((0, 3), np.int64), float(saved["max_radiance"])
        field = _field(config, source, none, none[:, 0], none[:, 0], np.zeros(0))
        refiner = Refiner(field, source, max_radiance, config.refine, config.split)
        refiner.restore(saved)
        # The best field that was saved: an uninterrupted bake would not have kept the current one.
        best = field.with_leaves(*(saved[f"best_{name}"] for name in LEAVES))
    held_out = HeldOut.trace(source, max_radiance, config.held_out)
    descent = Descent(refiner, best, source, max_radiance, held_out, budget, config, checkpoint)
    with deferred_interrupt() as interruption:

        def over() -> bool:
            return budget.is_over or bool(interruption)

        # At once, so that the first estimate, which takes tens of seconds, need not be repeated.
        descent.save()
        descent.run(f"{verb} {name}", interruption)
        if not budget.rays and not interruption:
            warnings.warn(
                f"{name}: {config.time:g} s were over before the gradient descent began; "
                "give it more",
                LumitreeWarning,
                stacklevel=2,
            )
        with progress(f"calibrate {name}", 2) as advance:
            # The descent leaves small bright parts a few percent too bright. The flux
            # correction factor makes up for the rest, as where the sigmoid saturates.
            stream = SeedStream(Purpose.CLOSING_CALIBRATION, refiner.step)
            if not interruption:
                calibrate(descent.best, source, max_radiance, config.calibration, stream, over)
            advance(1)
            factor, beyond = flux_correction(
                descent.best, source, max_radiance, config.flux, refiner.step, over
            )
            advance(1)
        if beyond > _MUCH_BEYOND and not interruption:
            warnings.warn(
                f"{beyond:.0%} of the light of {name} is radiance above L_max; for it the field is "
                f"{factor:.2g} times brighter everywhere, and images of it are too bright; show "
                "the model (--parts all), or give a larger max_radiance.headroom (--config)",
                LumitreeWarning,
                stacklevel=2,
            )
        score = held_out.rescaled(factor).score(descent.best)
    asset = make_asset(descent.best, source.subject, factor * max_radiance)
    return OctreeFitResult(asset, score, budget.rays, budget.seconds, interruption.number)


def make_asset(field: LeafField, subject: Subject, max_radiance: float) -> Asset:
    """The asset of a field."""
    limit = float(np.finfo(np.float16).max)
    return Asset(
        children=build_children(field.cells, field.levels),
        density=np.exp(np.array(field.log_density)).astype(np.float32),
        coefficients=field.coefficient_array().clip(-limit, limit).astype(np.float16),
        tree_depth=field.tree_depth,
        l_max=field.l_max,
        law=field.law,
        max_radiance=max_radiance,
        frame=subject.frame,
        luminaire=subject.name,
    )


def _traced_rays(luminaire: Luminaire, config: OctreeConfig, seed: int) -> TracedRays:
    level = min(config.tree_depth, config.ray_spacing_level)
    return TracedRays(luminaire, spacing=2 / (1 << level), seed=seed)


def _visible_radiance(source: TracedRays, config: OctreeConfig) -> float:
    """`TracedRays.max_radiance` of pixels as wide as the smallest leaves; refuses 0."""
    max_radiance = source.max_radiance(2 / (1 << config.tree_depth), config.max_radiance)
    if not max_radiance > 0:
        raise LumitreeError(
            f"no light of {source.subject.name} is seen from outside its bounding box; a luminaire "
            "needs an emitter that can be, and one too small for rays to find can be baked with "
            "--parts light"
        )
    return max_radiance


def _first_field(source: TracedRays, config: OctreeConfig, max_radiance: float) -> LeafField:
    level = min(config.tree_depth, config.estimate.max_level)
    cells = grow(source, level, config.estimate)
    if not len(cells):
        raise LumitreeError(
            f"no ray ends on a surface or in a medium of {source.subject.name}, so that it has no "
            "radiance field; bake it with --parts light"
        )
    first = estimate(source, cells, level, config.l_max, config.law, max_radiance, config.estimate)
    levels = np.full(len(first.cells), level)
    field = _field(config, source, first.cells, levels, first.density, first.coefficients)
    calibrate(field, source, max_radiance, config.calibration, SeedStream(Purpose.CALIBRATION))
    return field


def _hull_field(source: StoredRays, config: OctreeConfig) -> LeafField:
    """The visual hull of stored views, with equal leaves."""
    views = config.views
    level = min(config.tree_depth, views.hull_level)
    cells = source.hull(level)
    coefficients = np.zeros((len(cells), 3, num_coefficients(config.l_max)))
    coefficients[:, :, 0] = math.log(views.hull_emission / (1 - views.hull_emission)) / Y_00
    density = np.full(len(cells), views.hull_optical_depth * (1 << level) / 2)
    return _field(config, source, cells, np.full(len(cells), level), density, coefficients)


def _field(
    config: OctreeConfig,
    source: RaySource,
    cells: NDArray[np.int64],
    levels: NDArray[np.int64],
    density: NDArray[Any],
    coefficients: NDArray[Any],
) -> LeafField:
    return LeafField(
        cells,
        levels,
        np.log(np.maximum(density, 1e-3)),
        coefficients,
        tree_depth=config.tree_depth,
        l_max=config.l_max,
        law=config.law,
        half_extents=source.subject.frame.half_extents,
    )
