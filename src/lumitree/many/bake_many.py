"""Bakes of many lamps into one folder, as independent tasks."""

import contextlib
import dataclasses
import functools
import hashlib
import json
import os
from collections.abc import Collection, Iterable, Iterator, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

from lumitree.asset.asset import Part
from lumitree.asset.file import fingerprint_of, load, save
from lumitree.core.arguments import check_asset_output, check_count
from lumitree.core.backend import in_turn, load_rgb
from lumitree.core.checkpoint import CHECKPOINTS, OtherJobError
from lumitree.core.executor import check_executor, run_tasks, variant_here
from lumitree.core.files import FilePath, WorkFolder, WriteError
from lumitree.core.interruption import deferred_interrupt, interruptible, interruption_behind
from lumitree.core.progress import ProgressCallback, reporting, show_progress
from lumitree.core.progress import progress as progress_of
from lumitree.core.results import Stopwatch
from lumitree.errors import LumitreeError, shown
from lumitree.fit.bake import bake
from lumitree.fit.config import (
    ONLY_PARTS,
    BakeConfig,
    Method,
    Quality,
    chosen_config,
    refuse_unused,
)
from lumitree.fit.finishing import work_folder_of
from lumitree.formats.photometric_file import read_again
from lumitree.lamp.builtin import BUILTIN
from lumitree.lamp.dataset import MANIFEST
from lumitree.lamp.importers.model_files import noted_files
from lumitree.lamp.luminaire import absolute_source
from lumitree.lamp.source import (
    LuminaireSource,
    as_source,
    dataset_folder,
    gldf_variant,
    source_kind,
)
from lumitree.many.page import INDEX, check_index, write_index, write_thumbnail
from lumitree.many.result import BakedLamp, BakeManyResult

MAX_PARTS = 100_000


@in_turn
def bake_many(
    luminaires: Sequence[FilePath | LuminaireSource],
    folder: FilePath,
    config: BakeConfig | None = None,
    *,
    quality: Quality | None = None,
    method: Method | None = None,
    parts: Collection[Part] | None = None,
    time: float | None = None,
    rays: int | None = None,
    lumens: float | None = None,
    temperature: float | None = None,
    seed: int | None = None,
    executor: Executor | None = None,
    task: tuple[int, int] | None = None,
    variant: str | None = None,
    progress: ProgressCallback | None = show_progress,
) -> BakeManyResult:
    """Bake luminaires into a folder, with an index page.

    The asset of a lamp is NAME.lumitree; NAME is the `title` of its `LuminaireSource`, or else the
    file name without its ending, or the built-in name. `index.html` shows all lamps of the folder,
    with thumbnails in the folder `index-files`. It is written at the end.

    Each asset has a fingerprint of its luminaire and settings. The same call keeps lamps whose
    fingerprint is the same, continues the interrupted one, and tries those again that failed. A
    lamp that fails does not affect the others.

    Args:
        luminaires: names, files and `LuminaireSource`, as for `bake`.
        folder: folder of the assets. It is made if it is missing.
        config: settings of the bakes of all lamps. Default: the settings of `quality`. A
            photometric file gets the part "light" only, and a dataset the part "field" only, if
            the parts have it.
        quality: for all lamps, as for `bake`. A setting that only some lamps use is a warning.
        method: only "octree".
        parts: as for `bake`.
        time: budget of the radiance field of each lamp, s.
        rays: budget of rays of each lamp.
        lumens: luminous flux of each lamp, lm.
        temperature: colour temperature of the flux of each lamp, K.
        seed: root seed of each lamp.
        executor: runs the bakes, a task for each lamp: any `concurrent.futures.Executor`, such as
            the one of `process_pool` or of a Dask client. Its workers need the same files under the
            same paths. Default: this process bakes one lamp after another.
        task: (K, N) bakes one part of the list only: the lamps at positions K, K + N, K + 2 N and
            so on, counted from 1. No page is written; `collect` does that when all parts are baked.
        variant: Mitsuba variant; see `bake`.
        progress: function that is called with a `Progress` after each step. Without an executor,
            reports of the bake of a lamp have a report of the whole list as `within`.

    Returns:
        The state of each lamp (`lamps`), and the path of the index page (`index`).

    Raises:
        LumitreeError: there is no luminaire, two have one name, or files are missing, all of which
            the message names; no lamp uses a setting that is given; the folder cannot be written,
            or holds an `index.html` that is not lumitree's; the disk is full; or a worker was lost.

    Example:
        >>> result = lumitree.bake_many(["bulbs", "lamp.glb"], "lamps")
        >>> [(lamp.name, lamp.state) for lamp in result.lamps]
    """
    check_executor(executor)
    root, watch = Path(folder), Stopwatch()
    check_index(root / INDEX)
    if isinstance(luminaires, str | os.PathLike):
        raise LumitreeError(
            f"luminaires is {shown(repr(luminaires), 100)}; expected a list of them"
        )
    named = _named([as_source(each) for each in luminaires], root)
    if task is not None:
        number, count = _part(task)
        named = dict(list(named.items())[number - 1 :: count])
    settings: dict[str, Any] = {"quality": quality, "method": method, "parts": parts, "seed": seed}
    settings |= {"time": time, "rays": rays, "lumens": lumens, "temperature": temperature}
    config = chosen_config(config, **settings)
    if config.method == "network":
        raise LumitreeError("method network: for one luminaire at a time; bake each by itself")
    given = [name for name, value in settings.items() if value is not None]
    refuse_unused(given, config, list(named.values()))
    jobs = [_Job(root, name, each, config, variant) for name, each in named.items()]
    lamps = [BakedLamp(name, each.name, "waiting") for name, each in named.items()]
    stopped_by: int | None = None
    try:
        with (
            watch.stage("bake"),
            interruptible(),
            reporting(progress),
            progress_of(f"bake {len(jobs)} lamps", len(jobs)) as advance,
            _outcomes(jobs, executor, progress) as outcomes,
        ):
            for position, (lamp, stopped_by) in outcomes:
                path = None if lamp.path is None else root / lamp.path.name
                source = lamps[position].source
                lamps[position] = dataclasses.replace(lamp, source=source, path=path)
                if stopped_by is not None:
                    break
                advance(1)
    except KeyboardInterrupt as error:
        interrupted = interruption_behind(error)
        stopped_by = None if interrupted is None else interrupted.number
    if task is None:
        with deferred_interrupt() as interruption:
            _write_index(root, lamps)
        stopped_by = stopped_by or interruption.number
    return BakeManyResult(
        folder=root, index=root / INDEX, lamps=lamps, stopped_by=stopped_by, **watch.costs()
    )


