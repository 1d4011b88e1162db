"""From a luminaire to an asset: `bake`, `refine`, and the steps of the paper's own way."""

import contextlib
import dataclasses
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from lumitree.api.luminaires import dataset_folder, warn_of_faults
from lumitree.api.measures import Stopwatch, peak_memory_bytes
from lumitree.api.results import BakeResult, CaptureResult, TrainResult
from lumitree.asset.asset import Asset
from lumitree.asset.file import load, save
from lumitree.core.arguments import (
    MAX_RAYS,
    MAX_SAMPLES,
    MAX_SECONDS,
    check_asset_output,
    check_choice,
    check_image_settings,
    check_range,
)
from lumitree.core.backend import load_mitsuba
from lumitree.core.dataset import DATASET_FILES, MANIFEST, MAX_VIEWS, Dataset, Split
from lumitree.core.files import check_writable
from lumitree.core.harmonics import MAX_L
from lumitree.core.interrupt import Interrupted
from lumitree.core.progress import ProgressCallback, reporting, show_progress
from lumitree.core.seeds import check_seed
from lumitree.core.transmittance import LAWS, Law
from lumitree.core.work_folder import WorkFolder, scratch_folder
from lumitree.errors import explained
from lumitree.nerf.config import PRESETS, TrainConfig
from lumitree.octree.build import MAX_TREE_DEPTH

if TYPE_CHECKING:
    from lumitree.direct.bake import DirectConfig, DirectResult
    from lumitree.luminaire.luminaire import LuminaireLike

Quality = Literal["preview", "standard", "high"]
Preset = Literal["preview", "paper"]
FilePath = str | os.PathLike[str]


@dataclasses.dataclass(frozen=True)
class NetworkBake:
    """What a bake by the network does: views captured, network trained, octree extracted."""

    num_views: int
    resolution: int
    samples_per_pixel: int
    tree_depth: int
    train: TrainConfig
    samples_per_leaf: int = 256


NETWORK_BAKES: dict[str, NetworkBake] = {
    "preview": NetworkBake(60, 192, 48, 7, PRESETS["preview"], samples_per_leaf=64),
    # The paper does not state its samples a pixel.
    "paper": NetworkBake(100, 800, 256, 10, PRESETS["paper"]),
}


@explained
def bake(
    luminaire: "LuminaireLike",
    output: FilePath | None = None,
    *,
    quality: Quality = "standard",
    time: float | None = None,
    rays: int | None = None,
    tree_depth: int | None = None,
    l_max: int | None = None,
    law: Law | None = None,
    seed: int = 0,
    work: FilePath | None = None,
    variant: str | None = None,
    progress: ProgressCallback | None = show_progress,
) -> BakeResult:
    """Bake a luminaire into an asset, from traced rays.

    The state is kept in a work folder. A bake that is stopped by Ctrl-C, SIGTERM or SIGHUP returns
    the best asset so far (`BakeResult.stopped_by` is set then); the same call continues it.

    Args:
        luminaire: name of a built-in luminaire, path of a Mitsuba 3 scene or a model, dictionary as
            for `mitsuba.load_dict`, `mi.Scene`, what `load_luminaire` returned, or folder of a
            dataset that `capture` made.
        output: the `.lumitree` file to write; None for none.
        quality: tree depth and budget: "preview" (depth 7, 1 minute on 2 CPU cores), "standard"
            (depth 8, 5 minutes) or "high" (depth 10, 30 minutes).
        time: budget in seconds, instead of the quality's. A first estimate of about 20 seconds is
            always made.
        rays: budget of rays of the descent; without `time` there is no limit of time.
        tree_depth: level of the smallest leaves, 1 to 10, instead of the quality's.
        l_max: highest spherical-harmonics band, 0 to 4 (default: 2).
        law: transmittance law (default: "exponential").
        seed: of all random numbers, 0 to 2³¹ - 1.
        work: folder for the state, which is kept; by default a folder beside `output`, which is
            removed at the end.
        variant: Mitsuba variant; by default the one that is set, else `cuda_ad_rgb` where there is
            a GPU, else `llvm_ad_rgb`.
        progress: called with every `Progress`; by default a bar or lines on standard error; None
            for silence.

    Raises:
        LumitreeError: bad arguments, an unreadable or dark luminaire, or a full disk.
    """
    _check_bake(output, time, rays, seed)
    if tree_depth is not None:
        check_range("tree depth", tree_depth, 1, MAX_TREE_DEPTH)
    if l_max is not None:
        check_range("l_max", l_max, 0, MAX_L)
    if law is not None:
        check_choice("law", law, LAWS)
    check_choice("quality", quality, get_args(Quality))
    load_mitsuba(variant)
    from lumitree.direct import bake as direct
    from lumitree.luminaire.luminaire import load_luminaire

    preset = direct.QUALITIES[quality]
    config = dataclasses.replace(
        _budgeted(preset, time, rays),
        tree_depth=preset.tree_depth if tree_depth is None else tree_depth,
        l_max=preset.l_max if l_max is None else l_max,
        law=preset.law if law is None else law,
        seed=seed,
    )
    with reporting(progress), _work_folder(output, work) as at:
        if (folder := dataset_folder(luminaire)) is not None:
            dataset = Dataset.open(folder)
            return _finish(output, work, at, lambda: direct.bake_stored(dataset, config, at.path))
        lamp = load_luminaire(luminaire)
        warn_of_faults(lamp)
        return _finish(output, work, at, lambda: direct.bake(lamp, config, at.path))


