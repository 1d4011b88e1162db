"""The jobs behind the commands: each takes file names, does one job, and returns a report.

A report is a dictionary that JSON can hold. Packages that are slow to import are imported by
the job that needs them.
"""

import contextlib
import dataclasses
import math
import resource
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from lumitree.core.arguments import (
    MAX_RAYS,
    MAX_SAMPLES,
    MAX_SECONDS,
    check_asset_output,
    check_choice,
    check_image_settings,
    check_range,
    check_sheet_output,
)
from lumitree.core.backend import load_mitsuba
from lumitree.core.dataset import DATASET_FILES, MANIFEST, MAX_VIEWS, Dataset, Split
from lumitree.core.files import check_writable
from lumitree.core.frames import check_placement
from lumitree.core.interrupt import Interrupted
from lumitree.core.seeds import check_seed
from lumitree.core.work_folder import WorkFolder, scratch_folder
from lumitree.errors import LumitreeError, LumitreeWarning, explained
from lumitree.nerf.config import PRESETS, TrainConfig
from lumitree.octree.build import MAX_TREE_DEPTH

if TYPE_CHECKING:
    from lumitree.asset.asset import Asset
    from lumitree.core.transmittance import Law
    from lumitree.direct.bake import DirectConfig, DirectResult
    from lumitree.luminaire.luminaire import Luminaire
    from lumitree.luminaire.source import LuminaireSource

Report = dict[str, Any]


@dataclasses.dataclass(frozen=True)
class BakePreset:
    """What `bake` does: the views it captures, the network it trains, the octree it extracts."""

    num_views: int
    resolution: int
    samples_per_pixel: int
    train: TrainConfig
    tree_depth: int
    samples_per_leaf: int = 256


BAKE_PRESETS = {
    "preview": BakePreset(60, 192, 48, PRESETS["preview"], tree_depth=7, samples_per_leaf=64),
    # The paper does not state its samples a pixel.
    "paper": BakePreset(100, 800, 256, PRESETS["paper"], tree_depth=10),
}
# Held-out views of `evaluate` when it is given a luminaire.
EVALUATION_VIEWS, EVALUATION_RESOLUTION, EVALUATION_SPP = 8, 256, 256


# Paths that a preview's flux, and its bounce statistics, are means of.
FLUX_PATHS, BOUNCE_PATHS = 1 << 22, 1 << 20
# A file whose glass is wrong throughout is not to fill the terminal.
MAX_FAULTS = 5


class Stopwatch:
    """Seconds of named stages, in the order they ran."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextlib.contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time the block; several blocks of one name add up."""
        start = time.perf_counter()
        try:
            yield
        finally:
            elapsed = time.perf_counter() - start
            self.seconds[name] = round(self.seconds.get(name, 0.0) + elapsed, 3)


