"""The method of the paper: `capture`, `train` and `extract`, and `bake` by these three."""

import dataclasses
import warnings
from concurrent.futures import Executor
from pathlib import Path
from typing import TYPE_CHECKING, Literal, get_args

from lumitree.asset.asset import Asset
from lumitree.core.arguments import (
    MAX_SAMPLES,
    check_asset_output,
    check_choice,
    check_count,
    check_image_settings,
)
from lumitree.core.backend import check_network, in_turn, load_rgb
from lumitree.core.executor import check_executor
from lumitree.core.files import (
    FilePath,
    WorkFolder,
    WriteError,
    check_writable,
    scratch_folder,
)
from lumitree.core.interruption import STATE_IS_KEPT, Interrupted
from lumitree.core.progress import ProgressCallback, reporting, show_progress
from lumitree.core.results import Result, Stopwatch, peak_memory_bytes
from lumitree.core.seeds import check_seed
from lumitree.errors import LumitreeError, LumitreeWarning, shown
from lumitree.fit.config import BakeConfig
from lumitree.fit.finishing import BakeResult, finish_bake, remove_state
from lumitree.fit.network.config import TrainConfig
from lumitree.lamp.dataset import MANIFEST, MAX_VIEWS, Split
from lumitree.lamp.diagnosis import warn_of_faults
from lumitree.octree.build import check_tree_depth

if TYPE_CHECKING:
    from lumitree.asset.light_field import LightField
    from lumitree.lamp.luminaire import LampWorkers, Luminaire, LuminaireLike


@dataclasses.dataclass(frozen=True, repr=False, kw_only=True)
class CaptureResult(Result):
    """Result of a capture.

    Attributes:
        dataset: folder of the dataset.
        luminaire: name of the luminaire.
        views: number of views in the dataset.
    """

    dataset: Path
    luminaire: str
    views: int


@dataclasses.dataclass(frozen=True, repr=False, kw_only=True)
class TrainResult(Result):
    """Result of the training of a network.

    Attributes:
        run: folder of the checkpoints.
        steps: number of steps, including steps of earlier calls.
        psnr: PSNR on held-out rays, dB.
        psnr_black: PSNR of an all-black prediction of the same rays, dB.
        rays_per_second: training speed of this call.
        stopped_by: number of the signal that interrupted the training; None if there was none.
        finished: whether the training is finished. A signal may have arrived afterwards.
    """

    run: Path
    steps: int
    psnr: float
    psnr_black: float
    rays_per_second: float
    stopped_by: int | None = None
    finished: bool = dataclasses.field(default=True, repr=False)

    @property
    def continues(self) -> str:
        """Command or call that continues it, for messages."""
        return "the same command with --resume continues"


def bake_network(
    lamp: "Luminaire",
    output: FilePath | None,
    config: BakeConfig,
    folder: WorkFolder,
    work: FilePath | None,
    workers: "LampWorkers | None",
) -> BakeResult:
    """`bake` by the method "network"; continues an interrupted bake whose state is in `folder`.

    Raises:
        Interrupted: a signal was received before the asset was complete.
    """
    from lumitree.fit.light_field.bake import bake_light_field
    from lumitree.fit.network.train import RUN
    from lumitree.trace.cameras import capture as capture_views

    watch, light_field, network = Stopwatch(), None, config.network
    if config.parts is None or "light" in config.parts:
        with watch.stage("light"):
            light_field = bake_light_field(lamp, config.light, folder.path, workers, config.seed)
    dataset, run = folder.path / "dataset", folder.path / "run"
    with watch.stage("capture"):
        capture_views(
            lamp,
            dataset,
            views=network.views,
            resolution=network.resolution,
            spp=network.spp,
            workers=workers,
        )
    trained = _train(dataset, run, network.train, config.seed, (run / RUN).exists())
    if trained.stopped_by is not None:
        raise Interrupted("the same command continues", trained.stopped_by)
    leaves = network.tree_depth, network.samples_per_leaf
    extracted = _extract(run, output, *leaves, light_field, lamp, config)
    remove_state(folder, work, extracted)
    seconds = watch.seconds | trained.seconds | extracted.seconds
    return dataclasses.replace(extracted, seconds=seconds, peak_memory_bytes=peak_memory_bytes())


