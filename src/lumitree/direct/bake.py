"""The direct bake: estimate an octree from rays, refine it with more rays, within a budget."""

import dataclasses
import json
import math
import time
import warnings
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.asset import Asset
from lumitree.core.dataset import Dataset
from lumitree.core.files import atomic_path
from lumitree.core.harmonics import MAX_L, Y_00, num_coefficients
from lumitree.core.interrupt import Interruption, deferred_interrupt
from lumitree.core.progress import progress
from lumitree.core.reading import read_arrays
from lumitree.core.seeds import MAX_SEED, Purpose, SeedStream, check_seed
from lumitree.core.transmittance import LAWS, Law
from lumitree.direct.balance import balance, light_left_over
from lumitree.direct.estimate import estimate, grow
from lumitree.direct.heldout import HeldOut, Score
from lumitree.direct.leaf_field import LEAVES, LeafField
from lumitree.direct.ray_source import RaySource, Subject, TracedRays
from lumitree.direct.refine import HEADROOM, RefineConfig, Refiner
from lumitree.direct.stored import StoredRays
from lumitree.errors import LumitreeError, LumitreeWarning
from lumitree.luminaire.luminaire import Luminaire
from lumitree.octree.build import MAX_TREE_DEPTH, build_children
from lumitree.octree.leaves import leaf_cells

STATE = "state.npz"
_STATE_VERSION = 1
# The statistics are taken at this level at the finest, and the hull of pictures at this one; what
# is finer comes from splitting.
_ESTIMATE_DEPTH, _HULL_DEPTH = 8, 6
# Neighbouring lines are as far apart as leaves of this level: closer they tell a leaf of too few
# directions, farther they are slower to follow.
_LINE_DEPTH = 6
# Shares of the budget: between two times at which leaves are split, and after which none are.
_SPLIT_EVERY, _LAST_SPLIT = 0.15, 0.65
# Optical depth across a leaf of the hull, and its radiance / L_max, before anything is known.
_HULL_OPTICAL_DEPTH, _HULL_RADIANCE = 0.3, 0.01
# From there the way is longer than from an estimate: so are the coefficients' steps, by this much.
_HULL_STEPS = 4.0
# How many times as long as balancing what follows the descent takes.
_CLOSING_BALANCES = 2.5
# Share of the budget between two scores on the held-out rays. Not a time, so that with a budget of
# rays alone the field that is kept does not depend on the machine's speed.
_SCORE_EVERY = 0.04
# Seconds between two saved states: at least these, and so many times what the last one took.
_SAVE_SECONDS, _SAVE_RARELY = 10.0, 50.0


@dataclasses.dataclass(frozen=True)
class DirectConfig:
    """A direct bake.

    Attributes:
        tree_depth: level of the smallest leaves.
        l_max: highest band of the spherical harmonics.
        law: transmittance law.
        estimate_lines: lines traced for the first estimate.
        seconds: budget of time; None for no limit.
        rays: budget of refinement rays; None for no limit.
        seed: root seed of all random numbers, 0 to 2**31 - 1.
        refine: the descent.
    """

    tree_depth: int = 8
    l_max: int = 2
    law: Law = "exponential"
    estimate_lines: int = 1 << 23
    seconds: float | None = 285.0
    rays: int | None = None
    seed: int = 0
    refine: RefineConfig = dataclasses.field(default_factory=RefineConfig)

    def __post_init__(self) -> None:
        if not 1 <= self.tree_depth <= MAX_TREE_DEPTH:
            raise LumitreeError(
                f"tree depth {self.tree_depth} is out of range; choose 1 to {MAX_TREE_DEPTH}"
            )
        if not 0 <= self.l_max <= MAX_L:
            raise LumitreeError(f"l_max {self.l_max} is out of range; choose 0 to {MAX_L}")
        check_seed(self.seed)
        if self.law not in LAWS:
            raise LumitreeError(f"law {self.law!r} is unknown; choose {' or '.join(LAWS)}")
        if self.estimate_lines < 1:
            raise LumitreeError(f"estimate_lines is {self.estimate_lines}; expected 1 or more")
        if self.seconds is None and self.rays is None:
            raise LumitreeError("a bake needs a budget; give it seconds or rays")
        if (self.seconds is not None and not self.seconds > 0) or (
            self.rays is not None and self.rays < 1
        ):
            raise LumitreeError("the budget of a bake must be above 0")


