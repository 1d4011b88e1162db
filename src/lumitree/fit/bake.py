"""The octree fit: `bake` and `bake_views` make an asset from rays, and `refine` improves one."""

import dataclasses
import warnings
from collections.abc import Collection
from concurrent.futures import Executor
from typing import TYPE_CHECKING

from lumitree.asset.asset import Asset, Part, light_field_asset
from lumitree.asset.geometry import AssetGeometry
from lumitree.core.arguments import check_asset_output, check_light
from lumitree.core.backend import load_rgb
from lumitree.core.dataset import Dataset
from lumitree.core.executor import check_executor
from lumitree.core.files import FilePath, WorkFolder
from lumitree.core.progress import ProgressCallback, reporting, show_progress
from lumitree.core.stopwatch import Stopwatch
from lumitree.core.turns import in_turn
from lumitree.errors import LumitreeError, LumitreeWarning, shown
from lumitree.fit.config import BakeConfig
from lumitree.fit.finishing import finish_bake, remove_state
from lumitree.fit.light_field.saved_field import LIGHT_FIELD_STATE
from lumitree.fit.octree.config import OctreeFitConfig
from lumitree.fit.result import BakeResult
from lumitree.fit.work import open_work_folder
from lumitree.lamp.diagnosis import warn_of_faults
from lumitree.lamp.source import dataset_folder, source_kind
from lumitree.measure.irradiance_check import check_irradiance_paths
from lumitree.rendering.asset_cache import open_asset

if TYPE_CHECKING:
    from lumitree.fit.octree.bake import OctreeFitResult
    from lumitree.lamp.luminaire import LampWorkers, Luminaire, LuminaireLike

# Sources that `bake` does not take, and the functions for them.
_OTHERS = {
    "photometric": ("a photometric file", "bake_photometric"),
    "dataset": ("the folder of a dataset", "bake_views"),
}


@in_turn
def bake(
    luminaire: "LuminaireLike",
    output: FilePath | None = None,
    config: BakeConfig | None = None,
    *,
    work: FilePath | None = None,
    variant: str | None = None,
    executor: Executor | None = None,
    progress: ProgressCallback | None = show_progress,
) -> BakeResult:
    """Bake a luminaire into an asset.

    Light paths are traced. Their histogram by place and direction is the light field: what the
    luminaire sends to its surroundings. The geometry of the luminaire is stored beside it, and
    images show it. Where it cannot be stored, or if `config.parts` has "field", rays and light
    paths are traced for the radiance field too. A first estimate is made from them, and gradient
    descent improves it until the budget is spent. The field is stored in a sparse octree.

    The state of the bake is kept in a work folder. If SIGINT (Ctrl-C), SIGTERM or SIGHUP
    interrupts the bake, the best asset so far is written and returned. Before there is one, as
    within the light field, `KeyboardInterrupt` is raised. If `output` or `work` is given, the same
    call continues the bake later.

    Args:
        luminaire: what to bake. One of: the name of a built-in luminaire; the path of a Mitsuba 3
            scene (`.xml`) or of a model (`.obj`, `.gltf`, `.glb`); a dictionary as for
            `mitsuba.load_dict`; a `mitsuba.Scene`; a `LuminaireSource`; or a `Luminaire` that
            `load_luminaire` returned. `bake_views` bakes the folder of a dataset, and
            `bake_photometric` a photometric file.
        output: path of the `.lumitree` file to write. Default: no file is written.
        config: settings of the bake. Default: `BakeConfig.standard()`.
        work: folder for the state: empty, new, or that of an earlier call. It is kept. Default:
            `output` with the suffix `.work`, or a temporary folder; it is removed at the end.
        variant: Mitsuba variant: "llvm_ad_rgb"; "cuda_ad_rgb" on an NVIDIA GPU, which is little
            tested; or "metal_ad_rgb" on Apple silicon, which is untested. Default: the variant that
            is set; if none is set, "llvm_ad_rgb".
        executor: whose workers trace the light paths of the light field; each loads the luminaire.
            The asset is the same. All other work is done by this process, and by default this too.
        progress: function that is called with a `Progress` after each step. Default: a progress
            bar, or lines on standard error if that is not a terminal. None shows nothing.

    Returns:
        The asset (`asset`), its file (`path`), the error of the irradiance around it
        (`irradiance`), the PSNR on held-out rays in dB (`held_out_psnr`), and the number of traced
        rays (`rays`). `stopped_by` is the number of the signal that interrupted the bake, or None.

    Raises:
        LumitreeError: the luminaire cannot be read or emits no light; the work folder holds the
            state of another bake; no usable variant of Mitsuba is available; a file cannot be
            written; a worker is lost; or the luminaire cannot be sent to the workers of
            `executor`, such as a `mitsuba.Scene` or a `Luminaire`.

    Example:
        >>> result = lumitree.bake("bulbs", "bulbs.lumitree", lumitree.BakeConfig.preview())
        >>> result.asset.info.leaves, result.held_out_psnr
    """
    config = BakeConfig.standard() if config is None else config
    if output is not None:
        check_asset_output(output)
    _check_kind(luminaire)
    check_executor(executor)
    load_rgb(variant)
    from lumitree.lamp.luminaire import lamp_workers, load_luminaire

    with reporting(progress), open_work_folder(output, work) as folder:
        lamp = load_luminaire(luminaire)
        workers = lamp_workers(executor, luminaire, lamp)
        warn_of_faults(lamp)
        return _bake(lamp, output, config, folder, work, workers)


