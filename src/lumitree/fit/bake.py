"""The direct bake: `bake` makes an asset from traced rays, and `refine` improves one."""

import dataclasses
import warnings
from collections.abc import Callable, Collection
from typing import TYPE_CHECKING, Any, Literal, get_args

from lumitree.asset.asset import PARTS, Asset, Part, exitant_asset
from lumitree.asset.model import AssetModel
from lumitree.core.arguments import check_asset_output, check_choice, check_light
from lumitree.core.backend import load_mitsuba
from lumitree.core.dataset import Dataset
from lumitree.core.files import FilePath
from lumitree.core.progress import ProgressCallback, reporting, show_progress
from lumitree.core.stopwatch import Stopwatch
from lumitree.core.transmittance import Law
from lumitree.core.work_folder import WorkFolder
from lumitree.errors import LumitreeError, LumitreeWarning, explained
from lumitree.fit.finishing import finish_bake, remove_state
from lumitree.fit.light_field.saved_field import EXITANT_STATE
from lumitree.fit.octree.config import QUALITIES, DirectConfig
from lumitree.fit.photometric_files import bake_photometric_file
from lumitree.fit.result import BakeResult
from lumitree.fit.work import open_work_folder
from lumitree.lamp.loading import dataset_folder, warn_of_faults
from lumitree.lamp.source import source_kind
from lumitree.measure.irradiance_check import IRRADIANCE_PATHS, check_irradiance_paths
from lumitree.rendering.asset_cache import open_asset
from lumitree.trace.light_field_config import EXITANT_QUALITIES

if TYPE_CHECKING:
    from lumitree.fit.octree.bake import DirectResult
    from lumitree.lamp.luminaire import Luminaire, LuminaireLike