@dataclasses.dataclass(frozen=True)
class DirectResult:
    """What came out: the asset, its held-out score, rays and seconds spent, in all.

    Attributes:
        stopped_by: number of the signal that ended the bake early; None if none did.
    """

    asset: Asset
    score: Score
    rays: int
    seconds: float
    stopped_by: int | None


# What `--quality` names: minutes on two CPU cores.
QUALITIES: dict[str, DirectConfig] = {
    "preview": DirectConfig(tree_depth=7, estimate_lines=1 << 22, seconds=60.0),
    "standard": DirectConfig(),
    # With ten times as many leaves, a step with as few lines would tell most of them nothing.
    "high": DirectConfig(tree_depth=10, seconds=1740.0, refine=RefineConfig(lines=1 << 17)),
}


def bake(luminaire: Luminaire, config: DirectConfig, folder: Path) -> DirectResult:
    """Bake a luminaire; continues what an interrupted bake left in `folder`.

    Args:
        luminaire: what is baked.
        config: how.
        folder: where the state is kept while it runs.

    Raises:
        LumitreeError: no light comes out, or `folder` holds the state of another bake.
    """
    source = _source(luminaire, config)

    def start() -> tuple[LeafField, float]:
        max_radiance = HEADROOM * _radiance_of(source, config)
        return _first_field(source, config, max_radiance), max_radiance

    return _run(source, config, folder, "bake", start)


def bake_stored(dataset: Dataset, config: DirectConfig, folder: Path) -> DirectResult:
    """Bake what a dataset's pictures show; otherwise as `bake`.

    Raises:
        LumitreeError: the pictures are black, too few or show nothing in common, or `folder` holds
            the state of another bake.
    """
    source = StoredRays(dataset, config.seed)
    rate = _HULL_STEPS * config.refine.coefficient_rate
    descent = dataclasses.replace(config.refine, coefficient_rate=rate)
    config = dataclasses.replace(config, refine=descent)

    def start() -> tuple[LeafField, float]:
        level = min(config.tree_depth, _HULL_DEPTH)
        cells = source.hull(level)
        if not len(cells):
            raise LumitreeError(f"no part of the box is lit in every view of {dataset.folder}")
        coefficients = np.zeros((len(cells), 3, num_coefficients(config.l_max)))
        coefficients[:, :, 0] = math.log(_HULL_RADIANCE / (1 - _HULL_RADIANCE)) / Y_00
        density = np.full(len(cells), _HULL_OPTICAL_DEPTH * (1 << level) / 2)
        levels = np.full(len(cells), level)
        field = _field(config, source, cells, levels, density, coefficients)
        return field, HEADROOM * source.max_radiance()

    return _run(source, config, folder, "bake", start)


def refine(asset: Asset, luminaire: Luminaire, config: DirectConfig, folder: Path) -> DirectResult:
    """Go on with an asset, however it was made, with rays of its luminaire.

    Args:
        asset: where to start; its law and l_max stay, its leaves may be split.
        luminaire: what it shows.
        config: how; its depth, l_max and law are replaced by the asset's. The rays depend on its
            seed and on the asset, so that they are not those that the asset was made with.
        folder: where the state is kept while it runs.

    Raises:
        LumitreeError: the asset shows something of other proportions or at another place, or
            `folder` holds the state of another bake.
    """
    if not (
        np.allclose(asset.half_extents, luminaire.half_extents, atol=1e-3)
        and np.allclose(asset.world_from_proxy, luminaire.world_from_proxy, rtol=1e-3, atol=1e-3)
    ):
        raise LumitreeError(
            f"the asset ({asset.luminaire}) and {luminaire.name} have different bounding boxes; "
            "refine an asset with its own luminaire"
        )
    config = dataclasses.replace(
        config,
        tree_depth=asset.tree_depth,
        l_max=asset.l_max,
        law=asset.law,
        seed=_continued_seed(asset, config.seed),
    )
    source = _source(luminaire, config)

    def start() -> tuple[LeafField, float]:
        _radiance_of(source, config)
        leaves = leaf_cells(asset.children, asset.num_leaves)
        field = _field(config, source, *leaves, asset.density, asset.coefficients)
        return field, asset.max_radiance

    return _run(source, config, folder, "refine", start)


