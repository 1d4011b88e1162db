"""Bakes of many lamps into one folder, with an index page."""

import dataclasses
import hashlib
import inspect
import os
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any, Literal, TypedDict, Unpack

from lumitree.api.baking import Quality, bake, check_bake
from lumitree.api.files import FilePath
from lumitree.api.lamp_record import INDEX_FILES, LampFiles, LampRecord, settings_text
from lumitree.api.luminaires import dataset_folder
from lumitree.api.measures import peak_memory_bytes
from lumitree.api.photometric_files import applicable_settings, warn_of_unused
from lumitree.api.results import Result
from lumitree.asset.asset import Part
from lumitree.builtin.registry import BUILTIN
from lumitree.core.arguments import check_asset_output
from lumitree.core.backend import load_mitsuba
from lumitree.core.dataset import MANIFEST
from lumitree.core.files import check_writable, write_bytes
from lumitree.core.interrupt import deferred_interrupt, interruption_behind
from lumitree.core.progress import ProgressCallback, reporting, show_progress
from lumitree.core.progress import progress as progress_of
from lumitree.core.reading import read_bytes
from lumitree.core.transmittance import Law
from lumitree.errors import LumitreeError, explained, shown
from lumitree.evaluation.index_page import GENERATOR, Entry, figure_rows, index_page
from lumitree.luminaire.source import LuminaireSource, as_source, source_kind

INDEX = "index.html"
State = Literal["baked", "kept", "failed", "interrupted", "waiting"]
_MAX_SOURCE_BYTES, _MAX_INDEX_BYTES = 1 << 26, 1 << 30
# Arguments of `bake` that do not apply, or do not change the asset.
_NOT_SETTINGS = ("luminaire", "output", "work", "variant", "progress")


class BakeSettings(TypedDict, total=False):
    """Settings of `bake` that apply to many lamps; see there."""

    quality: Quality
    time: float | None
    rays: int | None
    tree_depth: int | None
    l_max: int | None
    law: Law | None
    parts: Collection[Part] | None
    irradiance_paths: int | None
    lumens: float | None
    temperature: float | None
    seed: int


@dataclasses.dataclass(frozen=True)
class BakedLamp:
    """One lamp of `bake_many`.

    Attributes:
        name: of the lamp and of its files.
        source: luminaire that it was baked from.
        state: "baked"; "kept", if an earlier call has baked it with these settings; "failed";
            "interrupted", which the same call continues; or "waiting", if the call was
            interrupted before it.
        path: file of the asset; None if none was written.
        error: why it failed; None if it did not.
        seconds: wall time of its bake, with that of earlier calls.
        figures: `lumens`, `file_bytes`, `size` and `irradiance_rms`; empty if there is no asset.
    """

    name: str
    source: str
    state: State
    path: Path | None = None
    error: str | None = None
    seconds: float = 0.0
    figures: dict[str, Any] = dataclasses.field(default_factory=dict)


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


