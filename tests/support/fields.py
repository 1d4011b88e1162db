"""Small fields that many tests share."""

import numpy as np

from lumitree.asset.asset import Asset
from lumitree.asset.file import as_stored
from lumitree.core.frames import LocalFrame
from lumitree.core.harmonics import num_coefficients
from lumitree.octree.build import build_children, child_cells
from support.reference_field import leaf_boxes


def make_asset(
    cells,
    levels,
    density,
    coefficients,
    *,
    tree_depth=4,
    law="linear",
    half_extents=(1, 1, 1),
    world_from_local=None,
    **fields,
):
    """Asset with the given leaves; coefficients [M, 3, K]."""
    world_from_local = np.eye(4) if world_from_local is None else world_from_local
    coefficients = np.asarray(coefficients, np.float16)
    l_max = int(np.sqrt(coefficients.shape[-1])) - 1
    settings = {
        "max_radiance": 10.0,
        "frame": LocalFrame(half_extents, world_from_local),
        "luminaire": "test",
        **fields,
    }
    return Asset(
        children=build_children(cells, levels),
        density=np.asarray(density, np.float32),
        coefficients=coefficients,
        tree_depth=tree_depth,
        l_max=l_max,
        law=law,
        **settings,
    )


def random_asset(seed, *, tree_depth=4, l_max=2, law="linear", density_scale=2.0, **fields):
    """Asset with leaves of several levels, about a third of the volume filled.

    It is as a file holds it, so that saving does not change it.
    """
    random = np.random.default_rng(seed)
    cells, levels = [], []
    stack = [((0, 0, 0), 0)]
    while stack:
        cell, level = stack.pop()
        kind = random.random()
        if level > 0 and (kind < 0.25 or (level == tree_depth and kind < 0.5)):
            cells.append(cell)
            levels.append(level)
        elif level < tree_depth and (level == 0 or kind < 0.6):
            stack += [(child, level + 1) for child in child_cells(np.array(cell))]
    density = random.exponential(density_scale, len(cells))
    coefficients = random.normal(0, 1, (len(cells), 3, num_coefficients(l_max)))
    return as_stored(
        make_asset(cells, levels, density, coefficients, tree_depth=tree_depth, law=law, **fields)
    )


def uniform_asset(density, radiance, *, law="linear", max_radiance=10.0, **fields):
    """Asset whose whole cube has one density and emits `radiance` [3] in every direction."""
    ratio = np.clip(np.asarray(radiance) / max_radiance, 1e-4, 1 - 1e-4)
    dc = np.log(ratio / (1 - ratio)) / 0.28209479177387814
    coefficients = np.tile(dc[None, :, None], (8, 1, 1))
    return make_asset(
        child_cells(np.zeros(3, int)),
        np.ones(8),
        np.full(8, density),
        coefficients,
        tree_depth=1,
        law=law,
        max_radiance=max_radiance,
        **fields,
    )


def leaf_field(asset):
    """Trainable field of an asset; leaf i keeps its index."""
    from lumitree.fit.octree.leaf_field import LeafField

    lower, upper = leaf_boxes(asset)
    side = (upper - lower)[:, :1]
    return LeafField(
        np.rint((lower + 1) / side).astype(np.int64),
        np.rint(np.log2(2 / side[:, 0])).astype(np.int64),
        np.log(asset.density.astype(np.float64)),
        asset.coefficients.astype(np.float32).ravel(),
        tree_depth=asset.tree_depth,
        l_max=asset.l_max,
        law=asset.law,
        half_extents=asset.frame.half_extents,
    )