def peak_memory_bytes() -> int:
    """Largest resident memory of this process so far."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024


@explained
def list_luminaires() -> Report:
    """Built-in luminaires: what they are, and their figures."""
    from lumitree.builtin.registry import BUILTIN
    from lumitree.model.figures import figures

    return {
        "luminaires": {
            name: {"description": item.description, **dataclasses.asdict(figures(item.build()))}
            for name, item in BUILTIN.items()
        }
    }


@explained
def preview(
    source: "str | LuminaireSource",
    sheet: str,
    *,
    resolution: int = 256,
    samples_per_pixel: int = 64,
    bounces: bool = False,
    variant: str | None = None,
) -> Report:
    """Look at a luminaire before it is baked: six views on a contact sheet, and its figures.

    Args:
        sheet: the PNG to write.
        resolution, samples_per_pixel: of each view.
        bounces: also measure what paths of 32, 64 and 128 bounces miss.
    """
    check_sheet_output(sheet)
    check_image_settings(resolution=resolution, spp=samples_per_pixel)
    load_mitsuba(variant)
    from lumitree.core.images import max_radiance
    from lumitree.evaluation.preview import take_preview, write_preview
    from lumitree.luminaire.luminaire import load_luminaire
    from lumitree.transport.flux import estimate_flux, missed_by_depth

    watch = Stopwatch()
    with watch.stage("load"):
        luminaire = load_luminaire(source)
    with watch.stage("diagnose"):
        faults = _diagnose(luminaire)
    with watch.stage("views"):
        views = take_preview(luminaire, resolution, samples_per_pixel)
    with watch.stage("flux"):
        flux = estimate_flux(luminaire, FLUX_PATHS)
    report = {
        "luminaire": luminaire.name,
        "triangles": luminaire.num_triangles,
        "emitters": luminaire.num_emitters,
        "max_radiance": max_radiance([views.radiance]),
        "size": luminaire.size.tolist(),
        "has_media": luminaire.has_media,
        "flux": {
            "watts": flux.watts.tolist(),
            "watts_error": flux.watts_error.tolist(),
            "lumens": flux.lumens,
            "lumens_error": flux.lumens_error,
            "paths": flux.num_paths,
        },
        "paths_per_second": views.paths_per_second,
        "exposure": views.exposure,
        "faults": faults,
        "sheet": sheet,
    }
    write_preview(sheet, views, luminaire.name, _facts(report))
    if bounces:
        with watch.stage("bounces"):
            missed = missed_by_depth(luminaire, BOUNCE_PATHS)
        report["bounces"] = [dataclasses.asdict(each) for each in missed]
    return report | {"seconds": watch.seconds, "peak_memory_bytes": peak_memory_bytes()}


def _facts(report: Report) -> list[str]:
    """The figures that stand on the sheet of a preview."""
    return [
        f"{report['triangles']:,} triangles",
        f"{report['emitters']} emitter" + ("" if report["emitters"] == 1 else "s"),
        f"L_max {report['max_radiance']:.4g}",
        f"flux {describe_lumens(report['flux'])}",
        "size " + " x ".join(f"{side:.4g}" for side in report["size"]),
        *(["media"] if report["has_media"] else []),
    ]


def describe_lumens(flux: Report) -> str:
    """Luminous flux with its standard error, both to the error's second digit."""
    digits = max(0, 1 - math.floor(math.log10(flux["lumens_error"]))) if flux["lumens_error"] else 0
    return f"{flux['lumens']:,.{digits}f} ± {flux['lumens_error']:,.{digits}f} lm"


def _diagnose(luminaire: "Luminaire") -> list[str]:
    """Warn of glass that cannot be rendered rightly; returns what was said."""
    from lumitree.luminaire.diagnosis import diagnose

    faults = diagnose(luminaire.scene)
    for fault in faults[:MAX_FAULTS]:
        warnings.warn(f"{luminaire.name}: {fault}", LumitreeWarning, stacklevel=3)
    if len(faults) > MAX_FAULTS:
        more = f"{luminaire.name}: {len(faults) - MAX_FAULTS} more faults of this kind"
        warnings.warn(more, LumitreeWarning, stacklevel=3)
    return faults


@explained
def capture(
    source: "str | LuminaireSource",
    output: str,
    *,
    num_views: int = 100,
    resolution: int = 256,
    samples_per_pixel: int = 128,
    split: Split = "train",
    variant: str | None = None,
) -> Report:
    """Capture a dataset; continues one that was interrupted."""
    check_range("views", num_views, 1, MAX_VIEWS)
    check_image_settings(resolution=resolution, spp=samples_per_pixel)
    check_choice("split", split, get_args(Split))
    check_writable(Path(output) / MANIFEST)
    load_mitsuba(variant)
    from lumitree.luminaire.luminaire import load_luminaire
    from lumitree.views.capture import capture as capture_views

    watch = Stopwatch()
    with watch.stage("capture"):
        luminaire = load_luminaire(source)
        _diagnose(luminaire)
        dataset = capture_views(
            luminaire,
            output,
            num_views=num_views,
            resolution=resolution,
            samples_per_pixel=samples_per_pixel,
            split=split,
        )
    return {
        "dataset": output,
        "luminaire": dataset.manifest.luminaire,
        "views": len(dataset.manifest.frames),
        "seconds": watch.seconds,
        "peak_memory_bytes": peak_memory_bytes(),
    }