@in_turn
def capture(
    luminaire: "LuminaireLike",
    output: FilePath,
    *,
    views: int = 100,
    resolution: int = 256,
    spp: int = 128,
    split: Split = "train",
    variant: str | None = None,
    executor: Executor | None = None,
    progress: ProgressCallback | None = show_progress,
) -> CaptureResult:
    """Render views of a luminaire into a dataset: radiance and two kinds of opacity, as OpenEXR.

    The views are orthographic. Their directions are a Halton sequence on the sphere. Only views
    that are missing in the folder are rendered, so the same call continues an interrupted capture.

    Args:
        luminaire: what to render, in any form that `bake` takes.
        output: folder of the dataset: new, empty, or of the same capture.
        views: number of views, 1 to 100,000.
        resolution: pixels per side of a view, 1 to 16,384.
        spp: paths per pixel, 1 to 1,048,576.
        split: "train" or "test". The two have no direction in common.
        variant: Mitsuba variant; see `bake`.
        executor: whose workers render the views; each loads the luminaire. The views are
            equal to the views of one process. Default: this process, which also writes them.
        progress: function that is called with a `Progress` after each view; see `bake`.

    Returns:
        The folder (`dataset`), the name of the luminaire, and the number of views.

    Raises:
        LumitreeError: an argument is out of range; the luminaire cannot be read; the folder
            holds another capture; or as for the `executor` of `bake`.
        Interrupted: SIGINT, SIGTERM or SIGHUP was received. Finished views are kept.
    """
    check_count("views", views, 1, MAX_VIEWS)
    check_image_settings(resolution=resolution, spp=spp)
    check_choice("split", split, get_args(Split))
    check_writable(Path(output) / MANIFEST)
    check_executor(executor)
    load_rgb(variant)
    from lumitree.lamp.luminaire import lamp_workers, load_luminaire
    from lumitree.trace.cameras import capture as capture_views

    watch = Stopwatch()
    with reporting(progress), watch.stage("capture"):
        lamp = load_luminaire(luminaire)
        workers = lamp_workers(executor, luminaire, lamp)
        warn_of_faults(lamp)
        try:
            dataset = capture_views(
                lamp,
                output,
                views=views,
                resolution=resolution,
                spp=spp,
                split=split,
                workers=workers,
            )
        except (WriteError, KeyboardInterrupt) as error:
            if not (Path(output) / MANIFEST).exists():
                raise
            STATE_IS_KEPT.set()
            if isinstance(error, KeyboardInterrupt):
                raise
            raise LumitreeError(f"{error}; the same command continues the capture") from error
    return CaptureResult(
        dataset=Path(output),
        luminaire=dataset.manifest.luminaire,
        views=len(dataset.manifest.frames),
        **watch.costs(),
    )


@in_turn
def train(
    dataset: FilePath,
    output: FilePath,
    *,
    quality: Literal["preview", "paper"] = "preview",
    seed: int = 0,
    resume: bool = False,
    progress: ProgressCallback | None = show_progress,
) -> TrainResult:
    """Train the network of the paper (NeRF-SH) on a dataset.

    Args:
        dataset: folder of the dataset, made by `capture`.
        output: folder of the run.
        quality: settings of the network: "preview", minutes on 2 CPU cores; or "paper", days on a
            GPU.
        seed: seed of the initial weights, the batches and the jitter, 0 to 2³¹ - 1. With `resume`
            it must be the seed of the run.
        resume: continue from the newest checkpoint in `output`. The result equals, bit for bit,
            the result of a run without interruption.
        progress: function that is called with a `Progress` after each step; see `bake`.

    Returns:
        The folder (`run`), the number of steps, and the PSNR on held-out rays in dB of the network
        (`psnr`) and of an all-black prediction (`psnr_black`). `stopped_by` is the number of the
        signal that interrupted the training, or None.

    Raises:
        LumitreeError: an argument is out of range; the dataset cannot be read; `output` holds
            another run; there is nothing to resume; or the extra `network` of lumitree is not
            installed.
    """
    config = BakeConfig.of(quality, "network").network.train
    check_seed(seed)
    check_writable(Path(output) / MANIFEST)
    check_network()
    with reporting(progress):
        return _train(dataset, output, config, seed, resume)


def _train(
    dataset: FilePath,
    output: FilePath,
    config: TrainConfig,
    seed: int,
    resume: bool,
) -> TrainResult:
    """As `train`, with settings of any kind."""
    from lumitree.fit.network.train import train as train_network

    watch = Stopwatch()
    with watch.stage("train"):
        result = train_network(dataset, output, config, seed, resume=resume)
    return TrainResult(
        run=Path(output),
        steps=result.steps,
        psnr=result.psnr,
        psnr_black=result.psnr_black,
        rays_per_second=result.rays_per_second,
        stopped_by=result.stopped_by,
        finished=result.steps == config.num_steps,
        **watch.costs(),
    )