@explained
def refine(
    asset: Asset | FilePath,
    luminaire: "LuminaireLike",
    output: FilePath | None = None,
    *,
    time: float | None = None,
    rays: int | None = None,
    seed: int = 0,
    work: FilePath | None = None,
    variant: str | None = None,
    progress: ProgressCallback | None = show_progress,
) -> BakeResult:
    """Improve an asset, however it was baked, with rays traced through its luminaire.

    Args:
        asset: an asset or its file; its depth, l_max and law stay.
        luminaire: what it was baked from; otherwise arguments are as for `bake`.

    Raises:
        LumitreeError: as for `bake`, or the asset is of another luminaire.
    """
    _check_bake(output, time, rays, seed)
    load_mitsuba(variant)
    from lumitree.direct import bake as direct
    from lumitree.luminaire.luminaire import load_luminaire

    config = dataclasses.replace(_budgeted(direct.QUALITIES["standard"], time, rays), seed=seed)
    rough = asset if isinstance(asset, Asset) else load(asset)
    with reporting(progress), _work_folder(output, work) as at:
        lamp = load_luminaire(luminaire)
        return _finish(output, work, at, lambda: direct.refine(rough, lamp, config, at.path))


@explained
def bake_network(
    luminaire: "LuminaireLike",
    output: FilePath,
    *,
    preset: Preset = "preview",
    tree_depth: int | None = None,
    work: FilePath | None = None,
    variant: str | None = None,
    progress: ProgressCallback | None = show_progress,
) -> BakeResult:
    """Bake a luminaire as the paper does: `capture`, `train` and `extract` in one call.

    An interrupted bake continues when it is called again.

    Args:
        luminaire: as for `bake`.
        output: the `.lumitree` file to write.
        preset: views, network and octree: "preview" (minutes on 2 CPU cores) or "paper" (days on a
            GPU).
        tree_depth: level of the leaves, 1 to 10, instead of the preset's.
        work, variant, progress: as for `bake`.

    Raises:
        LumitreeError: as for `bake`.
        Interrupted: by a stop signal; what was finished is kept.
    """
    check_asset_output(output)
    check_choice("preset", preset, NETWORK_BAKES)
    settings = NETWORK_BAKES[preset]
    tree_depth = settings.tree_depth if tree_depth is None else tree_depth
    check_range("tree depth", tree_depth, 1, MAX_TREE_DEPTH)
    with _work_folder(output, work) as folder:
        captured = capture(
            luminaire,
            folder.path / "dataset",
            num_views=settings.num_views,
            resolution=settings.resolution,
            samples_per_pixel=settings.samples_per_pixel,
            variant=variant,
            progress=progress,
        )
        from lumitree.nerf.run import RUN_FILES

        run = folder.path / "run"
        trained = train(
            captured.dataset, run, preset=preset, resume=run.exists(), progress=progress
        )
        if trained.stopped_by is not None:
            raise Interrupted("the same command continues", trained.stopped_by)
        extracted = extract(
            run,
            output,
            tree_depth=tree_depth,
            samples_per_leaf=settings.samples_per_leaf,
            progress=progress,
        )
        if work is None:
            names = [f"dataset/{name}" for name in DATASET_FILES]
            folder.remove([*names, *(f"run/{name}" for name in RUN_FILES)])
    seconds = captured.seconds | trained.seconds | extracted.seconds
    return dataclasses.replace(extracted, seconds=seconds, peak_memory_bytes=peak_memory_bytes())


