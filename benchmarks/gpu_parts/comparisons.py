"""Estimates of the device and of the CPU compared: images of lamps, irradiance, and light fields.

Both devices measure at the same time, each in a process of its own and with its own random numbers.
Each quantity has a z-test; all together have one significance.
"""

import contextlib
import dataclasses
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from benchmarks.common.tables import Table
from benchmarks.gpu_parts.part import Context
from benchmarks.gpu_parts.sizes import SIZES, SizeName, Sizes
from lumitree.core.backend import CPU_VARIANT, load_rgb

Batches = dict[str, NDArray[np.floating]]
# measure(sizes, folder of assets, seed) -> batches [K, ...] by what they are of
Measure = Callable[[Sizes, Path, int], Batches]
# Largest probability by chance at which a set of quantities counts as different.
SIGNIFICANCE = 1e-3
# Between the seeds of the two devices; each uses less than this.
_SEEDS = 1 << 16
# Tiles of an image a side, of which the means are compared.
TILES = 8
# Patches of a face that are averaged, a side: few rays reach one.
_PATCHES = 4


def compare(context: Context, name: str) -> dict[str, Any]:
    """Agreement of the device with the CPU, by quantity.

    Args:
        name: of `MEASURES`.
    """
    assets = context.work / "assets"
    for lamp in context.sizes.lamps:
        shared_asset(context, lamp)
    size = context.sizes.name
    with _process() as first, _process() as second:
        job = first.submit(_batches, name, size, context.variant, assets, 0)
        there = second.submit(_batches, name, size, CPU_VARIANT, assets, _SEEDS).result()
        here = job.result()
    found = {}
    for key, batches in here.items():
        found[key] = agreement(batches, there[key])
        context.report(found)
    return found


def shared_asset(context: Context, lamp: str) -> Path:
    """Asset of a lamp that the CPU has baked once, with a radiance field for the first lamp."""
    path = context.work / "assets" / f"{lamp}.lumitree"
    if not path.is_file():
        with _process() as process:
            process.submit(_bake, context.sizes.name, lamp, path).result()
    return path


@contextlib.contextmanager
def _process() -> Iterator[ProcessPoolExecutor]:
    """A fresh process, whose end is not waited for: one that has used a GPU may hang then."""
    pool = ProcessPoolExecutor(1, get_context("spawn"))
    try:
        yield pool
    finally:
        pool.shutdown(wait=False, cancel_futures=True)


def _batches(name: str, size: SizeName, variant: str, assets: Path, seed: int) -> Batches:
    load_rgb(variant)
    return MEASURES[name](SIZES[size], assets, seed)


def _bake(size: SizeName, lamp: str, path: Path) -> None:
    import lumitree

    sizes = SIZES[size]
    config = sizes.bake
    if lamp != sizes.lamps[0]:
        config = dataclasses.replace(config, parts=("light", "geometry"))
    lumitree.bake(lamp, path, config, variant=CPU_VARIANT)


def _images(sizes: Sizes, assets: Path, seed: int) -> Batches:
    """Means of the tiles of images, with a ball in the lamp's box."""
    from benchmarks.common.demo_lamps import placed
    from lumitree.asset.file import load
    from lumitree.rendering.demo_room import demo_room
    from lumitree.rendering.passes import Budget, render_passes
    from lumitree.rendering.scene import default_integrator

    sources: dict[str, Any] = {}
    for lamp in sizes.lamps:
        asset = load(assets / f"{lamp}.lumitree")
        sources[f"{lamp}, explicit"] = lamp
        sources[f"{lamp}, light field and geometry"] = asset
        if asset.num_leaves:
            field = dataclasses.replace(asset, light_field=None, geometry=None)
            sources[f"{lamp}, radiance field"] = field
    integrator, found = default_integrator(12), {}
    for name, source in sources.items():
        room = demo_room(sizes.width, ball_in_box=True)
        scene = placed(source, sizes.width, room, appearance="geometry")
        found[name] = np.array(
            [
                tiles(
                    render_passes(
                        scene, integrator, Budget(sizes.spp), seed=seed + index, name=name
                    ).radiance
                )
                for index in range(sizes.batches)
            ]
        )
    return found


