"""What the device and the CPU estimate alike: images of lamps, irradiance, and light fields.

Both devices measure at the same time, each in a process of its own and with its own random numbers.
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

from benchmarks.gpu_parts.agreement import agreement
from benchmarks.gpu_parts.part import Context
from benchmarks.gpu_parts.sizes import SIZES, SizeName, Sizes
from lumitree.core.backend import CPU_VARIANT, load_rgb

Batches = dict[str, NDArray[np.floating]]
# measure(sizes, folder of assets, seed) -> batches [K, ...] by what they are of
Measure = Callable[[Sizes, Path, int], Batches]
# Between the seeds of the two devices; each uses less than this.
_SEEDS = 1 << 16
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
    from benchmarks.devices import tiles
    from lumitree.asset.file import load
    from lumitree.rendering.demo_room import demo_room
    from lumitree.rendering.integrators import default_integrator
    from lumitree.rendering.passes import Budget, render_passes

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


def _irradiance(sizes: Sizes, assets: Path, seed: int) -> Batches:
    """Irradiance around the lamps and around their assets."""
    from lumitree.asset.file import load
    from lumitree.lamp.loading import load_luminaire
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
                light_field=dataclasses.replace(
                    sizes.bake.light_field, paths=sizes.paths, batch=sizes.paths
                ),
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
    "light field": _light_field,
}
