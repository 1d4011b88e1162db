"""The descent of a bake: steps until the budget is spent, with scores, splits and saved states."""

import time

from lumitree.core.interrupt import Interruption
from lumitree.core.progress import progress
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.fit.octree.calibration import calibrate
from lumitree.fit.octree.config import OctreeConfig
from lumitree.fit.octree.heldout import HeldOut
from lumitree.fit.octree.leaf_field import LeafField
from lumitree.fit.octree.ray_source import RaySource
from lumitree.fit.octree.refine import Refiner
from lumitree.fit.octree.saved_state import StateFile


class Budget:
    """Time and rays that a bake has spent, in this run and in those that it continues.

    Args:
        config: the budget.
        seconds, rays: spent by earlier runs.

    Attributes:
        rays: rays of the descent so far.
        reserved: seconds that are kept for what follows the descent.
    """

    def __init__(self, config: OctreeConfig, seconds: float, rays: int) -> None:
        self._config, self._earlier, self.rays = config, seconds, rays
        self._start = time.monotonic()
        self.reserved = 0.0

    @property
    def seconds(self) -> float:
        """Seconds so far."""
        return self._earlier + time.monotonic() - self._start

    @property
    def is_over(self) -> bool:
        """Whether the time is spent, also what is reserved; False without a limit of time."""
        return self._config.time is not None and self.seconds >= self._config.time

    @property
    def progress(self) -> float:
        """Share of the budget that is spent, 1 when it is all."""
        shares = [0.0]
        if self._config.time is not None:
            shares.append((self.seconds + self.reserved) / self._config.time)
        if self._config.rays is not None:
            shares.append(self.rays / self._config.rays)
        return min(max(shares), 1.0)


class Descent:
    """The descent of one bake; `best` is the field with the highest rank of its score."""

    def __init__(
        self,
        refiner: Refiner,
        best: LeafField,
        source: RaySource,
        max_radiance: float,
        held_out: HeldOut,
        budget: Budget,
        config: OctreeConfig,
        state_file: StateFile,
    ) -> None:
        self._refiner, self._source, self._max_radiance = refiner, source, max_radiance
        self._held_out, self._budget, self._config = held_out, budget, config
        self._state_file = state_file
        self.best, self.best_score = best.copy(), held_out.score(best)

    def run(self, name: str, interruption: Interruption) -> None:
        """Refine until the budget is spent or `interruption` is set, and save the state.

        Args:
            name: of the task, for the progress that is shown.
        """
        schedule = self._config.schedule
        done = self._budget.progress
        saved, saving = time.monotonic(), 0.0
        with progress(name, 1.0, done) as advance:
            while done < 1 and not interruption:
                self._budget.rays += self._refiner.advance(done)
                before, done = done, self._budget.progress
                self._restructure(before, done)
                if _passes(schedule.score_interval, before, done):
                    self.keep_better(self._refiner.field)
                pause = max(schedule.save_seconds, schedule.save_time_factor * saving)
                if time.monotonic() - saved >= pause:
                    start = time.monotonic()
                    self.save()
                    saved = time.monotonic()
                    saving = saved - start
                advance(
                    done - before, f"{self.best_score}, {self._refiner.field.num_leaves} leaves"
                )
        # The calibration that follows can be repeated from here, without the descent. Saved first:
        # where a signal ended the descent, the bake that continues would not keep this field.
        self.save()
        self.keep_better(self._refiner.field)

    def keep_better(self, field: LeafField) -> None:
        """Make a field the best so far, if it is."""
        score = self._held_out.score(field)
        if score.rank >= self.best_score.rank:
            self.best, self.best_score = field.copy(), score

    def save(self) -> None:
        """Save the state."""
        self._state_file.save(
            self._refiner, self.best, self._budget.seconds, self._budget.rays, self._max_radiance
        )

    def _restructure(self, before: float, done: float) -> None:
        """When it is time, drop and calibrate leaves, and split some of them by one level."""
        schedule, refiner = self._config.schedule, self._refiner
        if not _passes(schedule.split_interval, before, done) or done > schedule.last_split:
            return
        refiner.prune()
        start = time.monotonic()
        stream = SeedStream(Purpose.CALIBRATION, refiner.step)
        calibrate(refiner.field, self._source, self._max_radiance, self._config.calibration, stream)
        self._budget.reserved = schedule.closing_calibrations * (time.monotonic() - start)
        deepest = int(refiner.field.levels.max())
        if deepest < self._config.tree_depth and self._budget.progress < 1:
            refiner.split(deepest + 1)


def _passes(interval: float, before: float, done: float) -> bool:
    """Whether a multiple of `interval` lies between two shares of the budget."""
    return int(done / interval) > int(before / interval)
