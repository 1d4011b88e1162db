"""`bake` makes an asset of a source of any kind, and `refine` improves the field of one."""

import dataclasses
import warnings
from collections.abc import Collection
from concurrent.futures import Executor
from typing import TYPE_CHECKING, Any

from lumitree.asset.asset import Asset, Part, light_field_asset
from lumitree.asset.geometry import AssetGeometry
from lumitree.core.arguments import check_asset_output
from lumitree.core.backend import check_network, in_turn, load_rgb
from lumitree.core.executor import check_executor
from lumitree.core.files import FilePath, WorkFolder
from lumitree.core.progress import ProgressCallback, reporting, show_progress
from lumitree.core.progress import progress as steps
from lumitree.core.results import Stopwatch
from lumitree.core.seeds import check_seed
from lumitree.errors import LumitreeError, LumitreeWarning, shown
from lumitree.fit.bake_network import bake_network
from lumitree.fit.config import (
    KINDS,
    ONLY_PARTS,
    BakeConfig,
    Method,
    Quality,
    chosen_config,
    refuse_unused,
)
from lumitree.fit.finishing import (
    BakeResult,
    finish_bake,
    open_work_folder,
    remove_state,
    save_asset,
)
from lumitree.lamp.dataset import Dataset
from lumitree.lamp.diagnosis import warn_of_faults
from lumitree.lamp.source import as_source, dataset_folder, refuse_options, source_kind
from lumitree.measure.irradiance import check_irradiance_paths
from lumitree.rendering.asset_cache import open_asset

if TYPE_CHECKING:
    from lumitree.fit.octree.bake import OctreeFitResult
    from lumitree.lamp.luminaire import LampWorkers, Luminaire, LuminaireLike


