"""Small light fields that several tests share."""

import dataclasses

import numpy as np

from lumitree.asset.light_field import (
    LightField,
    LightInside,
    TracedPaths,
    make_light_field,
    pack,
    pack_part,
    unpack,
)
from lumitree.octree.build import morton


def random_light_field(
    seed: int,
    *,
    depth: int = 2,
    resolution: int = 4,
    count: int = 5,
    traced: TracedPaths | None = None,
) -> LightField:
    """A field of `count` random cells; about half of each cell's bins emit."""
    random = np.random.default_rng(seed)
    side = 1 << depth
    codes = random.choice(side**3, count, replace=False)
    cells = np.stack([codes % side, codes // side % side, codes // side**2], axis=1)
    intensity = random.exponential(3.0, (count, resolution**2, 3))
    intensity *= random.random((count, resolution**2, 1)) < 0.5
    intensity[:, 0] = 1
    bent = intensity * random.choice([0, 0.3, 1], (count, resolution**2, 1))
    return make_light_field(cells, intensity, depth, traced, bent=bent)


def random_inside(seed: int, field: LightField) -> LightInside:
    """Light inside the box for a field: two more cells, light that ends in half of the entries."""
    random = np.random.default_rng(seed)
    side, coarse = 1 << field.depth, field.resolution // 2
    own = field.cells.astype(np.int64) @ [1, side, side**2]
    others = random.choice(np.setdiff1d(np.arange(side**3), own), 2, replace=False)
    codes = np.concatenate([own, others])
    cells = np.stack([codes % side, codes // side % side, codes // side**2], axis=1)
    emits = np.unpackbits(field.lit, axis=1).reshape(-1, coarse, 2, coarse, 2).any(axis=(2, 4))
    lit = np.ones((len(cells), coarse**2), bool)
    lit[: len(own)] = emits.reshape(len(own), -1) | (random.random(lit[: len(own)].shape) < 0.2)
    order = np.argsort(morton(cells))
    cells, lit = cells[order], lit[order]
    count = lit.sum()
    colours = random.random((count, 3)) * (random.random((count, 1)) < 0.5)
    reach = -np.sort(-random.random((4, 3)), axis=1)
    return LightInside(
        cells=cells.astype(np.uint8),
        lit=np.packbits(lit, axis=1),
        intensity=pack(colours),
        bent=random_part(random, pack(colours)),
        reach=random.integers(4, size=count, dtype=np.uint8),
        bent_reach=random.integers(4, size=count, dtype=np.uint8),
        distances=np.array([0, 0.1, 0.5, 2], np.float32),
        reach_curves=np.append(reach, np.zeros((4, 1)), axis=1).astype(np.float32),
        scale=2.5,
    )


def random_part(random: np.random.Generator, packed: np.ndarray) -> np.ndarray:
    """Parts of packed colours: some are 0, some all, some between."""
    return pack_part(random.choice([0, 0.3, 1], (len(packed), 1)) * unpack(packed), packed)


def with_inside(seed: int, field: LightField) -> LightField:
    """A field with light inside its box."""
    return dataclasses.replace(field, inside=random_inside(seed, field))


def assert_equal_fields(first: LightField | None, second: LightField | None) -> None:
    """Both hold the same numbers, of the same types."""
    assert first is not None
    assert second is not None
    for name in ("cells", "lit", "intensity", "bent"):
        one, other = getattr(first, name), getattr(second, name)
        assert one.dtype == other.dtype
        assert np.array_equal(one, other)
    for name in ("depth", "resolution", "scale", "traced"):
        assert getattr(first, name) == getattr(second, name)
    assert (first.inside is None) == (second.inside is None)
    if first.inside is not None and second.inside is not None:
        for name in (field.name for field in dataclasses.fields(LightInside)):
            one, other = getattr(first.inside, name), getattr(second.inside, name)
            assert np.asarray(one).dtype == np.asarray(other).dtype
            assert np.array_equal(one, other)
