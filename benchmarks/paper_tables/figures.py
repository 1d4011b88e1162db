"""Figures: the pipeline on our own data, and converged images of the stand-ins in a room."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from benchmarks.paper_tables.cells import Cell, Measured
from benchmarks.paper_tables.found import Found
from benchmarks.paper_tables.pictures import strip
from benchmarks.paper_tables.scales import LAMPS, Scale
from benchmarks.paper_tables.scoring import network_view, test_views
from benchmarks.paper_tables.work import Work
from lumitree.asset.asset import Asset
from lumitree.asset.file import load
from lumitree.core.images import auto_exposure, tonemap

OVERVIEW = "overview"
_PATH_DEPTH = 16
_LARGEST_TILE = 320


def cells(scale: Scale) -> list[Cell]:
    """The overview, and an image of each lamp."""
    figure = {"width": scale.figure[0], "samples": scale.figure[1]}
    network = {"train": scale.train, "network": scale.network, "depth": scale.network_depth}
    network |= {"samples_per_leaf": scale.samples_per_leaf, "test": scale.test}
    first = scale.lamps[0]
    overview = Cell(
        OVERVIEW,
        9,
        {"lamp": first, **figure, **network},
        sum(scale.minutes),
        lambda work: measure_overview(work, first),
    )
    rooms = [
        Cell(
            f"room-{lamp}",
            9,
            {"lamp": lamp, **figure, "direct": scale.direct},
            scale.minutes[1] + 3,
            lambda work, lamp=lamp: measure_room(work, lamp),
        )
        for lamp in scale.lamps
    ]
    return [overview, *rooms]


def measure_overview(work: Work, lamp: str) -> Measured:
    """A view, the network's, its octree's, and the octree in a room."""
    from lumitree.fit.network.trained_field import load_field
    from lumitree.rendering.asset_views import baked_view

    config = work.scale.network
    run, asset = work.run(lamp, config), load(work.network_asset(lamp, config).path)
    dataset = test_views(work, lamp)
    frame = dataset.manifest.frames[0]
    view = next(iter(dataset.views()))
    network, _ = network_view(load_field(run.path), dataset, frame)
    octree, _ = baked_view(asset, dataset.manifest, frame)
    exposure = auto_exposure(view.radiance)
    tiles = [tonemap(each, exposure) for each in (view.radiance, network, octree)]
    tiles.append(_room(asset, work.scale))
    side = min(_LARGEST_TILE, dataset.manifest.resolution)
    sheet = strip([_of_height(tile, side) for tile in tiles])
    return Measured({"leaves": asset.num_leaves}, {"sheet": sheet})


def measure_room(work: Work, lamp: str) -> Measured:
    """A converged image by the light field and the geometry."""
    asset = load(work.direct_asset(lamp, work.scale.direct).path)
    return Measured(
        {"has_geometry": asset.geometry is not None}, {"room": _room(asset, work.scale)}
    )


def _room(asset: Asset, scale: Scale) -> NDArray[np.uint8]:
    import mitsuba as mi

    from benchmarks.common.demo_lamps import placed
    from lumitree.rendering.passes import Budget, render_passes

    width, samples = scale.figure
    scene = placed(asset, width, appearance="geometry")
    integrator = mi.load_dict({"type": "lumitree_path", "max_depth": _PATH_DEPTH})
    radiance: Any = render_passes(scene, integrator, Budget(samples), seed=0).radiance
    brightness = radiance.mean(-1)
    return tonemap(radiance, 0.18 / float(np.median(brightness[brightness > 0])))


def _of_height(tile: NDArray[np.uint8], height: int) -> NDArray[np.uint8]:
    width = round(tile.shape[1] * height / tile.shape[0])
    return np.asarray(Image.fromarray(tile).resize((width, height)))


def section(found: Found) -> str:
    """The images that there are."""
    images = found.image(
        OVERVIEW,
        "sheet",
        "A captured view, the trained network, its octree, and the octree in a room",
    )
    rooms = [found.image(f"room-{lamp}", "room", lamp) for lamp in LAMPS]
    if any(rooms):
        images += "In the demonstration's room, by light field and geometry:\n\n"
    return "".join([images, *rooms]) or f"{found.missing.capitalize()}.\n"