@explained
def train(dataset: str, output: str, *, preset: str = "preview", resume: bool = False) -> Report:
    """Train the network on a dataset; `resume` continues a run bit for bit."""
    check_choice("preset", preset, PRESETS)
    check_writable(Path(output) / MANIFEST)
    from lumitree.nerf.train import train as train_network

    watch = Stopwatch()
    with watch.stage("train"):
        result = train_network(dataset, output, PRESETS[preset], resume=resume)
    return {
        "run": output,
        **dataclasses.asdict(result),
        "seconds": watch.seconds,
        "peak_memory_bytes": peak_memory_bytes(),
    }


@explained
def extract(run: str, output: str, *, tree_depth: int = 8, samples_per_leaf: int = 256) -> Report:
    """Distil a trained network into an asset."""
    check_asset_output(output)
    check_range("tree depth", tree_depth, 1, MAX_TREE_DEPTH)
    check_range("samples a leaf", samples_per_leaf, 1, MAX_SAMPLES)
    from lumitree.asset.asset import Asset
    from lumitree.asset.file import save
    from lumitree.nerf.trained_field import load_field
    from lumitree.octree.extract import extract as extract_octree

    watch = Stopwatch()
    with watch.stage("extract"):
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
            max_radiance=float(field.max_radiance),
            half_extents=half_extents,
            world_from_proxy=np.asarray(field.world_from_proxy, np.float64),
            luminaire=field.luminaire,
        )
        save(asset, output)
    return {
        "asset": describe_asset(asset, output),
        "seconds": watch.seconds,
        "peak_memory_bytes": peak_memory_bytes(),
    }


@explained
def bake(
    source: "str | LuminaireSource",
    output: str,
    *,
    quality: str = "standard",
    seconds: float | None = None,
    rays: int | None = None,
    tree_depth: int | None = None,
    l_max: int | None = None,
    law: "Law | None" = None,
    seed: int = 0,
    work: str | None = None,
    variant: str | None = None,
) -> Report:
    """Bake a luminaire from traced rays, with no pictures and no network; or a dataset's pictures.

    The state lives in `work` (default: a folder beside the asset, removed at the end); an
    interrupted bake leaves the best asset so far, and continues when it is started again.

    Args:
        source: a luminaire, or the folder of a dataset.
        quality: "preview", "standard" or "high": depth and budget.
        seconds, rays: budget instead of the quality's; rays alone means no limit of time.
        tree_depth, l_max, law: instead of the quality's.
    """
    check_asset_output(output)
    _check_budget(seconds, rays, seed)
    load_mitsuba(variant)
    from lumitree.direct import bake as direct
    from lumitree.luminaire.luminaire import load_luminaire
    from lumitree.luminaire.source import as_source

    check_choice("quality", quality, direct.QUALITIES)
    changes = {"tree_depth": tree_depth, "l_max": l_max, "law": law}
    config = dataclasses.replace(
        _budgeted(direct.QUALITIES[quality], seconds, rays),
        seed=seed,
        **{name: value for name, value in changes.items() if value is not None},
    )
    folder = as_source(source).name
    with _work_folder(output, work) as at:
        if (Path(folder) / MANIFEST).is_file():
            dataset = Dataset.open(folder)
            return _finish_direct(
                output, work, at, lambda: direct.bake_stored(dataset, config, at.path)
            )
        luminaire = load_luminaire(source)
        _diagnose(luminaire)
        return _finish_direct(output, work, at, lambda: direct.bake(luminaire, config, at.path))


@explained
def refine(
    path: str,
    source: "str | LuminaireSource",
    output: str,
    *,
    seconds: float | None = None,
    rays: int | None = None,
    seed: int = 0,
    work: str | None = None,
    variant: str | None = None,
) -> Report:
    """Improve an asset, however it was baked, with traced rays; budget and state as for `bake`."""
    check_asset_output(output)
    _check_budget(seconds, rays, seed)
    load_mitsuba(variant)
    from lumitree.asset.file import load
    from lumitree.direct import bake as direct
    from lumitree.luminaire.luminaire import load_luminaire

    config = dataclasses.replace(_budgeted(direct.QUALITIES["standard"], seconds, rays), seed=seed)
    asset = load(path)
    with _work_folder(output, work) as at:
        luminaire = load_luminaire(source)
        return _finish_direct(
            output, work, at, lambda: direct.refine(asset, luminaire, config, at.path)
        )