@explained
def capture(
    luminaire: "LuminaireLike",
    output: FilePath,
    *,
    num_views: int = 100,
    resolution: int = 256,
    samples_per_pixel: int = 128,
    split: Split = "train",
    variant: str | None = None,
    progress: ProgressCallback | None = show_progress,
) -> CaptureResult:
    """Render views of a luminaire: radiance and two kinds of opacity, as OpenEXR.

    The views that are missing in the folder are rendered, so the same call continues a capture.

    Args:
        luminaire: as for `bake`.
        output: folder of the dataset.
        num_views: orthographic, along Halton directions on the sphere.
        resolution: pixels a side.
        samples_per_pixel: paths.
        split: "train" or "test": two sequences of directions that never meet.
        variant, progress: as for `bake`.

    Raises:
        LumitreeError: bad arguments, an unreadable luminaire, or a folder of another capture.
    """
    check_range("views", num_views, 1, MAX_VIEWS)
    check_image_settings(resolution=resolution, spp=samples_per_pixel)
    check_choice("split", split, get_args(Split))
    check_writable(Path(output) / MANIFEST)
    load_mitsuba(variant)
    from lumitree.luminaire.luminaire import load_luminaire
    from lumitree.views.capture import capture as capture_views

    watch = Stopwatch()
    with reporting(progress), watch.stage("capture"):
        lamp = load_luminaire(luminaire)
        warn_of_faults(lamp)
        dataset = capture_views(
            lamp,
            output,
            num_views=num_views,
            resolution=resolution,
            samples_per_pixel=samples_per_pixel,
            split=split,
        )
    return CaptureResult(
        dataset=Path(output),
        luminaire=dataset.manifest.luminaire,
        views=len(dataset.manifest.frames),
        **watch.costs(),
    )


@explained
def train(
    dataset: FilePath,
    output: FilePath,
    *,
    preset: Preset = "preview",
    resume: bool = False,
    progress: ProgressCallback | None = show_progress,
) -> TrainResult:
    """Train the paper's network on a dataset.

    Args:
        dataset: folder that `capture` made.
        output: folder of the run: checkpoints and history.
        preset: "preview" (minutes on 2 CPU cores) or "paper" (days on a GPU).
        resume: continue from the newest checkpoint, bit for bit.
        progress: as for `bake`.

    Raises:
        LumitreeError: bad arguments, an unreadable dataset, or a folder that holds something else.
    """
    check_choice("preset", preset, PRESETS)
    check_writable(Path(output) / MANIFEST)
    from lumitree.nerf.train import train as train_network

    watch = Stopwatch()
    with reporting(progress), watch.stage("train"):
        result = train_network(dataset, output, PRESETS[preset], resume=resume)
    return TrainResult(
        run=Path(output),
        steps=result.steps,
        psnr=result.psnr,
        psnr_black=result.psnr_black,
        rays_per_second=result.rays_per_second,
        stopped_by=result.stopped_by,
        **watch.costs(),
    )