Quality = Literal["preview", "standard", "high"]


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
    parts: Collection[Part] | None = None,
    irradiance_paths: int | None = None,
    lumens: float | None = None,
    temperature: float | None = None,
    seed: int = 0,
    work: FilePath | None = None,
    variant: str | None = None,
    progress: ProgressCallback | None = show_progress,
) -> BakeResult:
    """Bake a luminaire into an asset with the direct method.

    Light paths are traced first. Their histogram by place and direction is the exitant light
    field: what the luminaire sends to its surroundings. Then rays and light paths are traced for
    the radiance field, which is what images show of the luminaire. A first estimate is made from
    them, and gradient descent improves it until the budget is spent. The field is stored in a
    sparse octree.

    The state of the bake is kept in a work folder. If SIGINT (Ctrl-C), SIGTERM or SIGHUP
    interrupts the bake, the best asset so far is written and returned. If `output` or `work` is
    given, the same call continues the bake later.

    Args:
        luminaire: what to bake. One of: the name of a built-in luminaire; the path of a Mitsuba 3
            scene (`.xml`) or of a model (`.obj`, `.gltf`, `.glb`); a dictionary as for
            `mitsuba.load_dict`; a `mitsuba.Scene`; a `LuminaireSource`; a `Luminaire` that
            `load_luminaire` returned; or the folder of a dataset that `capture` made. Of a
            photometric file (`.ies`, `.ldt`) or an IES TM-25 ray file (`.ray`, `.tm25ray`) the
            asset has only the exitant light field, and `quality`, `lumens` and `temperature` apply;
            others are refused.
        output: path of the `.lumitree` file to write. Default: no file is written.
        quality: preset of tree depth and time: "preview" (depth 7, 1 minute on 2 CPU cores),
            "standard" (depth 8, 5 minutes) or "high" (depth 10, 30 minutes).
        time: budget of the radiance field in seconds, 0.001 to 31,536,000 (one year). The first
            estimate, about 20 s on 2 CPU cores, is always completed. Default: the time of
            `quality`, or no limit if `rays` is given.
        rays: budget of rays for the gradient descent, 1 to 2⁵⁰. If `time` is given too, the bake
            ends at whichever is reached first. Default: no limit.
        tree_depth: level of the smallest leaves, 1 to 10. Their side is the longest side of the
            bounding box divided by 2^tree_depth. Default: the depth of `quality`.
        l_max: highest band of the spherical harmonics, 0 to 4. Each leaf stores (l_max + 1)²
            coefficients per RGB channel. Default: 2.
        law: transmittance T as a function of the optical depth τ: "exponential", exp(-τ), or
            "linear", max(0, 1 - τ). Default: "exponential".
        parts: what the asset gets. "exitant": the exitant light field, 5 to 20 s on 2 CPU cores;
            it illuminates scenes. "field": the radiance field; images show it, and it illuminates
            if there is no exitant light field. Without it images show the exitant light field,
            which is blurred and lets all light through. "model": the luminaire itself, which
            images under `lumitree_path` show in place of the field; beside one of the other two.
            A part that is asked for and cannot be made is an error. Default: all that can be made:
            of a dataset "field", of a photometric file "exitant", and of a luminaire all three. One
            that cannot be stored, because it has what is not listed in docs/format.md, gets no
            model, with a warning.
        irradiance_paths: number of light paths, and of rays of the asset, by which the irradiance
            around the asset is compared with that around the luminaire at the end, as in
            `evaluate`; up to 67,108,864. 0: it is not compared. Default: by `quality`, 2¹⁸ to 2²⁰,
            which take 1 to 10 s on 2 CPU cores. For a dataset it is not compared.
        lumens: luminous flux of the asset, lm, if lengths of the luminaire are in metres; 10⁻⁶ to
            10⁹. Default: that of the luminaire.
        temperature: colour temperature of the whole flux of the asset, K, 1000 to 20,000. R, G and
            B of all its light each get a factor, by which the whole flux gets the chromaticity of a
            black body and keeps its luminous flux: a coloured part of a lamp stays coloured
            relative to the others. Default: the colours of the luminaire; R = G = B for a
            photometric file.
        seed: root seed of all random numbers, 0 to 2³¹ - 1. With `rays` and without `time`, equal
            seeds and settings give equal files on one machine.
        work: folder for the state: empty, new, or that of an earlier call. It is kept. Default:
            `output` with the suffix `.work`, or a temporary folder; it is removed at the end.
        variant: Mitsuba variant, "llvm_ad_rgb" or "cuda_ad_rgb". Default: the variant that is set;
            if none is set, "cuda_ad_rgb" if there is a GPU, else "llvm_ad_rgb".
        progress: function that is called with a `Progress` after each step. Default: a progress
            bar, or lines on standard error if that is not a terminal. None shows nothing.

    Returns:
        The asset (`asset`), its file (`path`), the error of the irradiance around it
        (`irradiance`), the PSNR on held-out rays in dB (`held_out_psnr`), and the number of traced
        rays (`rays`). `stopped_by` is the number of the signal that interrupted the bake, or None.

    Raises:
        LumitreeError: an argument is out of range; the luminaire cannot be read or emits no
            light; the work folder holds the state of another bake; no usable variant of Mitsuba
            is available; or a file cannot be written.

    Example:
        >>> result = lumitree.bake("bulbs", "bulbs.lumitree", quality="preview")
        >>> result.asset.info.leaves, result.held_out_psnr
    """
    if output is not None:
        check_asset_output(output)
    config, paths = check_bake(
        quality=quality,
        time=time,
        rays=rays,
        tree_depth=tree_depth,
        l_max=l_max,
        law=law,
        parts=parts,
        irradiance_paths=irradiance_paths,
        seed=seed,
    )
    check_light(lumens, temperature)
    load_mitsuba(variant)
    if source_kind(luminaire) == "photometric":
        others = {"time": time, "rays": rays, "tree_depth": tree_depth, "l_max": l_max, "law": law}
        others |= {"irradiance_paths": irradiance_paths, "seed": seed, "work": work}
        return bake_photometric_file(
            luminaire, output, parts, quality, lumens, temperature, progress, others
        )
    wanted = PARTS if parts is None else parts
    from lumitree.fit.light_field.bake import bake_exitant
    from lumitree.fit.octree import bake as direct
    from lumitree.lamp.luminaire import load_luminaire
    from lumitree.rendering.asset_flux import with_light

    exitant, model = None, None

    def completed(asset: Asset) -> Asset:
        whole = dataclasses.replace(asset, exitant=exitant, model=model)
        return with_light(whole, lumens, temperature)

    with reporting(progress), open_work_folder(output, work) as at:
        if (folder := dataset_folder(luminaire)) is not None:
            if parts is not None and set(parts) != {"field"}:
                raise LumitreeError(
                    f"parts are {', '.join(parts)}, but {folder} is a dataset, which has no light "
                    "paths; give the luminaire, or the part field alone"
                )
            dataset = Dataset.open(folder)
            job = lambda: direct.bake_stored(dataset, config, at.path)  # noqa: E731
            return _finish(output, work, at, job, completed)
        lamp = load_luminaire(luminaire)
        warn_of_faults(lamp)
        watch = Stopwatch()
        model = _stored_model(lamp, parts is not None) if "model" in wanted else None
        if "exitant" in wanted:
            light_config = dataclasses.replace(EXITANT_QUALITIES[quality], seed=seed)
            with watch.stage("exitant"):
                exitant = bake_exitant(lamp, light_config, at.path)
            # Before the field: refuses a colour that the light of the luminaire cannot have.
            asset = completed(exitant_asset(exitant, lamp.frame, lamp.name))
            if "field" not in wanted:
                result = finish_bake(asset, output, watch, lamp, paths)
                remove_state(at, work, result, [EXITANT_STATE])
                return result
        job = lambda: direct.bake(lamp, config, at.path)  # noqa: E731
        return _finish(output, work, at, job, completed, watch, lamp, paths)