def _check_budget(seconds: float | None, rays: int | None, seed: int) -> None:
    if seconds is not None:
        check_range("time", seconds, 1e-3, MAX_SECONDS, "seconds")
    if rays is not None:
        check_range("rays", rays, 1, MAX_RAYS)
    check_seed(seed)


def _budgeted(config: "DirectConfig", seconds: float | None, rays: int | None) -> "DirectConfig":
    if seconds is None and rays is None:
        return config
    return dataclasses.replace(config, seconds=seconds, rays=rays)


def _work_folder(output: str, work: str | None) -> WorkFolder:
    """The folder of a bake's state: `work`, or one beside the asset."""
    return WorkFolder(work or Path(output).with_suffix(".work"))


def _finish_direct(
    output: str, work: str | None, folder: WorkFolder, job: "Callable[[], DirectResult]"
) -> Report:
    """Run a direct bake, write its asset and, where `work` does not name it, clear its state."""
    from lumitree.asset.file import save
    from lumitree.direct.bake import STATE

    watch = Stopwatch()
    with watch.stage("bake"):
        result = job()
        save(result.asset, output)
    if result.stopped_by is not None:
        raise Interrupted(
            f"the best asset so far is in {output}; the same command continues", result.stopped_by
        )
    if work is None:
        folder.remove([STATE])
    return {
        "asset": describe_asset(result.asset, output),
        "held_out_psnr": round(result.score.psnr, 3),
        "held_out_psnr_uncertainty": round(result.score.uncertainty, 3),
        "rays": result.rays,
        "seconds": watch.seconds,
        "peak_memory_bytes": peak_memory_bytes(),
    }


@explained
def bake_network(
    source: "str | LuminaireSource",
    output: str,
    *,
    preset: str = "preview",
    tree_depth: int | None = None,
    work: str | None = None,
    variant: str | None = None,
) -> Report:
    """Bake a luminaire as the paper does: capture, train and extract in one go.

    Intermediate results live in `work` (default: a folder beside the asset, removed at the
    end); an interrupted bake that is started again continues from them.
    """
    check_asset_output(output)
    check_choice("preset", preset, BAKE_PRESETS)
    settings = BAKE_PRESETS[preset]
    tree_depth = settings.tree_depth if tree_depth is None else tree_depth
    check_range("tree depth", tree_depth, 1, MAX_TREE_DEPTH)
    with _work_folder(output, work) as folder:
        captured = capture(
            source,
            str(folder.path / "dataset"),
            num_views=settings.num_views,
            resolution=settings.resolution,
            samples_per_pixel=settings.samples_per_pixel,
            variant=variant,
        )
        from lumitree.nerf.run import RUN_FILES

        run = folder.path / "run"
        trained = train(captured["dataset"], str(run), preset=preset, resume=run.exists())
        extracted = extract(
            str(run), output, tree_depth=tree_depth, samples_per_leaf=settings.samples_per_leaf
        )
        if work is None:
            names = [f"dataset/{name}" for name in DATASET_FILES]
            folder.remove([*names, *(f"run/{name}" for name in RUN_FILES)])
    seconds = captured["seconds"] | trained["seconds"] | extracted["seconds"]
    return {**extracted, "seconds": seconds, "peak_memory_bytes": peak_memory_bytes()}


def describe_asset(asset: "Asset", path: str) -> Report:
    """What `info` prints about an asset."""
    return {
        "file": str(path),
        "file_bytes": Path(path).stat().st_size,
        "luminaire": asset.luminaire,
        "tree_depth": asset.tree_depth,
        "leaves": asset.num_leaves,
        "nodes": len(asset.children),
        "l_max": asset.l_max,
        "law": asset.law,
        "max_radiance": asset.max_radiance,
        "size": (2 * asset.half_extents * asset.world_from_proxy[0, 0]).tolist(),
        "centre": asset.world_from_proxy[:3, 3].tolist(),
    }