@in_turn
def collect(folder: FilePath) -> BakeManyResult:
    """Write the index page of a folder of lamps that `bake_many` has baked in parts.

    It bakes nothing. It may be called while parts are still baked.

    Args:
        folder: folder of the assets, as for `bake_many`.

    Returns:
        The lamps of the folder (`lamps`), and the path of the index page (`index`).

    Raises:
        LumitreeError: the folder has no assets, one cannot be read, or it holds an `index.html`
            that is not lumitree's.

    Example:
        >>> for number in (1, 2):
        ...     lumitree.bake_many(["bulbs", "star"], "lamps", task=(number, 2))
        >>> [lamp.name for lamp in lumitree.collect("lamps").lamps]
        ['bulbs', 'star']
    """
    root, watch = Path(folder), Stopwatch()
    check_index(root / INDEX)
    load_rgb()
    with watch.stage("collect"):
        lamps = _write_index(root, ())
    if not lamps:
        raise LumitreeError(
            f"{shown(root, 300)} has no assets; give the FOLDER of `lumitree bake LAMPS -o FOLDER/ "
            "--task K/N`"
        )
    return BakeManyResult(folder=root, index=root / INDEX, lamps=lamps, **watch.costs())


def _write_index(root: Path, lamps: Iterable[BakedLamp]) -> list[BakedLamp]:
    """Write the page of the lamps of a call and of the other assets of a folder; returns them."""
    found = {lamp.name: lamp for lamp in lamps}
    for path in root.glob("*.lumitree"):
        if path.stem not in found:
            found[path.stem] = BakedLamp(path.stem, "", "kept").with_asset(load(path), path)
    shown_lamps = sorted(found.values(), key=lambda lamp: (lamp.name.casefold(), lamp.name))
    if shown_lamps:
        write_index(root, shown_lamps)
    return shown_lamps


@dataclasses.dataclass(frozen=True)
class _Job:
    """The bake of one lamp of a list."""

    folder: Path
    name: str
    source: LuminaireSource
    config: BakeConfig
    variant: str | None

    def elsewhere(self) -> "_Job":
        """The same for a process that may have another working folder."""
        return dataclasses.replace(
            self,
            folder=self.folder.absolute(),
            source=absolute_source(self.source),
            variant=self.variant or variant_here(),
        )


@contextlib.contextmanager
def _outcomes(
    jobs: Sequence[_Job], executor: Executor | None, progress: ProgressCallback | None
) -> Iterator[Iterator[tuple[int, tuple[BakedLamp, int | None]]]]:
    """Context with the positions of lamps and their outcomes, as they finish."""
    if executor is None:
        yield ((position, _bake_lamp(job, progress)) for position, job in enumerate(jobs))
        return
    arguments = ((job.elsewhere(),) for job in jobs)
    with run_tasks(executor, _bake_lamp, arguments, what="lamps", total=len(jobs)) as outcomes:
        yield outcomes


