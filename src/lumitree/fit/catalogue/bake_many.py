"""Bakes of many lamps into one folder, with an index page."""

import contextlib
import dataclasses
import os
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

from lumitree.core.arguments import check_asset_output
from lumitree.core.executor import check_executor, run_tasks
from lumitree.core.files import FilePath
from lumitree.core.interrupt import deferred_interrupt, interruptible, interruption_behind
from lumitree.core.progress import ProgressCallback, reporting, show_progress
from lumitree.core.progress import progress as progress_of
from lumitree.core.system import peak_memory_bytes
from lumitree.core.turns import in_turn
from lumitree.errors import LumitreeError, LumitreeWarning, shown
from lumitree.fit.catalogue.claim import UNKNOWN
from lumitree.fit.catalogue.folder import Part, check_folder, mark_folder, write_part
from lumitree.fit.catalogue.index import FolderIndex, check_index
from lumitree.fit.catalogue.lamp_job import LampJob, Outcome, bake_lamp
from lumitree.fit.catalogue.page import INDEX
from lumitree.fit.catalogue.record import BakedLamp, LampFiles, settings_text
from lumitree.fit.catalogue.result import BakeManyResult
from lumitree.fit.config import BakeConfig
from lumitree.lamp.builtin.registry import BUILTIN
from lumitree.lamp.source import LuminaireSource, as_source, gldf_variant, source_kind

# Interval at which lamps are tried again that other processes work on, s.
_AGAIN_SECONDS = 0.5


@in_turn
def bake_many(
    luminaires: Sequence[FilePath | LuminaireSource],
    folder: FilePath,
    config: BakeConfig | None = None,
    *,
    executor: Executor | None = None,
    task: tuple[int, int] | None = None,
    variant: str | None = None,
    progress: ProgressCallback | None = show_progress,
) -> BakeManyResult:
    """Bake luminaires into a folder, with an index page.

    The asset of a lamp is NAME.lumitree; NAME is the `title` of its `LuminaireSource`, or else the
    file name without its ending, or the built-in name. `index.html` shows all lamps of the folder,
    200 a page. It is written every few seconds, and at the end. The folder `index-files` within has
    a thumbnail and a record of each bake.

    The same call continues where an earlier one was interrupted. It keeps lamps whose luminaire
    and settings are those of the record, continues the interrupted one, and tries those again that
    failed. A lamp that fails does not affect the others. The files of a lamp are compared by size
    and time; where these differ, by content.

    Several processes, on one machine or on several with a common file system, may bake into one
    folder. Each takes the lamps on which no other one works, and at the end waits for the others.

    Args:
        luminaires: names, files and `LuminaireSource`, as for `bake`.
        folder: folder of the assets. It is made if it is missing.
        config: settings of the bakes of all lamps. Default: `BakeConfig()`. For
            photometric files those that do not apply are not used, with a warning.
        executor: what runs the bakes, a task for each lamp: any `concurrent.futures.Executor`, such
            as that of `process_pool` or of a Dask client. Its workers need the same files under the
            same paths. Default: this process bakes one lamp after another.
        task: (K, N) bakes one part of the list only: the lamps at positions K, K + N, K + 2 N and
            so on, counted from 1. No page is written; `collect` does that when all parts are baked.
        variant: Mitsuba variant; see `bake`.
        progress: function that is called with a `Progress` after each step. Without an executor,
            reports of the bake of a lamp have a report of the whole list as `within`.

    Returns:
        What became of each lamp (`lamps`), and the path of the index page (`index`).

    Raises:
        LumitreeError: there is no luminaire, two have one name, or files are missing, all of which
            the message names; the folder cannot be written,
            holds an `index.html` that is not lumitree's, or is of a later version; or a worker
            was lost.

    Example:
        >>> result = lumitree.bake_many(["bulbs", "lamp.glb"], "lamps")
        >>> [(lamp.name, lamp.state) for lamp in result.lamps]
    """
    check_executor(executor)
    root = Path(folder)
    check_index(root / INDEX)
    check_folder(root)
    if isinstance(luminaires, str | os.PathLike):
        raise LumitreeError(
            f"luminaires is {shown(repr(luminaires), 100)}; expected a list of them"
        )
    named = _named([as_source(each) for each in luminaires], root)
    part = None if task is None else _part(task)
    if part is not None:
        named = dict(list(named.items())[part.number - 1 :: part.count])
    config = BakeConfig.of() if config is None else config
    if config.method == "network":
        raise LumitreeError("method network: for one luminaire at a time; bake each by itself")
    mark_folder(root)
    if part is not None:
        write_part(root, part, named)
    jobs = _jobs(root, named, config, variant)
    bakes = _Bakes(jobs, FolderIndex(root) if part is None else None)
    with reporting(progress), progress_of(f"bake {len(jobs)} lamps", len(jobs)) as advance:
        bakes.run(executor, progress, advance)
    return BakeManyResult(
        folder=root,
        index=root / INDEX,
        lamps=bakes.lamps,
        stopped_by=bakes.stopped_by,
        seconds={lamp.name: round(lamp.seconds, 1) for lamp in bakes.lamps},
        peak_memory_bytes=peak_memory_bytes(),
    )