@explained
def info(path: str) -> Report:
    """Describe an asset."""
    from lumitree.asset.file import load

    return {"asset": describe_asset(load(path), path)}


@explained
def evaluate(
    path: str,
    target: "str | LuminaireSource",
    *,
    sheet: str | None = None,
    num_views: int = EVALUATION_VIEWS,
    resolution: int = EVALUATION_RESOLUTION,
    samples_per_pixel: int = EVALUATION_SPP,
    variant: str | None = None,
) -> Report:
    """Compare an asset with held-out views: of a stored dataset, or captured from a luminaire.

    Args:
        path: the asset.
        target: DATASET folder or LUMINAIRE.
        sheet: where the contact sheet goes; default: the asset's name with `-evaluation.png`.
        num_views, resolution, samples_per_pixel: of the views captured from a LUMINAIRE.
    """
    sheet = sheet or str(Path(path).with_suffix("")) + "-evaluation.png"
    check_sheet_output(sheet)
    check_range("views", num_views, 1, MAX_VIEWS)
    check_image_settings(resolution=resolution, spp=samples_per_pixel)
    load_mitsuba(variant)
    from lumitree.asset.file import load
    from lumitree.evaluation.evaluate import evaluate_views
    from lumitree.evaluation.sheet import write_sheet

    asset = load(path)
    watch = Stopwatch()
    with contextlib.ExitStack() as stack:
        if (Path(str(target)) / MANIFEST).exists():
            _check_plain(target)
            dataset = Dataset.open(str(target))
        else:
            folder = str(stack.enter_context(scratch_folder()))
            with watch.stage("references"):
                capture(
                    target,
                    folder,
                    num_views=num_views,
                    resolution=resolution,
                    samples_per_pixel=samples_per_pixel,
                    split="test",
                )
            dataset = Dataset.open(folder)
        with watch.stage("evaluate"):
            result = evaluate_views(asset, dataset)
            write_sheet(sheet, result.rows, result.max_radiance, f"{asset.luminaire}, {path}")
    return {
        "metrics": result.metrics,
        "max_radiance": result.max_radiance,
        "views": result.views,
        "seconds": watch.seconds,
        "asset": describe_asset(asset, path),
        "sheet": sheet,
    }


@explained
def render(
    scene_path: str,
    output: str,
    placements: list[dict[str, Any]],
    *,
    samples_per_pixel: int = 64,
    width: int | None = None,
    proxy: Literal["box", "sphere"] = "box",
    variant: str | None = None,
) -> Report:
    """Render a scene file with luminaires placed in it.

    Args:
        placements: arguments of `render.room.Placement`.
    """
    from lumitree.core.images import check_image_name, write_image

    check_image_name(output)
    check_writable(output)
    check_image_settings(spp=samples_per_pixel, **({} if width is None else {"width": width}))
    for item in placements:
        check_placement(**{name: value for name, value in item.items() if name != "source"})
    load_mitsuba(variant)
    from lumitree.render import room as rooms

    watch = Stopwatch()
    with watch.stage("load"):
        items = [rooms.Placement(**item) for item in placements]
        room, integrator = rooms.load_room(scene_path, items)
        if width is not None:
            rooms.set_film_width(room, width)
        scene = rooms.furnish(room, items, proxy)
    with watch.stage("render"):
        image = rooms.render(scene, integrator, samples_per_pixel)
    write_image(output, image)
    return {
        "image": output,
        "resolution": [image.shape[1], image.shape[0]],
        "samples_per_pixel": samples_per_pixel,
        "mean_radiance": float(image.mean()),
        "seconds": watch.seconds,
        "peak_memory_bytes": peak_memory_bytes(),
    }


def _check_plain(target: "str | LuminaireSource") -> None:
    """Refuse options for reading a luminaire where its views are stored already."""
    if not isinstance(target, str) and (target.materials or target.keep or target.drop):
        raise LumitreeError(
            f"{target} is a dataset, which --materials, --keep and --drop cannot change; give the "
            "luminaire itself"
        )
