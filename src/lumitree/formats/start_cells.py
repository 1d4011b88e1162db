"""Places where light starts, divided between the cells of a light field."""

import itertools
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from lumitree.core.frames import LocalFrame

Array = NDArray[np.float64]
Codes = NDArray[np.int64]
Widths = tuple[float | None, float | None, float | None]


class StartCells:
    """The cells of a grid of 2**depth cells a side that are in a lamp's box.

    `middles` has for each axis the middles of what is inside the box, ascending, in local units.
    """

    def __init__(self, frame: LocalFrame, depth: int) -> None:
        self.side = 1 << depth
        edges = np.linspace(-1, 1, self.side + 1)
        inside = [np.clip(edges, -half, half) for half in frame.half_extents]
        self._edges = inside
        self._cells = [np.flatnonzero(np.diff(each) > 0) for each in inside]
        self.middles = [(each[1:] + each[:-1])[np.diff(each) > 0] / 2 for each in inside]

    def around(
        self, start: Array, widths: Widths = (None, None, None)
    ) -> Iterator[tuple[Codes, Array]]:
        """Index [...] (x slowest) of each of the eight cells around a start, and its part of it.

        Starts [..., 3] and widths are in local units. A start stands for a width along each axis,
        at most the width of a cell, and each cell gets what of it is inside. With None, the mean
        place of the eight cells is the start.
        """
        ends = [
            self._neighbours(start[..., axis], axis)
            if width is None
            else self._overlapped(start[..., axis], axis, width)
            for axis, width in enumerate(widths)
        ]
        for x, y, z in itertools.product(*ends):
            yield (x[0] * self.side + y[0]) * self.side + z[0], x[1] * y[1] * z[1]

    def coordinates(self, codes: Codes) -> Codes:
        """Coordinates [C, 3] of cells by their indices [C]."""
        return np.stack(np.unravel_index(codes, (self.side,) * 3), axis=1)

    def _overlapped(self, place: Array, axis: int, width: float) -> list[tuple[Codes, Array]]:
        """The two cells that an interval around a coordinate may be in, and its parts there."""
        cells, edges = self._cells[axis], self._edges[axis]
        first = np.clip(place - width / 2, edges[0], edges[-1])
        lower = np.clip(np.searchsorted(edges, first, "right") - 1, cells[0], cells[-1])
        upper = np.minimum(lower + 1, cells[-1])
        part = np.clip((place + width / 2 - edges[lower + 1]) / width, 0, 1)
        return [(lower, 1 - part), (upper, part)]

    def _neighbours(self, place: Array, axis: int) -> list[tuple[Codes, Array]]:
        """The two cells whose middles are next to a coordinate, and their weights."""
        cells, middles = self._cells[axis], self.middles[axis]
        at = np.interp(place, middles, np.arange(len(cells)))
        lower = np.minimum(at.astype(np.int64), max(len(cells) - 2, 0))
        upper = np.minimum(lower + 1, len(cells) - 1)
        return [(cells[lower], 1 - (at - lower)), (cells[upper], at - lower)]