def _jobs(
    root: Path, named: Mapping[str, LuminaireSource], config: BakeConfig, variant: str | None
) -> list[LampJob]:
    """The bakes of luminaires by name; sources of one kind share settings and their text."""
    shared: dict[bool, tuple[BakeConfig, str]] = {}
    jobs = []
    for name, source in named.items():
        is_photometric = source_kind(source) == "photometric"
        if is_photometric not in shared:
            own = config
            if is_photometric and "light" in (config.parts or ()):
                # The only part that it can have.
                own = dataclasses.replace(config, parts=None)
            shared[is_photometric] = own, settings_text(own, source)
        jobs.append(LampJob(root, name, source, *shared[is_photometric], variant))
    return jobs


class _Bakes:
    """The bakes of a list: states of its lamps, and the signal that ended it, if any."""

    def __init__(self, jobs: Sequence[LampJob], index: FolderIndex | None) -> None:
        """Begin with all lamps "waiting"; `index` is written meanwhile."""
        self.lamps = [BakedLamp(job.name, job.source.name, "waiting") for job in jobs]
        self.stopped_by: int | None = None
        self._jobs, self._index = jobs, index

    def run(
        self,
        executor: Executor | None,
        progress: ProgressCallback | None,
        advance: Callable[[float], None],
    ) -> None:
        """Bake the lamps that are not kept, until all are finished or a signal ends it."""
        told: set[Any] = set()
        try:
            with interruptible():
                waiting = self._not_kept(advance)
                while waiting:
                    waiting = self._round(waiting, executor, progress, advance, told)
                    if waiting:
                        time.sleep(_AGAIN_SECONDS)
        except KeyboardInterrupt as error:
            interrupted = interruption_behind(error)
            self.stopped_by = None if interrupted is None else interrupted.number
        if self._index is not None:
            with deferred_interrupt() as interruption:
                self._index.write(self.lamps)
            if self.stopped_by is None:
                self.stopped_by = interruption.number

    def _not_kept(self, advance: Callable[[float], None]) -> list[int]:
        """Keep what an earlier call has baked; returns the positions of the other lamps."""
        others = []
        for position, job in enumerate(self._jobs):
            if (kept := job.kept()) is None:
                others.append(position)
            else:
                self.lamps[position] = kept
                advance(1)
        return others

    def _round(
        self,
        positions: Sequence[int],
        executor: Executor | None,
        progress: ProgressCallback | None,
        advance: Callable[[float], None],
        told: set[Any],
    ) -> list[int]:
        """Bake each lamp once; returns those on which other processes work."""
        left = []
        with self._outcomes(positions, executor, progress) as outcomes:
            for position, outcome in outcomes:
                self.lamps[position] = outcome.lamp
                if outcome.lamp.state == "waiting":
                    left.append(position)
                    _warn_of_other(outcome, told)
                    continue
                advance(1)
                with deferred_interrupt() as interruption:
                    if self._index is not None:
                        self._index.update(self.lamps)
                number = outcome.stopped_by or interruption.number
                if number is not None:
                    self.stopped_by = number
                    return []
        return left

    @contextlib.contextmanager
    def _outcomes(
        self,
        positions: Sequence[int],
        executor: Executor | None,
        progress: ProgressCallback | None,
    ) -> Iterator[Iterator[tuple[int, Outcome]]]:
        """Context with positions of lamps and what became of them, as they finish."""
        if executor is None:
            yield ((position, self._jobs[position].run(progress)) for position in positions)
            return
        jobs = ((self._jobs[position].elsewhere(),) for position in positions)
        with run_tasks(executor, bake_lamp, jobs, what="lamps", total=len(positions)) as results:
            yield (
                (positions[index], self._jobs[positions[index]].here(outcome))
                for index, outcome in results
            )


def _warn_of_other(outcome: Outcome, told: set[Any]) -> None:
    """Warn once of each process that works on a lamp."""
    owner = outcome.owner or UNKNOWN
    if (owner.host, owner.process) not in told:
        told.add((owner.host, owner.process))
        warnings.warn(
            f"{owner} works on {shown(outcome.lamp.name, 200)}; the lamps on which it works are "
            "left until the end",
            LumitreeWarning,
            stacklevel=4,
        )


def _named(sources: Sequence[LuminaireSource], folder: Path) -> dict[str, LuminaireSource]:
    """The luminaires by the name of their files; refuses names that occur twice."""
    if not sources:
        raise LumitreeError("no luminaire to bake; give at least one")
    paths = [gldf_variant(each.name)[0] for each in sources if each.name not in BUILTIN]
    paths += [each.materials for each in sources if each.materials is not None]
    files = dict.fromkeys(paths)
    if missing := [shown(each, 200) for each in files if not os.path.exists(each)]:
        raise LumitreeError(
            f"{len(missing)} of {len(files)} files are missing: {', '.join(missing)}"
        )
    named: dict[str, LuminaireSource] = {}
    # Some file systems do not distinguish upper and lower case.
    taken: dict[str, str] = {}
    for source in sources:
        own = source.name if source.name in BUILTIN else Path(gldf_variant(source.name)[0]).stem
        name = source.title or own
        if (other := taken.get(name.casefold())) is not None:
            raise LumitreeError(
                f"{shown(other, 200)} and {shown(source.name, 200)} would both be written to "
                f"{shown(folder / name, 200)}.lumitree; give one another name, as NAME=FILE, or "
                "choose another folder for it"
            )
        taken[name.casefold()] = source.name
        check_asset_output(LampFiles(folder, name).asset)
        named[name] = source
    return named


def _part(task: object) -> Part:
    if isinstance(task, str) or not isinstance(task, Sequence) or len(task) != 2:
        raise LumitreeError(f"task is {shown(repr(task), 60)}; expected (number, count)")
    return Part(*task)
