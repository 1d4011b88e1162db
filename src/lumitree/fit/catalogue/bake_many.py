"""Bakes of many lamps into one folder, with an index page."""

import dataclasses
import hashlib
import time
import warnings
from collections import deque
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from lumitree.core.arguments import check_asset_output
from lumitree.core.backend import load_rgb
from lumitree.core.dataset import MANIFEST
from lumitree.core.files import FilePath, WriteError, exclusive
from lumitree.core.interrupt import deferred_interrupt, interruptible, interruption_behind
from lumitree.core.progress import ProgressCallback, reporting, show_progress
from lumitree.core.progress import progress as progress_of
from lumitree.core.reading import read_bytes
from lumitree.core.results import Result
from lumitree.core.system import peak_memory_bytes
from lumitree.core.work_folder import BusyFolderError
from lumitree.errors import LumitreeError, LumitreeWarning, explained, shown
from lumitree.fit.catalogue.index import INDEX, BakedLamp, State, check_index, write_index
from lumitree.fit.catalogue.record import LampFiles, LampRecord, settings_text
from lumitree.fit.config import BakeConfig
from lumitree.fit.sources import applicable, bake_source, warn_of_unused
from lumitree.lamp.builtin.registry import BUILTIN
from lumitree.lamp.source import (
    LuminaireSource,
    as_source,
    dataset_folder,
    gldf_variant,
    source_kind,
)

# Interval at which a lamp is tried again that another process works on, s.
_AGAIN_SECONDS = 0.5
_MAX_SOURCE_BYTES = 1 << 26


@dataclasses.dataclass(frozen=True, repr=False, kw_only=True)
class BakeManyResult(Result):
    """Result of `bake_many`.

    Attributes:
        folder: folder of the assets.
        index: index page of the folder.
        lamps: the lamps, in the order of the call.
        stopped_by: number of the signal that interrupted the call; None if there was none.
    """

    folder: Path
    index: Path
    lamps: list[BakedLamp]
    stopped_by: int | None = None

    @property
    def failed(self) -> list[BakedLamp]:
        """The lamps that failed."""
        return [lamp for lamp in self.lamps if lamp.state == "failed"]

    @property
    def finished(self) -> bool:
        """Whether no lamp is left to be baked. A signal may have arrived afterwards."""
        return all(lamp.state in ("baked", "kept", "failed") for lamp in self.lamps)


@explained
def bake_many(
    luminaires: Sequence[FilePath | LuminaireSource],
    folder: FilePath,
    config: BakeConfig | None = None,
    *,
    variant: str | None = None,
    progress: ProgressCallback | None = show_progress,
) -> BakeManyResult:
    """Bake luminaires one after another into a folder, with an index page.

    The asset of a lamp is NAME.lumitree; NAME is the file name without its ending, or the built-in
    name. `index.html` shows all lamps of the folder. It is written again after each lamp. The
    folder `index-files` within has a thumbnail and a record of each bake.

    The same call continues where an earlier one was interrupted. It keeps lamps whose luminaire
    and settings are those of the record, continues the interrupted one, and tries those again that
    failed. A lamp that fails does not affect the others.

    Several processes may bake into one folder. Each takes the lamps on which no other one works,
    and at the end waits for the others.

    Args:
        luminaires: names, files and `LuminaireSource`, as for `bake`, `bake_views` and
            `bake_photometric`.
        folder: folder of the assets. It is made if it is missing.
        config: settings of the bakes of all lamps. Default: `BakeConfig.standard()`. For
            photometric files those that do not apply are not used, with a warning.
        variant: Mitsuba variant; see `bake`.
        progress: function that is called with a `Progress` after each step. Reports of the bake of
            a lamp have a report of the whole list as `within`.

    Returns:
        What became of each lamp (`lamps`), and the path of the index page (`index`).

    Raises:
        LumitreeError: there is no luminaire, or two have one name; or the folder cannot
            be written, or holds an `index.html` that is not lumitree's.

    Example:
        >>> result = lumitree.bake_many(["bulbs", "lamp.glb"], "lamps")
        >>> [(lamp.name, lamp.state) for lamp in result.lamps]
    """
    root = Path(folder)
    check_index(root / INDEX)
    named = _named([as_source(each) for each in luminaires], root)
    config = BakeConfig.standard() if config is None else config
    warn_of_unused(named.values(), config)
    load_rgb(variant)
    lamps = [BakedLamp(name, source.name, "waiting") for name, source in named.items()]
    stopped_by = None
    jobs = deque(
        enumerate(
            _Job(LampFiles(root, name), source, applicable(config, source), variant, progress)
            for name, source in named.items()
        )
    )
    skipped: set[str] = set()
    with reporting(progress), progress_of(f"bake {len(lamps)} lamps", len(lamps)) as advance:
        while jobs and stopped_by is None:
            index, job = jobs.popleft()
            # Then only such lamps are left.
            wait = len(jobs) < len(skipped)
            lamps[index], stopped_by = job.run(wait)
            if lamps[index].state == "waiting":
                jobs.append((index, job))
                _warn_of_other(job.files.name, skipped)
                continue
            skipped.discard(job.files.name)
            with deferred_interrupt() as interruption:
                write_index(root, lamps)
            stopped_by = interruption.number if stopped_by is None else stopped_by
            advance(1)
    return BakeManyResult(
        folder=root,
        index=root / INDEX,
        lamps=lamps,
        stopped_by=stopped_by,
        seconds={lamp.name: round(lamp.seconds, 1) for lamp in lamps},
        peak_memory_bytes=peak_memory_bytes(),
    )