@in_turn
def bake(
    source: "LuminaireLike",
    output: FilePath | None = None,
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
    work: FilePath | None = None,
    variant: str | None = None,
    executor: Executor | None = None,
    progress: ProgressCallback | None = show_progress,
) -> BakeResult:
    """Bake a luminaire, the views of a dataset or a photometric file into an asset.

    Light paths are traced through a luminaire. Their histogram by place and direction is the light
    field, which illuminates scenes. The geometry of the luminaire is stored beside it, and images
    show it. Where it cannot be stored, or if `parts` has "field", rays and light paths are traced
    for the radiance field too. A first estimate is made from them, and gradient descent improves it
    until the budget is spent. The field is stored in a sparse octree. The views of a dataset give a
    radiance field alone, and a photometric file gives a light field alone.

    The state of the bake is kept in a work folder. If SIGINT (Ctrl-C), SIGTERM or SIGHUP
    interrupts the bake, the best asset so far is written and returned. Before there is one, as
    within the light field or a network, `KeyboardInterrupt` is raised. If `output` or `work` is
    given, the same call continues the bake later.

    Args:
        source: what to bake. One of: the name of a built-in luminaire; the path of a Mitsuba 3
            scene (`.xml`) or of a model (`.obj`, `.gltf`, `.glb`); a dictionary as for
            `mitsuba.load_dict`; a `mitsuba.Scene`; a `LuminaireSource`; a `Luminaire` that
            `load_luminaire` returned; the folder of a dataset, made by `capture`; or the path of an
            IES or EULUMDAT file (`.ies`, `.ldt`), a GLDF file (`.gldf`, with # and the name of a
            variant for another than the first), luminaire data of IES TM-33 (`.tm33`, `.xml`), or
            an IES TM-25 ray file (`.ray`, `.tm25ray`).
        output: path of the `.lumitree` file to write. Default: no file is written.
        config: settings of the bake. Default: the settings of `quality` and `method`.
        quality: "preview", "standard" or "high": 1, 2 or 16 million light paths, 5 to 30 s on 2 CPU
            cores; and, if one is made, a radiance field of depth 7 in 1 minute, of depth 8 in 5
            minutes, or of depth 10 in 30 minutes. With the method "network", "preview": minutes on
            2 CPU cores; or "paper": hours on a GPU. Default: "standard"; "preview" with "network".
        method: how a radiance field is made: "octree", from traced rays; or "network", as in the
            paper, which needs the extra `network` of lumitree. Default: "octree".
        parts: what the asset gets, of "light", which illuminates scenes; "geometry", the luminaire
            itself, which images show, in seconds, not with the method "network"; and "field", a
            radiance field, which images show in place of geometry, in minutes. Default: "light" and
            "geometry"; "light" and "field" where the geometry cannot be stored, or with the method
            "network".
        time: budget of the radiance field in seconds, 0.001 to 31,536,000 (one year). The first
            estimate, about 20 s on 2 CPU cores, is always completed. Default: by the quality, or no
            limit if `rays` is given.
        rays: budget of rays for the gradient descent of the radiance field, 1 to 2⁵⁰. If `time` is
            given too, the bake ends at whichever is reached first. Default: no limit.
        lumens: luminous flux of the asset, lm, if lengths are in metres; 10⁻⁶ to 10⁹. Default: the
            flux of the source.
        temperature: colour temperature of the whole flux, K, 1000 to 20,000; all colours get the
            same factors. Default: the colours of the source.
        seed: root seed of all random numbers, 0 to 2³¹ - 1. With a budget of rays alone, equal
            seeds and settings give equal files on one machine. Default: 0.
        work: folder for the state: empty, new, or of an earlier call. It is kept. Default:
            `output` with the suffix `.work`, or a temporary folder; it is removed at the end.
        variant: Mitsuba variant: "llvm_ad_rgb"; "cuda_ad_rgb" on an NVIDIA GPU, which is little
            tested; or "metal_ad_rgb" on Apple silicon, which is untested. Default: the variant that
            is set; if none is set, "llvm_ad_rgb".
        executor: whose workers trace the light paths of the light field, and with the method
            "network" render the views; each loads the luminaire. The asset is the same. All other
            work is done by this process, and by default this too.
        progress: function that is called with a `Progress` after each step. Default: a progress
            bar, or lines on standard error if that is not a terminal. None shows nothing.

    Returns:
        The asset (`asset`), its file (`path`), the error of the irradiance around it
        (`irradiance`), the PSNR on held-out rays in dB (`held_out_psnr`), and the number of traced
        rays (`rays`). `stopped_by` is the number of the signal that interrupted the bake, or None.

    Raises:
        LumitreeError: the source cannot be read or emits no light; an argument is out of range, or
            does not apply to the source; the work folder holds the state of another bake; no usable
            variant of Mitsuba is available; a file cannot be written; a worker is lost; or the
            luminaire cannot be sent to the workers of `executor`, such as a `mitsuba.Scene` or a
            `Luminaire`.

    Example:
        >>> result = lumitree.bake("lamp.glb", "lamp.lumitree", quality="high")
        >>> result.asset.info.leaves, result.irradiance
    """
    settings: dict[str, Any] = {"quality": quality, "method": method, "parts": parts, "seed": seed}
    settings |= {"time": time, "rays": rays, "lumens": lumens, "temperature": temperature}
    config = chosen_config(config, **settings)
    if output is not None:
        check_asset_output(output)
    check_executor(executor)
    kind = source_kind(source)
    if kind in ONLY_PARTS and config.parts not in (None, (ONLY_PARTS[kind],)):
        raise LumitreeError(
            f"parts are {', '.join(config.parts or ())}, but {shown(source, 300)} is "
            f"{KINDS[kind]}, from which only the part {ONLY_PARTS[kind]} can be made; leave the "
            "others out"
        )
    settings |= {"executor": executor, "work": work}
    given = [name for name, value in settings.items() if value is not None]
    if config.method == "network":
        given.append("method")
    refuse_unused(given, config, [source])
    if config.method == "network":
        check_network()
    load_rgb(variant)
    if kind == "photometric":
        with reporting(progress):
            return _bake_photometric(source, output, config)
    with open_work_folder(output, work) as folder:
        if kind == "dataset":
            with reporting(progress):
                return _bake_views(source, output, config, folder, work)
        from lumitree.lamp.luminaire import lamp_workers, load_luminaire

        with reporting(progress):
            lamp = load_luminaire(source)
            sent = lamp_workers(executor, source, lamp)
            warn_of_faults(lamp)
            bake_lamp = bake_network if config.method == "network" else _bake_lamp
            return bake_lamp(lamp, output, config, folder, work, sent)


