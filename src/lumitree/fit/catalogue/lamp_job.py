"""The bake of one lamp of a list: a task for this process or for a worker."""

import dataclasses
import functools
import hashlib
import os
import time
from pathlib import Path
from typing import Any

from lumitree.core.backend import load_rgb
from lumitree.core.dataset import MANIFEST
from lumitree.core.files import WriteError
from lumitree.core.interrupt import deferred_interrupt, interruptible, interruption_behind
from lumitree.core.packing import variant_here
from lumitree.core.progress import ProgressCallback
from lumitree.core.reading import read_bytes
from lumitree.core.work_folder import BusyFolderError, WorkFolder
from lumitree.errors import LumitreeError, shown
from lumitree.fit.bake import bake as bake_source
from lumitree.fit.catalogue.claim import UNKNOWN, Owner, claimed
from lumitree.fit.catalogue.folder import recorded
from lumitree.fit.catalogue.record import (
    BakedLamp,
    LampFiles,
    LampRecord,
    State,
    figures_of,
    options_text,
)
from lumitree.fit.catalogue.stamps import stamps_of
from lumitree.fit.config import BakeConfig
from lumitree.fit.finishing import work_folder_of
from lumitree.formats.photometric_file import read_again
from lumitree.lamp.importers.model_folder import noted_files
from lumitree.lamp.sent import absolute_source
from lumitree.lamp.source import LuminaireSource, dataset_folder, gldf_variant, source_kind

# That of the largest format, ray files.
_MAX_SOURCE_BYTES = 1 << 32


@dataclasses.dataclass(frozen=True)
class Outcome:
    """Final state of a lamp, the signal that stopped its bake, or the process that it waits for."""

    lamp: BakedLamp
    stopped_by: int | None = None
    owner: Owner | None = None


