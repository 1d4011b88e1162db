"""Small exitant light fields that several tests share."""

import numpy as np

from lumitree.asset.exitant import ExitantField, TracedPaths, make_exitant_field


def random_exitant(
    seed: int,
    *,
    depth: int = 2,
    resolution: int = 4,
    count: int = 5,
    traced: TracedPaths | None = None,
) -> ExitantField:
    """A field of `count` random cells; about half of each cell's bins emit."""
    random = np.random.default_rng(seed)
    side = 1 << depth
    codes = random.choice(side**3, count, replace=False)
    cells = np.stack([codes % side, codes // side % side, codes // side**2], axis=1)
    intensity = random.exponential(3.0, (count, resolution**2, 3))
    intensity *= random.random((count, resolution**2, 1)) < 0.5
    intensity[:, 0] = 1
    return make_exitant_field(cells, intensity, depth, traced)


def assert_equal_fields(first: ExitantField, second: ExitantField) -> None:
    """Both hold the same numbers, of the same types."""
    for name in ("cells", "lit", "intensity"):
        one, other = getattr(first, name), getattr(second, name)
        assert one.dtype == other.dtype
        assert np.array_equal(one, other)
    for name in ("depth", "resolution", "scale", "traced"):
        assert getattr(first, name) == getattr(second, name)