def _warn_of_other(name: str, skipped: set[str]) -> None:
    """Warn once that another process works on a lamp."""
    if name not in skipped:
        skipped.add(name)
        warnings.warn(
            f"another process works on {shown(name, 200)}; it is left until the end",
            LumitreeWarning,
            stacklevel=3,
        )


def _named(sources: Sequence[LuminaireSource], folder: Path) -> dict[str, LuminaireSource]:
    """The luminaires by the name of their files; refuses names that occur twice."""
    if not sources:
        raise LumitreeError("no luminaire to bake; give at least one")
    named: dict[str, LuminaireSource] = {}
    # Some file systems do not distinguish upper and lower case.
    taken: dict[str, str] = {}
    for source in sources:
        name = source.name if source.name in BUILTIN else Path(gldf_variant(source.name)[0]).stem
        if (other := taken.get(name.casefold())) is not None:
            raise LumitreeError(
                f"{shown(other, 200)} and {shown(source.name, 200)} would both be written to "
                f"{shown(folder / name, 200)}.lumitree; rename one, or choose another folder for it"
            )
        taken[name.casefold()] = source.name
        check_asset_output(LampFiles(folder, name).asset)
        named[name] = source
    return named


@dataclasses.dataclass(frozen=True)
class _Job:
    """The bake of one lamp of a list."""

    files: LampFiles
    source: LuminaireSource
    config: BakeConfig
    variant: str | None
    progress: ProgressCallback | None

    def run(self, wait: bool) -> tuple[BakedLamp, int | None]:
        """Bake the lamp, or keep it; returns its state, and the number of a signal or None.

        The state is "waiting" if another process works on the lamp. With `wait` that is seen after
        a while.
        """
        try:
            with interruptible():
                if wait:
                    time.sleep(_AGAIN_SECONDS)
                with exclusive(self.files.lock) as free:
                    return self._run() if free else (self._lamp("waiting", None), None)
        except BusyFolderError:
            # A command that bakes this lamp alone.
            return self._lamp("waiting", None), None
        except (Exception, KeyboardInterrupt) as error:
            if (interrupted := interruption_behind(error)) is not None:
                return self._lamp("interrupted", self.files.read()), interrupted.number
            if _disk_is_full(error):
                # No other lamp could be written either.
                raise
            reason = " ".join(str(error).split()) or "no details"
            if not isinstance(error, LumitreeError):
                reason = f"unexpected {type(error).__name__}: {reason}"
            return dataclasses.replace(self._lamp("failed", None), error=shown(reason, 1000)), None

    def _run(self) -> tuple[BakedLamp, int | None]:
        fingerprint, luminaire = self._loaded()
        settings = settings_text(self.config, self.source)
        record = self.files.read()
        seconds = 0.0
        if record is not None and record.is_of(fingerprint, settings):
            if record.finished:
                return self._lamp("kept", record), None
            seconds = record.seconds
        result = bake_source(
            luminaire,
            self.files.asset,
            self.config,
            variant=self.variant,
            progress=self.progress,
        )
        # Otherwise a signal would make the next call repeat a bake that is complete.
        with deferred_interrupt() as interruption:
            record = self.files.write(
                result.asset,
                result.irradiance,
                fingerprint=fingerprint,
                settings=settings,
                finished=result.finished,
                seconds=seconds + sum(result.seconds.values()),
            )
        stopped_by = interruption.number if result.stopped_by is None else result.stopped_by
        return self._lamp("baked" if result.finished else "interrupted", record), stopped_by

    def _loaded(self) -> tuple[str, Any]:
        """Fingerprint of the luminaire, and what `bake` gets for it."""
        if source_kind(self.source) == "photometric":
            path, variant = gldf_variant(self.source.name)
            digest = _digest(Path(path), "a photometric file")
            return digest if variant is None else f"{digest}#{variant}", self.source
        if (dataset := dataset_folder(self.source)) is not None:
            return _digest(dataset / MANIFEST, "a dataset"), self.source
        from lumitree.lamp.loading import load_luminaire

        luminaire = load_luminaire(self.source)
        return luminaire.fingerprint, luminaire

    def _lamp(self, state: State, record: LampRecord | None) -> BakedLamp:
        lamp = BakedLamp(self.files.name, self.source.name, state)
        if record is None:
            return lamp
        return dataclasses.replace(
            lamp, path=self.files.asset, seconds=record.seconds, figures=record.figures
        )


def _disk_is_full(error: BaseException | None) -> bool:
    while error is not None and not isinstance(error, WriteError):
        error = error.__cause__
    return error is not None and error.full


def _digest(path: Path, kind: str) -> str:
    return hashlib.sha256(read_bytes(path, kind, _MAX_SOURCE_BYTES)).hexdigest()