def _bake(
    lamp: "Luminaire",
    output: FilePath | None,
    config: BakeConfig,
    folder: WorkFolder,
    work: FilePath | None,
    workers: "LampWorkers | None",
) -> BakeResult:
    from lumitree.fit.light_field.bake import bake_light_field
    from lumitree.fit.octree import bake as octree_fit
    from lumitree.rendering.asset_flux import with_light

    watch = Stopwatch()
    parts, geometry = _parts_and_geometry(lamp, config.parts)
    light_field = None
    if "light" in parts:
        with watch.stage("light"):
            light_field = bake_light_field(lamp, config.light_field_fit, folder.path, workers)
        # Before the field: refuses a colour that the light of the luminaire cannot have.
        lit = dataclasses.replace(
            light_field_asset(light_field, lamp.frame, lamp.name), geometry=geometry
        )
        lit = with_light(lit, config.lumens, config.temperature)
        if "field" not in parts:
            result = finish_bake(lit, output, watch, lamp, config.irradiance_paths)
            remove_state(folder, work, result, [LIGHT_FIELD_STATE])
            return result
    with watch.stage("bake"):
        fit = octree_fit.bake(lamp, config.octree_fit, folder.path)
    asset = dataclasses.replace(fit.asset, light_field=light_field, geometry=geometry)
    asset = with_light(asset, config.lumens, config.temperature)
    return _finish_fit(fit, asset, output, watch, folder, work, lamp, config.irradiance_paths)


def _check_kind(source: object) -> None:
    """Refuse what other functions bake."""
    other = _OTHERS.get(source_kind(source))
    if other is not None:
        what, function = other
        name = shown(source, 300)
        raise LumitreeError(f"{name} is {what}, not a luminaire; bake it by lumitree.{function}")


def _parts_and_geometry(
    lamp: "Luminaire", parts: Collection[Part] | None
) -> tuple[Collection[Part], AssetGeometry | None]:
    """The parts to make, by default those that images need, and the geometry if it is one."""
    from lumitree.lamp.stored_geometry import stored_geometry

    if parts is not None and "geometry" not in parts:
        return parts, None
    try:
        return parts or ("light", "geometry"), stored_geometry(lamp)
    except LumitreeError as error:
        if parts is not None:
            reason = f"the part geometry cannot be made: {error}; leave it out"
            raise LumitreeError(reason) from None
        warnings.warn(
            f"the asset gets no geometry: {error}; it gets a radiance field, which images show",
            LumitreeWarning,
            stacklevel=3,
        )
        return ("light", "field"), None


@in_turn
def bake_views(
    dataset: FilePath,
    output: FilePath | None = None,
    config: OctreeFitConfig | None = None,
    *,
    lumens: float | None = None,
    temperature: float | None = None,
    work: FilePath | None = None,
    variant: str | None = None,
    progress: ProgressCallback | None = show_progress,
) -> BakeResult:
    """Bake the views of a dataset into an asset that has a radiance field only.

    Views have no light paths, from which a light field could be made or the irradiance be
    compared. An interrupted call continues as that of `bake`.

    Args:
        dataset: folder of the dataset, made by `capture`.
        output: path of the `.lumitree` file to write. Default: no file is written.
        config: settings of the octree fit. Default: `BakeConfig.standard().octree_fit`.
        lumens: luminous flux of the asset, lm; see `BakeConfig`.
        temperature: colour temperature of the asset, K; see `BakeConfig`.
        work: folder for the state; see `bake`.
        variant: Mitsuba variant; see `bake`.
        progress: function that is called with a `Progress` after each step; see `bake`.

    Returns:
        The asset and its figures, as `bake` returns them.

    Raises:
        LumitreeError: the dataset cannot be read, or its views are black, too few or have nothing
            in common; or as for `bake`.
    """
    config = BakeConfig.standard().octree_fit if config is None else config
    check_light(lumens, temperature)
    if output is not None:
        check_asset_output(output)
    folder = dataset_folder(dataset)
    if folder is None:
        raise LumitreeError(f"{shown(dataset, 300)} is not the folder of a dataset; see capture")
    load_rgb(variant)
    from lumitree.fit.octree import bake as octree_fit
    from lumitree.rendering.asset_flux import with_light

    with reporting(progress), open_work_folder(output, work) as at:
        views = Dataset.open(folder)
        watch = Stopwatch()
        with watch.stage("bake"):
            fit = octree_fit.bake_stored(views, config, at.path)
        asset = with_light(fit.asset, lumens, temperature)
        return _finish_fit(fit, asset, output, watch, at, work)