def _source(luminaire: Luminaire, config: DirectConfig) -> TracedRays:
    level = min(config.tree_depth, _LINE_DEPTH)
    return TracedRays(luminaire, spacing=2 / (1 << level), seed=config.seed)


def _continued_seed(asset: Asset, seed: int) -> int:
    """Root seed for refining an asset: not the one of the rays that it was made with."""
    checksum = zlib.crc32(asset.coefficients.tobytes(), zlib.crc32(asset.density.tobytes()))
    return SeedStream(Purpose.CONTINUATION, checksum).seed(seed) & MAX_SEED


def _radiance_of(source: TracedRays, config: DirectConfig) -> float:
    """Radiance that next to nothing exceeds in pixels as wide as the smallest leaves (D9)."""
    max_radiance = source.max_radiance(2 / (1 << config.tree_depth))
    if not max_radiance > 0:
        raise LumitreeError(
            f"{source.subject.name} sends no light out of its bounding box; a luminaire needs an "
            "emitter that can be seen from outside"
        )
    return max_radiance


def _run(
    source: RaySource,
    config: DirectConfig,
    folder: Path,
    verb: str,
    start: Callable[[], tuple[LeafField, float]],
) -> DirectResult:
    """Start, or continue what `folder` holds, and spend the budget."""
    record = _record(source.subject, config)
    saved = _load(folder / STATE, record)
    if saved is None:
        clock = _Clock(config, 0.0, 0)
        field, max_radiance = start()
    else:
        clock = _Clock(config, float(saved["seconds"]), int(saved["rays"]))
        none = np.zeros((0, 3), np.int64)
        field = _field(config, source, none, none[:, 0], none[:, 0], np.zeros(0))
        max_radiance = float(saved["max_radiance"])
    refiner = Refiner(field, source, max_radiance, config.refine)
    if saved is not None:
        refiner.restore(saved)
    held_out = HeldOut.trace(source, max_radiance)
    loop = _Loop(refiner, held_out, clock, config, folder, record, max_radiance)
    if saved is not None:
        loop.keep_better(field.with_leaves(*(saved[f"best_{name}"] for name in LEAVES)))
    with deferred_interrupt() as stop:
        # A first state at once: an estimate takes longer than most of what can go wrong.
        loop.save()
        loop.run(f"{verb} {source.subject.name}", stop)
        # And one here: what follows can be repeated, the descent cannot.
        loop.save()
        with progress(f"calibrate {source.subject.name}", 2) as advance:
            # The descent leaves what is small and bright a few percent too bright; and what the
            # sigmoid has no room for is made up by the rest.
            closing = SeedStream(Purpose.CLOSING_CALIBRATION, refiner.step)
            balance(loop.best, source, max_radiance, closing, stop)
            advance(1)
            factor = light_left_over(loop.best, source, max_radiance, refiner.step, stop)
            advance(1)
        score = held_out.rescaled(factor).score(loop.best)
    asset = make_asset(loop.best, source.subject, factor * max_radiance)
    return DirectResult(asset, score, clock.rays, clock.seconds, stop.number)


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
        half_extents=subject.half_extents,
        world_from_proxy=subject.world_from_proxy,
        luminaire=subject.name,
    )