@dataclasses.dataclass(frozen=True)
class LampJob:
    """The bake of one lamp of a list; `settings` is the text of `config`, see `settings_text`."""

    folder: Path
    name: str
    source: LuminaireSource
    config: BakeConfig
    settings: str
    variant: str | None

    def elsewhere(self) -> "LampJob":
        """The same for a process that may have another working folder."""
        source, folder = absolute_source(self.source), Path(os.path.abspath(self.folder))
        return dataclasses.replace(
            self, folder=folder, source=source, variant=self.variant or variant_here()
        )

    def here(self, outcome: Outcome) -> Outcome:
        """Outcome of the lamp `elsewhere`, with the names that this process uses."""
        lamp = outcome.lamp
        path = None if lamp.path is None else LampFiles(self.folder, self.name).asset
        lamp = dataclasses.replace(lamp, source=self.source.name, path=path)
        return dataclasses.replace(outcome, lamp=lamp)

    def kept(self) -> BakedLamp | None:
        """The lamp if it has been baked with these settings, and no file has changed since.

        None if that is not the case, or can only be known once the luminaire is loaded.
        """
        files = LampFiles(self.folder, self.name)
        record = files.read()
        if record is None or not record.finished or record.options != self._options():
            return None
        if record.settings != self.settings:
            return None
        now = record.current(self.folder)
        now = None if now is None else now.of_asset(self.folder)
        if now is None:
            return None
        if now != record or files.read_failure() is not None:
            files.write(now)
        return self._lamp("kept", now)

    def run(self, progress: ProgressCallback | None) -> Outcome:
        """Bake the lamp, or keep it. The state is "waiting" if another process works on it.

        Raises:
            LumitreeError: no lamp can be baked here: Mitsuba or its variant cannot be used.
            WriteError: the disk is full.
        """
        files = LampFiles(self.folder, self.name)
        load_rgb(self.variant)
        try:
            with interruptible(), claimed(files.claim) as owner:
                if owner is not None:
                    return Outcome(self._lamp("waiting", None), owner=owner)
                return self._run(files, progress)
        except BusyFolderError:
            # A command that bakes this lamp alone.
            return Outcome(self._lamp("waiting", None), owner=UNKNOWN)
        except (Exception, KeyboardInterrupt) as error:
            if (interrupted := interruption_behind(error)) is not None:
                return Outcome(self._lamp("interrupted", self._recorded(files)), interrupted.number)
            if _disk_is_full(error):
                raise
            reason = " ".join(str(error).split()) or "no details"
            if not isinstance(error, LumitreeError):
                reason = f"unexpected {type(error).__name__}: {reason}"
            reason = shown(reason, 1000)
            files.write_failure(reason)
            return Outcome(dataclasses.replace(self._lamp("failed", None), error=reason))

    def _run(self, files: LampFiles, progress: ProgressCallback | None) -> Outcome:
        # Another process may have baked it meanwhile.
        if (kept := self.kept()) is not None:
            return Outcome(kept)
        return self._bake(files, progress)

    def _bake(self, files: LampFiles, progress: ProgressCallback | None) -> Outcome:
        read_at = time.time_ns()
        fingerprint, luminaire, paths = self._loaded()
        stamps = None if paths is None else stamps_of(paths, self.folder, read_at)
        found = self._recorded(files)
        seconds = 0.0
        if found is not None and found.is_of(fingerprint, self.settings):
            if found.finished:
                kept = dataclasses.replace(found, options=self._options(), files=stamps)
                if kept != found or files.read_failure() is not None:
                    files.write(kept)
                return Outcome(self._lamp("kept", kept))
            seconds = found.seconds
        # Needs Mitsuba's variant.
        from lumitree.fit.octree.saved_state import STATE, OtherBakeError

        bake = functools.partial(
            bake_source,
            luminaire,
            files.asset,
            self.config,
            variant=self.variant,
            progress=progress,
        )
        try:
            result = bake()
        except OtherBakeError:
            # The lamp or its settings have changed since its bake was interrupted.
            with WorkFolder(work_folder_of(files.asset)) as work:
                work.remove([STATE])
            result = bake()
        # Otherwise a signal would make the next call repeat a bake that is complete.
        with deferred_interrupt() as interruption:
            image = files.write_image(result.asset, self.settings)
            stamp = files.stamp()
            record = LampRecord(
                options=self._options(),
                files=stamps,
                fingerprint=fingerprint,
                settings=self.settings,
                finished=result.finished,
                asset=stamp,
                image=image,
                seconds=seconds + sum(result.seconds.values()),
                figures=figures_of(result.asset, stamp.size, result.irradiance),
            )
            files.write(record)
        stopped_by = interruption.number if result.stopped_by is None else result.stopped_by
        return Outcome(
            self._lamp("baked" if result.finished else "interrupted", record), stopped_by
        )

    def _loaded(self) -> tuple[str, Any, list[Path] | None]:
        """Fingerprint of the luminaire, what `bake` gets for it, and the files it depends on."""
        from lumitree.lamp.source_files import source_files

        if source_kind(self.source) == "photometric":
            path, variant = gldf_variant(self.source.name)
            digest = _digest(Path(path), "a photometric file")
            digest = digest if variant is None else f"{digest}#{variant}"
            # A table of tilts may be in a file beside it.
            with noted_files() as beside:
                read_again(path)
            for table in sorted(each for each in beside if each.is_file()):
                digest += "+" + _digest(table, "a TILT file")
            return digest, self.source, [Path(path), *sorted(beside)]
        if (dataset := dataset_folder(self.source)) is not None:
            digest = _digest(dataset / MANIFEST, "a dataset")
            return digest, self.source, source_files(self.source, None)
        from lumitree.lamp.loading import load_luminaire

        luminaire = load_luminaire(self.source)
        return luminaire.fingerprint, luminaire, source_files(self.source, luminaire)

    def _options(self) -> str:
        return options_text(self.source, self.folder)

    def _recorded(self, files: LampFiles) -> LampRecord | None:
        """The record, if the asset is the one of it."""
        record = files.read()
        return None if record is None else record.of_asset(self.folder)

    def _lamp(self, state: State, record: LampRecord | None) -> BakedLamp:
        lamp = BakedLamp(self.name, self.source.name, state)
        if record is None:
            return lamp
        return dataclasses.replace(
            recorded(LampFiles(self.folder, self.name), lamp, record), state=state
        )


def bake_lamp(job: LampJob) -> Outcome:
    """`LampJob.run` as the task of a worker, which reports no progress."""
    return job.run(None)


def _disk_is_full(error: BaseException | None) -> bool:
    while error is not None and not isinstance(error, WriteError):
        error = error.__cause__
    return error is not None and error.full


def _digest(path: Path, kind: str) -> str:
    return hashlib.sha256(read_bytes(path, kind, _MAX_SOURCE_BYTES)).hexdigest()