def tiles(image: NDArray[np.float32]) -> NDArray[np.float64]:
    """Means [TILES, TILES, 3] of an image whose sides are multiples of TILES."""
    height, width, _ = image.shape
    parts = image.reshape(TILES, height // TILES, TILES, width // TILES, 3)
    return parts.astype(np.float64).mean(axis=(1, 3))


def _irradiance(sizes: Sizes, assets: Path, seed: int) -> Batches:
    """Irradiance around the lamps and around their assets."""
    from lumitree.asset.file import load
    from lumitree.lamp.luminaire import load_luminaire
    from lumitree.measure.irradiance import asset_irradiance, luminaire_irradiance

    found = {}
    for lamp in sizes.lamps:
        around = luminaire_irradiance(load_luminaire(lamp), sizes.rays, seed=seed)
        found[f"{lamp}, explicit"] = _coarse(around.batches)
        asset = load(assets / f"{lamp}.lumitree")
        found[f"{lamp}, light field"] = _coarse(
            asset_irradiance(asset, sizes.rays, seed=seed).batches
        )
        if asset.num_leaves:
            field = dataclasses.replace(asset, light_field=None)
            found[f"{lamp}, radiance field"] = _coarse(
                asset_irradiance(field, sizes.rays, seed=seed).batches
            )
    return found


def _light_field(sizes: Sizes, assets: Path, seed: int) -> Batches:
    """Flux and intensity of light fields that the device bakes, and the irradiance around them."""
    import lumitree
    from lumitree.measure.irradiance import asset_irradiance
    from lumitree.rendering.asset_flux import intensity_by_bin, light_field_watts

    found: dict[str, list[NDArray[np.floating]]] = {}
    for lamp in sizes.lamps:
        for index in range(sizes.batches):
            config = lumitree.BakeConfig(
                parts=("light",),
                irradiance_paths=0,
                seed=seed + index,
                light=dataclasses.replace(sizes.bake.light, paths=sizes.paths, batch=sizes.paths),
            )
            asset = lumitree.bake(lamp, config=config, progress=None).asset
            assert asset.light_field is not None
            values = {
                "flux": light_field_watts(asset.light_field),
                "intensity": _octants(intensity_by_bin(asset)),
                "irradiance": _coarse(
                    asset_irradiance(asset, sizes.rays // sizes.batches, seed=seed + index).mean
                ),
            }
            for name, value in values.items():
                found.setdefault(f"{lamp}, {name}", []).append(value)
    return {name: np.array(values) for name, values in found.items()}


def _coarse(irradiance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Means of squares of patches, from [..., P, P, 3]."""
    *first, height, width, channels = irradiance.shape
    parts = (*first, height // _PATCHES, _PATCHES, width // _PATCHES, _PATCHES, channels)
    return irradiance.reshape(parts).mean(axis=(-4, -2))


def _octants(intensity: NDArray[np.float64]) -> NDArray[np.float64]:
    """Means of quarters of the octahedral map a side, from [R²]."""
    side = round(intensity.size**0.5)
    return intensity.reshape(4, side // 4, 4, side // 4).mean(axis=(1, 3))


MEASURES: dict[str, Measure] = {
    "images": _images,
    "irradiance": _irradiance,
    "light-field": _light_field,
}


def agreement(first: NDArray[np.floating], second: NDArray[np.floating]) -> dict[str, Any]:
    """Compare the means of independent batches of two estimates of the same quantities.

    Each quantity and the sum of all have Welch's test, because the errors are estimated from few
    batches; then Šidák's correction for their number. The sum shows a difference that all have in
    common and that the noise of each hides.

    Args:
        first, second: [K, ...] and [L, ...] batches of equal weight, at least two of each.

    Returns:
        `quantities`, their number with the sum; `largest_z`, the largest difference in standard
        errors; `p`, the probability of one as improbable as the least probable, if both estimate
        the same; `agrees`, whether it is at least `SIGNIFICANCE`; `ratio` and `ratio_error`, the
        sum of `first` over the sum of `second` and its standard error; `not_finite`, the number of
        values that are NaN or infinite: with one, nothing agrees, and what is not known is None.
    """
    a, b = (_with_sum(each) for each in (first, second))
    not_finite = int((~np.isfinite(a)).sum() + (~np.isfinite(b)).sum())
    if not_finite:
        unknown = dict.fromkeys(("largest_z", "ratio", "ratio_error"))
        return {"quantities": a.shape[1], "p": 0.0, "agrees": False, **unknown} | {
            "not_finite": not_finite
        }
    squares = [each.var(axis=0, ddof=1) / len(each) for each in (a, b)]
    difference, error = a.mean(axis=0) - b.mean(axis=0), np.sqrt(squares[0] + squares[1])
    with np.errstate(divide="ignore", invalid="ignore"):
        z = np.where(difference == 0, 0.0, difference / error)
        parts = squares[0] ** 2 / (len(a) - 1) + squares[1] ** 2 / (len(b) - 1)
        freedom = np.where(error > 0, error**4 / parts, 1.0)
    smallest = float(2 * stats.t.sf(np.abs(z), freedom).min())
    p = 1.0 if smallest >= 1 else float(-np.expm1(z.size * np.log1p(-smallest)))
    ratio, ratio_error = _ratio(a[:, -1], b[:, -1])
    return {
        "quantities": int(z.size),
        "largest_z": float(np.abs(z).max()),
        "p": p,
        "agrees": p >= SIGNIFICANCE,
        "ratio": ratio,
        "ratio_error": ratio_error,
        "not_finite": 0,
    }


def _with_sum(batches: NDArray[np.floating]) -> NDArray[np.float64]:
    """The quantities [K, N + 1] of the batches, and the sum of all."""
    flat = np.asarray(batches, np.float64).reshape(len(batches), -1)
    return np.column_stack([flat, flat.sum(axis=1)])


def _ratio(a: NDArray[np.float64], b: NDArray[np.float64]) -> tuple[float, float]:
    """Ratio of the means of batches, and its standard error to first order."""
    ratio = a.mean() / b.mean()
    relative = [each.std(ddof=1) / np.sqrt(len(each)) / each.mean() for each in (a, b)]
    return float(ratio), float(abs(ratio) * np.hypot(*relative))


def show(values: dict[str, Any]) -> str:
    """Markdown of the values of `compare`."""
    rows = []
    for name, each in values.items():
        figures = [f"{each['not_finite']} values are not finite", "", ""]
        if not each["not_finite"]:
            figures = [f"{each['largest_z']:.2f}", f"{each['p']:.2g}"]
            figures.append(f"{each['ratio']:.4f} ± {each['ratio_error']:.2g}")
        verdict = "agrees" if each["agrees"] else "**differs**"
        rows.append([name, verdict, str(each["quantities"]), *figures])
    heads = [
        "what",
        f"at p ≥ {SIGNIFICANCE:g}",
        "quantities",
        "largest difference, standard errors",
    ]
    return Table([*heads, "p", "sum, device / CPU"], rows, left=2).markdown()