def _first_field(source: TracedRays, config: DirectConfig, max_radiance: float) -> LeafField:
    level = min(config.tree_depth, _ESTIMATE_DEPTH)
    cells = grow(source, level, config.estimate_lines // 2)
    first = estimate(
        source, cells, level, config.l_max, config.law, max_radiance, config.estimate_lines
    )
    levels = np.full(len(first.cells), level)
    field = _field(config, source, first.cells, levels, first.density, first.coefficients)
    balance(field, source, max_radiance, SeedStream(Purpose.CALIBRATION))
    return field


def _field(
    config: DirectConfig,
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
        half_extents=source.subject.half_extents,
    )


class _Clock:
    """What of the budget is spent, by this run and those before it."""

    def __init__(self, config: DirectConfig, seconds: float, rays: int) -> None:
        self._config, self._earlier, self.rays = config, seconds, rays
        self._start = time.monotonic()
        # Seconds of the budget that are kept for what follows the descent.
        self.reserved = 0.0

    @property
    def seconds(self) -> float:
        return self._earlier + time.monotonic() - self._start

    @property
    def progress(self) -> float:
        """Share of the budget that is spent, 1 when it is all."""
        shares = [0.0]
        if self._config.seconds is not None:
            shares.append((self.seconds + self.reserved) / self._config.seconds)
        if self._config.rays is not None:
            shares.append(self.rays / self._config.rays)
        return min(max(shares), 1.0)


class _Loop:
    """Steps until the budget is spent, with scores, splits and saved states on the way."""

    def __init__(
        self,
        refiner: Refiner,
        held_out: HeldOut,
        clock: _Clock,
        config: DirectConfig,
        folder: Path,
        record: str,
        max_radiance: float,
    ) -> None:
        self._refiner, self._held_out, self._clock = refiner, held_out, clock
        self._config, self._folder, self._record = config, folder, record
        self._max_radiance = max_radiance
        self.best, self.best_score = refiner.field.copy(), held_out.score(refiner.field)
        self._can_save = True

    def run(self, name: str, stop: Interruption) -> None:
        """Refine until the budget is spent or `stop` is set."""
        done = self._clock.progress
        saved, saving = time.monotonic(), 0.0
        with progress(name, 1.0, done) as advance:
            while done < 1 and not stop:
                self._clock.rays += self._refiner.advance(done)
                before, done = done, self._clock.progress
                self._split(before, done)
                if int(done / _SCORE_EVERY) > int(before / _SCORE_EVERY):
                    self.keep_better(self._refiner.field)
                if time.monotonic() - saved >= max(_SAVE_SECONDS, _SAVE_RARELY * saving):
                    start = time.monotonic()
                    self.save()
                    saved = time.monotonic()
                    saving = saved - start
                advance(
                    done - before, f"{self.best_score}, {self._refiner.field.num_leaves} leaves"
                )
        self.keep_better(self._refiner.field)

    def _split(self, before: float, done: float) -> None:
        """Prune now and then, and make the leaves one level deeper until they are deep enough."""
        turn = int(done / _SPLIT_EVERY)
        if turn == int(before / _SPLIT_EVERY) or done > _LAST_SPLIT:
            return
        self._refiner.prune()
        start = time.monotonic()
        self._refiner.balance()
        self._clock.reserved = _CLOSING_BALANCES * (time.monotonic() - start)
        deepest = int(self._refiner.field.levels.max())
        if deepest < self._config.tree_depth:
            self._refiner.split(deepest + 1)

    def keep_better(self, field: LeafField) -> None:
        """Make a field the best so far, if it is."""
        score = self._held_out.score(field)
        if score.rank >= self.best_score.rank:
            self.best, self.best_score = field.copy(), score

    def save(self) -> None:
        """Save the state; warns, once, where that fails: the bake itself can go on."""
        state = self._refiner.state()
        state["max_radiance"] = np.array(self._max_radiance)
        state["seconds"] = np.array(self._clock.seconds)
        state["rays"] = np.array(self._clock.rays)
        state["record"] = np.array(self._record)
        state |= {f"best_{name}": value for name, value in self.best.arrays().items()}
        try:
            with atomic_path(self._folder / STATE) as temporary:
                np.savez(temporary, **state)  # type: ignore[arg-type]
            self._can_save = True
        except LumitreeError as error:
            if self._can_save:
                self._can_save = False
                warnings.warn(
                    f"cannot save the state of the bake: {error.__cause__}; the bake goes on, but "
                    "cannot be continued if it is killed",
                    LumitreeWarning,
                    stacklevel=2,
                )


def _record(subject: Subject, config: DirectConfig) -> str:
    """What must agree for a state to be continued; a budget may be raised."""
    fields = dataclasses.asdict(config)
    del fields["seconds"], fields["rays"]
    return json.dumps(
        {"version": _STATE_VERSION, "fingerprint": subject.fingerprint, **fields}, sort_keys=True
    )


def _load(path: Path, record: str) -> Mapping[str, NDArray[Any]] | None:
    if not path.exists():
        return None
    try:
        state = read_arrays(path)
        found = str(state["record"])
    except (LumitreeError, KeyError) as error:
        reason = str(error) if isinstance(error, LumitreeError) else f"{path} is no state of a bake"
        raise LumitreeError(f"{reason}; remove its folder to start again") from None
    if found != record:
        raise LumitreeError(
            f"{path.parent} holds the unfinished bake of another luminaire or with other "
            "settings; remove it, or choose another output with -o"
        )
    return state