@explained
def extract(
    run: FilePath,
    output: FilePath | None = None,
    *,
    tree_depth: int = 8,
    samples_per_leaf: int = 256,
    progress: ProgressCallback | None = show_progress,
) -> BakeResult:
    """Distil a trained network into an octree.

    Args:
        run: folder that `train` made.
        output: the `.lumitree` file to write; None for none.
        tree_depth: level of the leaves, 1 to 10.
        samples_per_leaf: positions whose mean a leaf holds.
        progress: as for `bake`.

    Raises:
        LumitreeError: bad arguments, an unreadable run, or an empty field.
    """
    if output is not None:
        check_asset_output(output)
    check_range("tree depth", tree_depth, 1, MAX_TREE_DEPTH)
    check_range("samples a leaf", samples_per_leaf, 1, MAX_SAMPLES)
    from lumitree.nerf.trained_field import load_field
    from lumitree.octree.extract import extract as extract_octree

    watch = Stopwatch()
    with reporting(progress), watch.stage("extract"):
        field = load_field(run)
        half_extents = np.asarray(field.half_extents, np.float64)
        children, density, coefficients = extract_octree(
            field.query, half_extents, tree_depth, samples_per_leaf=samples_per_leaf
        )
        asset = Asset(
            children=children,
            density=density,
            coefficients=coefficients,
            tree_depth=tree_depth,
            l_max=field.l_max,
            law=field.law,
            max_radiance=field.max_radiance,
            half_extents=half_extents,
            world_from_proxy=np.asarray(field.world_from_proxy, np.float64),
            luminaire=field.luminaire,
        )
        _save(asset, output)
    return BakeResult(asset=asset, path=_path(output), **watch.costs())


def _check_bake(output: FilePath | None, time: float | None, rays: int | None, seed: int) -> None:
    if output is not None:
        check_asset_output(output)
    if time is not None:
        check_range("time", time, 1e-3, MAX_SECONDS, "seconds")
    if rays is not None:
        check_range("rays", rays, 1, MAX_RAYS)
    check_seed(seed)


def _budgeted(config: "DirectConfig", time: float | None, rays: int | None) -> "DirectConfig":
    if time is None and rays is None:
        return config
    return dataclasses.replace(config, seconds=time, rays=rays)


@contextlib.contextmanager
def _work_folder(output: FilePath | None, work: FilePath | None) -> Iterator[WorkFolder]:
    """The folder of a bake's state: `work`, one beside the asset, or a temporary one."""
    with contextlib.ExitStack() as stack:
        if work is None and output is None:
            work = stack.enter_context(scratch_folder()) / "work"
        elif work is None:
            work = Path(str(output)).with_suffix(".work")
        yield stack.enter_context(WorkFolder(str(work)))


def _finish(
    output: FilePath | None,
    work: FilePath | None,
    folder: WorkFolder,
    job: "Callable[[], DirectResult]",
) -> BakeResult:
    """Run a direct bake, write its asset and, where `work` does not name it, clear its state."""
    from lumitree.direct.bake import STATE

    watch = Stopwatch()
    with watch.stage("bake"):
        result = job()
        _save(result.asset, output)
    if work is None and result.stopped_by is None:
        folder.remove([STATE])
    return BakeResult(
        asset=result.asset,
        path=_path(output),
        held_out_psnr=round(result.score.psnr, 3),
        held_out_psnr_uncertainty=round(result.score.uncertainty, 3),
        rays=result.rays,
        stopped_by=result.stopped_by,
        **watch.costs(),
    )


def _save(asset: Asset, output: FilePath | None) -> None:
    if output is not None:
        save(asset, output)


def _path(output: FilePath | None) -> Path | None:
    return None if output is None else Path(output)