@explained
def bake_many(
    luminaires: Sequence[FilePath | LuminaireSource],
    folder: FilePath,
    *,
    variant: str | None = None,
    progress: ProgressCallback | None = show_progress,
    **settings: Unpack[BakeSettings],
) -> BakeManyResult:
    """Bake luminaires one after another into a folder, with an index page.

    The asset of a lamp is NAME.lumitree; NAME is the file name without its ending, or the built-in
    name. `index.html` shows all lamps of the folder. It is written again after each lamp. The
    folder `index-files` within has a thumbnail and a record of each bake.

    The same call continues where an earlier one was interrupted. It keeps lamps whose luminaire
    and settings are those of the record, continues the interrupted one, and tries those again that
    failed. A lamp that fails does not affect the others.

    Args:
        luminaires: names, files and `LuminaireSource`, as for `bake`.
        folder: folder of the assets. It is made if it is missing.
        variant: Mitsuba variant; see `bake`.
        progress: function that is called with a `Progress` after each step. Reports of the bake of
            a lamp have a report of the whole list as `within`.
        settings: keyword arguments of `bake`, for all lamps: `quality`, `time`, `rays`,
            `tree_depth`, `l_max`, `law`, `parts`, `irradiance_paths`, `lumens`, `temperature` and
            `seed`. For photometric files those that do not apply are not used, with a warning.

    Returns:
        What became of each lamp (`lamps`), and the path of the index page (`index`).

    Raises:
        LumitreeError: there is no luminaire, or two have one name; an argument is out of range; or
            the folder cannot be written, or holds an `index.html` that is not lumitree's.

    Example:
        >>> result = lumitree.bake_many(["bulbs", "lamp.glb"], "lamps", quality="preview")
        >>> [(lamp.name, lamp.state) for lamp in result.lamps]
    """
    root = Path(folder)
    _check_index(root / INDEX)
    named = _named([as_source(each) for each in luminaires], root)
    options = _complete(settings)
    check_bake(**{key: options[key] for key in options if key not in ("lumens", "temperature")})
    defaults = _complete({})
    given = {name: value for name, value in settings.items() if value != defaults[name]}
    warn_of_unused(named.values(), given)
    load_mitsuba(variant)
    lamps = [BakedLamp(name, source.name, "waiting") for name, source in named.items()]
    stopped_by = None
    title = f"bake {len(lamps)} lamps"
    with reporting(progress), progress_of(title, len(lamps)) as advance:
        for index, (name, source) in enumerate(named.items()):
            applicable = applicable_settings(options, source)
            job = _Job(LampFiles(root, name), source, applicable, variant, progress)
            lamps[index], stopped_by = job.run()
            with deferred_interrupt() as interruption:
                _write_index(root, lamps)
            stopped_by = interruption.number if stopped_by is None else stopped_by
            if stopped_by is not None:
                break
            advance(1)
    return BakeManyResult(
        folder=root,
        index=root / INDEX,
        lamps=lamps,
        stopped_by=stopped_by,
        seconds={lamp.name: round(lamp.seconds, 1) for lamp in lamps},
        peak_memory_bytes=peak_memory_bytes(),
    )


def _check_index(path: Path) -> None:
    """Refuse an index page that cannot be written, or that is not lumitree's."""
    check_writable(path)
    if os.path.exists(path):
        content = read_bytes(path, "an index page", _MAX_INDEX_BYTES)
        if GENERATOR.encode() not in content[:1000]:
            raise LumitreeError(
                f"{shown(path, 300)} is not a page of lumitree; choose another folder, or move it"
            )


def _named(sources: Sequence[LuminaireSource], folder: Path) -> dict[str, LuminaireSource]:
    """The luminaires by the name of their files; refuses names that occur twice."""
    if not sources:
        raise LumitreeError("no luminaire to bake; give at least one")
    named: dict[str, LuminaireSource] = {}
    # Some file systems do not distinguish upper and lower case.
    taken: dict[str, str] = {}
    for source in sources:
        name = source.name if source.name in BUILTIN else Path(source.name).stem
        if (other := taken.get(name.casefold())) is not None:
            raise LumitreeError(
                f"{shown(other, 200)} and {shown(source.name, 200)} would both be written to "
                f"{shown(folder / name, 200)}.lumitree; rename one, or choose another folder for it"
            )
        taken[name.casefold()] = source.name
        check_asset_output(LampFiles(folder, name).asset)
        named[name] = source
    return named


def _complete(settings: BakeSettings) -> dict[str, Any]:
    """The settings, with the defaults of `bake` for those that are not given."""
    parameters = inspect.signature(bake).parameters
    defaults = {
        name: each.default for name, each in parameters.items() if name not in _NOT_SETTINGS
    }
    if unknown := settings.keys() - defaults.keys():
        raise TypeError(f"bake_many() got an unexpected keyword argument {min(unknown)!r}")
    return defaults | settings