@in_turn
def refine(
    asset: Asset | FilePath,
    luminaire: "LuminaireLike",
    output: FilePath | None = None,
    *,
    time: float | None = None,
    rays: int | None = None,
    irradiance_paths: int | None = None,
    seed: int = 0,
    work: FilePath | None = None,
    variant: str | None = None,
    progress: ProgressCallback | None = show_progress,
) -> BakeResult:
    """Improve an asset by gradient descent with rays traced through its luminaire.

    The asset may come from `bake`, `bake_network` or `extract`. As with `bake`, an interrupted call
    returns the best asset so far, and the same call continues it.

    Args:
        asset: an asset, or the path of its `.lumitree` file. The result has the same tree depth,
            l_max and transmittance law.
        luminaire: the luminaire that the asset was baked from, in any form that `bake` takes
            except the folder of a dataset.
        output: path of the `.lumitree` file to write. Default: no file is written.
        time: budget in seconds, 0.001 to 31,536,000 (one year). Default: 285 s, or no limit if
            `rays` is given.
        rays: budget of rays, 1 to 2⁵⁰. If `time` is given too, the call ends at whichever is
            reached first. Default: no limit.
        irradiance_paths: see `bake`. Default: 2¹⁹.
        seed: root seed of all random numbers, 0 to 2³¹ - 1.
        work: folder for the state; see `bake`.
        variant: Mitsuba variant; see `bake`.
        progress: function that is called with a `Progress` after each step; see `bake`.

    Returns:
        The improved asset and its figures, as `bake` returns them.

    Raises:
        LumitreeError: the bounding boxes of asset and luminaire differ, or as for `bake`.
    """
    if output is not None:
        check_asset_output(output)
    standard = BakeConfig.standard()
    if time is None and rays is None:
        time, rays = standard.time, standard.rays
    fit_config = dataclasses.replace(standard.octree_fit, time=time, rays=rays, seed=seed)
    if irradiance_paths is None:
        irradiance_paths = standard.irradiance_paths
    check_irradiance_paths(irradiance_paths)
    load_rgb(variant)
    from lumitree.fit.octree import bake as octree_fit
    from lumitree.lamp.luminaire import load_luminaire

    rough = open_asset(asset)
    if not rough.num_leaves:
        raise LumitreeError(
            f"the asset ({rough.luminaire}) has no field to refine; give one that was baked with it"
        )
    with reporting(progress), open_work_folder(output, work) as at:
        lamp = load_luminaire(luminaire)
        watch = Stopwatch()
        with watch.stage("bake"):
            fit = octree_fit.refine(rough, lamp, fit_config, at.path)
        better = dataclasses.replace(
            fit.asset,
            light_field=rough.light_field,
            geometry=rough.geometry,
            light_factors=rough.light_factors,
        )
        return _finish_fit(fit, better, output, watch, at, work, lamp, irradiance_paths)


def _finish_fit(
    fit: "OctreeFitResult",
    asset: Asset,
    output: FilePath | None,
    watch: Stopwatch,
    folder: WorkFolder,
    work: FilePath | None,
    luminaire: "Luminaire | None" = None,
    irradiance_paths: int = 0,
) -> BakeResult:
    """`finish_bake` of an asset with the field of an octree fit; removes the saved state."""
    from lumitree.fit.octree.saved_state import STATE

    result = finish_bake(
        asset,
        output,
        watch,
        luminaire,
        irradiance_paths,
        fit.stopped_by,
        held_out_psnr=round(fit.score.psnr, 3),
        held_out_psnr_uncertainty=round(fit.score.uncertainty, 3),
        rays=fit.rays,
    )
    remove_state(folder, work, result, [STATE, LIGHT_FIELD_STATE])
    return result
