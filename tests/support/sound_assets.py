"""Whether an asset is what its invariants say."""

import numpy as np

from lumitree.asset.asset import MAX_DENSITY, MAX_RADIANCE, MAX_TREE_DEPTH, MIN_RADIANCE
from lumitree.asset.light_field import MAX_BINS, MAX_DEPTH, MAX_RESOLUTION, unpack
from lumitree.core.frames import MAX_SCALE, MIN_HALF_EXTENT, MIN_SCALE, similarity_scale
from lumitree.core.harmonics import MAX_L, num_coefficients
from lumitree.core.reading import MAX_LABEL
from lumitree.core.transmittance import LAWS
from support.reference_field import leaf_boxes

DTYPES = {"children": np.int32, "density": np.float32, "coefficients": np.float16}
LIGHT_FIELD_DTYPES = {"cells": np.uint8, "lit": np.uint8, "intensity": np.uint32}


def assert_sound(asset):
    """An asset, with its light field and its spectrum, is what a renderer may rely on."""
    assert type(asset.tree_depth) is int
    assert 1 <= asset.tree_depth <= MAX_TREE_DEPTH
    assert type(asset.l_max) is int
    assert 0 <= asset.l_max <= MAX_L
    assert asset.law in LAWS
    assert type(asset.max_radiance) is float
    assert MIN_RADIANCE <= asset.max_radiance <= MAX_RADIANCE
    assert asset.frame.half_extents.shape == (3,)
    assert asset.frame.half_extents.min() >= MIN_HALF_EXTENT
    assert abs(asset.frame.half_extents.max() - 1) < 1e-6
    assert np.abs(asset.frame.world_from_local).max() <= MAX_SCALE
    assert similarity_scale(asset.frame.world_from_local) >= MIN_SCALE
    assert type(asset.luminaire) is str
    assert asset.luminaire.isprintable()
    assert len(asset.luminaire) <= MAX_LABEL
    for name, dtype in DTYPES.items():
        assert getattr(asset, name).dtype == dtype
    assert asset.density.min(initial=0) >= 0
    assert asset.density.max(initial=0) <= MAX_DENSITY
    assert asset.coefficients.shape == (asset.num_leaves, 3, num_coefficients(asset.l_max))
    assert np.isfinite(asset.coefficients).all()
    lower, upper = leaf_boxes(asset)
    sides = np.rint(np.log2(2 / (upper - lower)))
    assert sides.max(initial=1) <= asset.tree_depth
    # Leaves do not overlap: together they fill at most the cube.
    assert ((upper - lower) ** 3)[:, 0].sum() <= 8
    if asset.light_field is not None:
        assert_sound_field(asset.light_field)
    if asset.spectrum is not None:
        assert asset.spectrum.power.dtype == np.float32
        assert asset.spectrum.power.shape == (471,)
        assert asset.spectrum.power.min() >= 0
        assert asset.spectrum.power.max() == 1
        assert 0 < asset.spectrum.share <= 1


def assert_sound_field(field):
    """Values that the emitter of `rendering` computes with are in range."""
    assert type(field.depth) is type(field.resolution) is int
    assert type(field.scale) is float
    assert 1 <= field.depth <= MAX_DEPTH
    assert field.resolution in [2**power for power in range(2, 10)]
    assert field.resolution <= MAX_RESOLUTION
    for name, dtype in LIGHT_FIELD_DTYPES.items():
        assert getattr(field, name).dtype == dtype
    count, bins = len(field.cells), field.resolution**2
    assert 0 < count * bins <= MAX_BINS
    assert field.cells.shape == (count, 3)
    assert field.cells.max() < 2**field.depth
    assert len(np.unique(field.cells, axis=0)) == count
    dense = field.dense(unpack(field.intensity).sum(axis=1))
    assert dense.shape == (count, bins)
    assert (dense.sum(axis=1) > 0).all()
    intensity = (unpack(field.intensity) * field.scale).astype(np.float32)
    assert np.isfinite(intensity).all()
    assert (intensity.max(axis=1) > 0).all()