@dataclasses.dataclass(frozen=True)
class _Job:
    """The bake of one lamp of a list."""

    files: LampFiles
    source: LuminaireSource
    options: dict[str, Any]
    variant: str | None
    progress: ProgressCallback | None

    def run(self) -> tuple[BakedLamp, int | None]:
        """Bake the lamp, or keep it; returns its state, and the number of a signal or None."""
        try:
            return self._run()
        except (Exception, KeyboardInterrupt) as error:
            if (interrupted := interruption_behind(error)) is not None:
                return self._lamp("interrupted", self.files.read()), interrupted.number
            reason = " ".join(str(error).split()) or "no details"
            if not isinstance(error, LumitreeError):
                reason = f"unexpected {type(error).__name__}: {reason}"
            return dataclasses.replace(self._lamp("failed", None), error=shown(reason, 1000)), None

    def _run(self) -> tuple[BakedLamp, int | None]:
        fingerprint, luminaire = self._loaded()
        settings = settings_text(self.options)
        record = self.files.read()
        seconds = 0.0
        if record is not None and record.is_of(fingerprint, settings):
            if record.finished:
                return self._lamp("kept", record), None
            seconds = record.seconds
        result = bake(
            luminaire,
            self.files.asset,
            variant=self.variant,
            progress=self.progress,
            **self.options,
        )
        finished = result.stopped_by is None
        # Otherwise a signal would make the next call repeat a bake that is complete.
        with deferred_interrupt() as interruption:
            record = self.files.write(
                result.asset,
                result.irradiance,
                fingerprint=fingerprint,
                settings=settings,
                finished=finished,
                seconds=seconds + sum(result.seconds.values()),
            )
        stopped_by = result.stopped_by if not finished else interruption.number
        return self._lamp("baked" if finished else "interrupted", record), stopped_by

    def _loaded(self) -> tuple[str, Any]:
        """Fingerprint of the luminaire, and what `bake` gets for it."""
        path = Path(self.source.name)
        if source_kind(self.source) == "photometric":
            return _digest(path, "a photometric file"), self.source
        if (dataset := dataset_folder(self.source)) is not None:
            return _digest(dataset / MANIFEST, "a dataset"), self.source
        from lumitree.luminaire.luminaire import load_luminaire

        luminaire = load_luminaire(self.source)
        return luminaire.fingerprint, luminaire

    def _lamp(self, state: State, record: LampRecord | None) -> BakedLamp:
        lamp = BakedLamp(self.files.name, self.source.name, state)
        if record is None:
            return lamp
        return dataclasses.replace(
            lamp, path=self.files.asset, seconds=record.seconds, figures=record.figures
        )


def _digest(path: Path, kind: str) -> str:
    return hashlib.sha256(read_bytes(path, kind, _MAX_SOURCE_BYTES)).hexdigest()


def _write_index(folder: Path, lamps: Sequence[BakedLamp]) -> None:
    """Write the index page of these lamps, and of others that the folder has records of."""
    names = {lamp.name for lamp in lamps}
    others = []
    for path in sorted((folder / INDEX_FILES).glob("*.json")):
        record = LampFiles(folder, path.stem).read() if path.stem not in names else None
        if record is not None:
            state: State = "kept" if record.finished else "interrupted"
            asset = LampFiles(folder, path.stem).asset
            others.append(
                BakedLamp(path.stem, "", state, asset, None, record.seconds, record.figures)
            )
    entries = [_entry(folder, lamp) for lamp in (*lamps, *others)]
    write_bytes(folder / INDEX, index_page(folder.resolve().name or "lamps", entries))


def _entry(folder: Path, lamp: BakedLamp) -> Entry:
    notes = {
        "failed": f"failed: {lamp.error}",
        "interrupted": "interrupted; the same command continues",
        "waiting": "not baked yet",
    }
    thumbnail = LampFiles(folder, lamp.name).thumbnail
    shows = lamp.path is not None and thumbnail.is_file()
    return Entry(
        name=lamp.name,
        link=None if lamp.path is None else lamp.path.name,
        image=thumbnail.read_bytes() if shows else None,
        rows=figure_rows(lamp.figures, lamp.seconds) if lamp.figures else (),
        note=notes.get(lamp.state, ""),
        failed=lamp.state == "failed",
    )