def _bake_lamp(job: _Job, progress: ProgressCallback | None = None) -> tuple[BakedLamp, int | None]:
    """Bake a lamp, or keep it; returns it and the signal that interrupted it, if any.

    Raises:
        LumitreeError: no lamp can be baked here: Mitsuba or its variant cannot be used.
        WriteError: the disk is full.
    """
    load_rgb(job.variant)
    lamp = BakedLamp(job.name, job.source.name, "waiting")
    try:
        with interruptible():
            return _kept_or_baked(job, lamp, progress)
    except (Exception, KeyboardInterrupt) as error:
        if (interrupted := interruption_behind(error)) is not None:
            return dataclasses.replace(lamp, state="interrupted"), interrupted.number
        if _disk_is_full(error):
            raise
        reason = " ".join(str(error).split()) or "no details"
        if not isinstance(error, LumitreeError):
            reason = f"unexpected {type(error).__name__}: {reason}"
        return dataclasses.replace(lamp, state="failed", error=shown(reason, 1000)), None


def _kept_or_baked(
    job: _Job, lamp: BakedLamp, progress: ProgressCallback | None
) -> tuple[BakedLamp, int | None]:
    # Not `with_suffix`: a name may contain dots.
    path = job.folder / f"{job.name}.lumitree"
    config = job.config
    if ONLY_PARTS.get(source_kind(job.source)) in (config.parts or ()):
        config = dataclasses.replace(config, parts=None)
    fingerprint, luminaire = _loaded(job.source, config)
    try:
        if path.exists() and fingerprint_of(path) == fingerprint:
            return dataclasses.replace(lamp, state="kept").with_asset(load(path), path), None
    except LumitreeError:
        # It is damaged, or of another version.
        pass
    bake_lamp = functools.partial(
        bake, luminaire, path, config, variant=job.variant, progress=progress
    )
    try:
        result = bake_lamp()
    except OtherJobError:
        # The lamp or its settings have changed since its bake was interrupted.
        with WorkFolder(work_folder_of(path)) as work:
            work.remove(CHECKPOINTS)
        result = bake_lamp()
    # Otherwise a signal would make the next call repeat a bake that is complete.
    with deferred_interrupt() as interruption:
        write_thumbnail(job.folder, job.name, result.asset)
        if result.finished:
            save(result.asset, path, fingerprint=fingerprint)
        lamp = dataclasses.replace(
            lamp,
            state="baked" if result.finished else "interrupted",
            seconds=sum(result.seconds.values()),
            irradiance_rms=(result.irradiance or {}).get("irradiance_rms"),
        ).with_asset(result.asset, path)
    return lamp, interruption.number if result.stopped_by is None else result.stopped_by


def _loaded(source: LuminaireSource, config: BakeConfig) -> tuple[str, Any]:
    """The fingerprint of a lamp and its settings; and the lamp, loaded if it is a luminaire."""
    digest = hashlib.sha256(json.dumps(dataclasses.asdict(config), sort_keys=True).encode())
    if source_kind(source) == "photometric":
        path, variant = gldf_variant(source.name)
        # A table of tilts may be in a file beside it.
        with noted_files() as beside:
            read_again(path)
        digest.update(str(variant).encode())
        for file in [Path(path), *sorted(each for each in beside if each.is_file())]:
            digest.update(file.read_bytes())
        return digest.hexdigest(), source
    if (dataset := dataset_folder(source)) is not None:
        digest.update((dataset / MANIFEST).read_bytes())
        return digest.hexdigest(), source
    from lumitree.lamp.luminaire import load_luminaire

    luminaire = load_luminaire(source)
    digest.update(luminaire.fingerprint.encode())
    return digest.hexdigest(), luminaire


def _disk_is_full(error: BaseException | None) -> bool:
    while error is not None and not isinstance(error, WriteError):
        error = error.__cause__
    return error is not None and error.full


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
        name = source.title or (
            source.name if source.name in BUILTIN else Path(gldf_variant(source.name)[0]).stem
        )
        if (other := taken.get(name.casefold())) is not None:
            raise LumitreeError(
                f"{shown(other, 200)} and {shown(source.name, 200)} would both be written to "
                f"{shown(folder / name, 200)}.lumitree; give one another name, as NAME=FILE, or "
                "choose another folder for it"
            )
        taken[name.casefold()] = source.name
        check_asset_output(folder / f"{name}.lumitree")
        named[name] = source
    return named


def _part(task: object) -> tuple[int, int]:
    if isinstance(task, str) or not isinstance(task, Sequence) or len(task) != 2:
        raise LumitreeError(f"task is {shown(repr(task), 60)}; expected (number, count)")
    number, count = task
    check_count("number of parts", count, 1, MAX_PARTS)
    check_count("part", number, 1, count)
    return number, count