def _bake_photometric(source: Any, output: FilePath | None, config: BakeConfig) -> BakeResult:
    from lumitree.formats.photometric_file import bake_file
    from lumitree.rendering.asset_flux import with_light

    described, watch = as_source(source), Stopwatch()
    refuse_options(described, "a photometric file")
    with steps(f"light of {shown(described.name)}", 1) as advance, watch.stage("light"):
        asset = bake_file(described.name, config.light)
        asset = with_light(asset, config.lumens, config.temperature)
        advance(1)
    return BakeResult(asset=asset, path=save_asset(asset, output), **watch.costs())


def _bake_views(
    source: Any, output: FilePath | None, config: BakeConfig, folder: WorkFolder, work: Any
) -> BakeResult:
    from lumitree.fit.octree.bake import bake_stored
    from lumitree.rendering.asset_flux import with_light

    views, watch = dataset_folder(source), Stopwatch()
    assert views is not None
    with watch.stage("bake"):
        fit = bake_stored(Dataset.open(views), config.octree, folder.path, config.seed)
    asset = with_light(fit.asset, config.lumens, config.temperature)
    return _finish_fit(fit, asset, output, watch, folder, work)


def _bake_lamp(
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
            light_field = bake_light_field(lamp, config.light, folder.path, workers, config.seed)
        # Before the field: refuses a colour that the light of the luminaire cannot have.
        lit = dataclasses.replace(
            light_field_asset(light_field, lamp.frame, lamp.name), geometry=geometry
        )
        lit = with_light(lit, config.lumens, config.temperature)
        if "field" not in parts:
            result = finish_bake(lit, output, watch, lamp, config.irradiance_paths)
            remove_state(folder, work, result)
            return result
    with watch.stage("bake"):
        fit = octree_fit.bake(lamp, config.octree, folder.path, config.seed)
    asset = dataclasses.replace(fit.asset, light_field=light_field, geometry=geometry)
    asset = with_light(asset, config.lumens, config.temperature)
    return _finish_fit(fit, asset, output, watch, folder, work, lamp, config.irradiance_paths)


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

    The asset may come from `bake` or `extract`. As with `bake`, an interrupted call
    returns the best asset so far, and the same call continues it.

    Args:
        asset: an asset, or the path of its `.lumitree` file. The result has the same tree depth,
            l_max and transmittance law.
        luminaire: the luminaire that the asset was baked from, in any form that `bake` takes.
        output: path of the `.lumitree` file to write. Default: no file is written.
        time: budget in seconds, 0.001 to 31,536,000 (one year). Default: 285 s, or no limit if
            `rays` is given.
        rays: budget of rays, 1 to 2⁵⁰. If `time` is given too, the call ends at whichever is
            reached first. Default: no limit.
        irradiance_paths: see `bake`. Default: 2¹⁸.
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
    config = BakeConfig.of()
    octree = config.octree
    if time is not None or rays is not None:
        octree = dataclasses.replace(octree, time=time, rays=rays)
    check_seed(seed)
    if irradiance_paths is None:
        irradiance_paths = config.irradiance_paths
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
            fit = octree_fit.refine(rough, lamp, octree, at.path, seed)
        light = rough.light_field
        better = dataclasses.replace(
            fit.asset,
            # A light field of the rough field's rays is made again.
            light_field=None if light is None or light.traced is None else light,
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
    remove_state(folder, work, result)
    return result