def check_bake(
    *,
    quality: Quality,
    parts: Collection[Part] | None,
    irradiance_paths: int | None,
    time: float | None,
    **settings: Any,
) -> tuple[DirectConfig, int]:
    """Check arguments of `bake`.

    Args:
        settings: `rays`, `tree_depth`, `l_max`, `law` and `seed`.

    Returns:
        Settings of the direct bake, and the number of light paths of the comparison.

    Raises:
        LumitreeError: an argument is out of range.
    """
    check_choice("quality", quality, get_args(Quality))
    parts = PARTS if parts is None else parts
    for part in parts:
        check_choice("part", part, PARTS)
    if not set(parts) - {"model"}:
        raise LumitreeError(
            f"parts are {', '.join(parts) or 'none'}; expected exitant, field or both, and model"
        )
    paths = check_irradiance_paths(irradiance_paths, IRRADIANCE_PATHS[quality])
    return QUALITIES[quality].with_options(seconds=time, **settings), paths


def _stored_model(lamp: "Luminaire", required: bool) -> AssetModel | None:
    """The model of a luminaire; if it cannot be stored, an error or None with a warning."""
    from lumitree.lamp.stored_model import stored_model

    try:
        return stored_model(lamp)
    except LumitreeError as error:
        if required:
            raise LumitreeError(f"the part model cannot be made: {error}; leave it out") from None
        warnings.warn(
            f"the asset gets no model: {error}; images show its field",
            LumitreeWarning,
            stacklevel=3,
        )
        return None


@explained
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
    config = QUALITIES["standard"].with_options(seconds=time, rays=rays, seed=seed)
    paths = check_irradiance_paths(irradiance_paths, IRRADIANCE_PATHS["standard"])
    load_mitsuba(variant)
    from lumitree.fit.octree import bake as direct
    from lumitree.lamp.luminaire import load_luminaire

    rough = open_asset(asset)
    if not rough.num_leaves:
        raise LumitreeError(
            f"the asset ({rough.luminaire}) has no field to refine; give one that was baked with it"
        )
    with reporting(progress), open_work_folder(output, work) as at:
        lamp = load_luminaire(luminaire)
        job = lambda: direct.refine(rough, lamp, config, at.path)  # noqa: E731
        others = {"exitant": rough.exitant, "model": rough.model, "gain": rough.gain}
        completed = lambda asset: dataclasses.replace(asset, **others)  # noqa: E731
        return _finish(output, work, at, job, completed, None, lamp, paths)


def _finish(
    output: FilePath | None,
    work: FilePath | None,
    folder: WorkFolder,
    job: "Callable[[], DirectResult]",
    completed: Callable[[Asset], Asset],
    watch: Stopwatch | None = None,
    luminaire: "Luminaire | None" = None,
    irradiance_paths: int = 0,
) -> BakeResult:
    """Run a direct bake, write its asset, and measure its irradiance.

    `completed` adds the other parts and the gain to the asset of the field. Removes the saved
    state, unless the user chose its folder or the bake was interrupted.
    """
    from lumitree.fit.octree.saved_state import STATE

    watch = Stopwatch() if watch is None else watch
    with watch.stage("bake"):
        result = job()
    finished = finish_bake(
        completed(result.asset),
        output,
        watch,
        luminaire,
        irradiance_paths,
        result.stopped_by,
        held_out_psnr=round(result.score.psnr, 3),
        held_out_psnr_uncertainty=round(result.score.uncertainty, 3),
        rays=result.rays,
    )
    remove_state(folder, work, finished, [STATE, EXITANT_STATE])
    return finished