@in_turn
def extract(
    run: FilePath,
    output: FilePath | None = None,
    *,
    tree_depth: int | None = None,
    samples_per_leaf: int | None = None,
    luminaire: "LuminaireLike | None" = None,
    irradiance_paths: int | None = None,
    seed: int = 0,
    variant: str | None = None,
    progress: ProgressCallback | None = show_progress,
) -> BakeResult:
    """Convert a trained network into an asset.

    Each leaf of the octree stores the mean of the network's output at positions inside it. The
    light field needs the luminaire, which the run does not contain.

    Args:
        run: folder of the run, made by `train`.
        output: path of the `.lumitree` file to write. Default: no file is written.
        tree_depth: level of the leaves, 1 to 10. Their side is the longest side of the bounding box
            divided by 2^tree_depth. Default: 7, or 10 for a run of the quality "paper".
        samples_per_leaf: positions per leaf, 1 to 1,048,576. Default: 64, or 256 for "paper".
        luminaire: the captured luminaire, in any form that `bake` takes. If it is given, the asset
            gets the light field too, and the irradiance around both is compared.
        irradiance_paths: see `bake`. Default: 2¹⁸.
        seed: root seed of the light field, 0 to 2³¹ - 1.
        variant: Mitsuba variant; see `bake`.
        progress: function that is called with a `Progress` after each step; see `bake`.

    Returns:
        The asset (`asset`), its file (`path`), and with a luminaire the error of the irradiance
        around it (`irradiance`).

    Raises:
        LumitreeError: an argument is out of range; the run cannot be read; the field is empty; the
            luminaire cannot be read, or its bounding box differs from the box of the views; or the
            extra `network` of lumitree is not installed.
    """
    if output is not None:
        check_asset_output(output)
    if tree_depth is not None:
        check_tree_depth(tree_depth)
    if samples_per_leaf is not None:
        check_count("samples a leaf", samples_per_leaf, 1, MAX_SAMPLES)
    config = dataclasses.replace(BakeConfig.of(), seed=seed)
    if irradiance_paths is not None:
        config = dataclasses.replace(config, irradiance_paths=irradiance_paths)
    check_network()
    if luminaire is None:
        with reporting(progress):
            return _extract(run, output, tree_depth, samples_per_leaf, None, None, config)
    load_rgb(variant)
    from lumitree.fit.light_field.bake import bake_light_field
    from lumitree.fit.network.trained_field import load_field
    from lumitree.lamp.luminaire import load_luminaire

    watch = Stopwatch()
    with reporting(progress), scratch_folder() as folder:
        lamp = load_luminaire(luminaire)
        if (frame := load_field(run).frame) != lamp.frame:
            sides, of_views = (
                " x ".join(f"{side:.4g}" for side in each.size) for each in (lamp.frame, frame)
            )
            raise LumitreeError(
                f"{lamp.name} has a bounding box of {sides} and the views of {run} one of "
                f"{of_views}, or another place; give the luminaire that was captured"
            )
        with watch.stage("light"):
            light_field = bake_light_field(lamp, config.light, folder, seed=seed)
        result = _extract(run, output, tree_depth, samples_per_leaf, light_field, lamp, config)
    return dataclasses.replace(result, seconds=watch.seconds | result.seconds)


def _extract(
    run: FilePath,
    output: FilePath | None,
    tree_depth: int | None,
    samples_per_leaf: int | None,
    light_field: "LightField | None",
    lamp: "Luminaire | None",
    config: BakeConfig,
) -> BakeResult:
    """As `extract`, with a light field; compares the irradiance with a lamp's."""
    from lumitree.fit.network.trained_field import load_field
    from lumitree.octree.extract import extract as extract_octree
    from lumitree.rendering.asset_flux import with_light

    watch = Stopwatch()
    with watch.stage("extract"):
        field = load_field(run)
        paper = field.config == TrainConfig()
        preset = BakeConfig.of("paper" if paper else "preview", "network").network
        tree_depth = preset.tree_depth if tree_depth is None else tree_depth
        samples_per_leaf = samples_per_leaf or preset.samples_per_leaf
        if field.num_steps < field.config.num_steps:
            warnings.warn(
                f"the training in {shown(run, 300)} is at step {field.num_steps:,} of "
                f"{field.config.num_steps:,}; `lumitree train --resume` finishes it",
                LumitreeWarning,
                stacklevel=3,
            )
        if field.config.emission_weights != "decrease":
            raise LumitreeError(
                f"{run} was trained with {field.config.emission_weights} emission weights, which "
                "no asset has; expected decrease"
            )
        children, density, coefficients = extract_octree(
            field.query, field.frame.half_extents, tree_depth, samples_per_leaf=samples_per_leaf
        )
        asset = Asset(
            children=children,
            density=density,
            coefficients=coefficients,
            tree_depth=tree_depth,
            l_max=field.config.l_max,
            law=field.config.law,
            max_radiance=field.max_radiance,
            frame=field.frame,
            luminaire=field.luminaire,
            light_field=light_field,
        )
    asset = with_light(asset, config.lumens, config.temperature)
    return finish_bake(asset, output, watch, lamp, config.irradiance_paths)
