"""Typed arrays of a glTF file."""

import numpy as np
from numpy.typing import NDArray

from lumitree.errors import shown
from lumitree.lamp.importers.gltf.container import Document
from lumitree.lamp.importers.gltf.item import MAX_MAGNITUDE, Item

MAX_DECODED_BYTES = 2**30
# Largest number of elements of an accessor without data. They are zero, except for those that a
# sparse accessor replaces.
MAX_UNSTORED = 2**20
_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_LENGTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


class Accessors:
    """Decodes accessors, each once."""

    def __init__(self, document: Document) -> None:
        self._document = document
        self._decoded: dict[int, NDArray[np.generic]] = {}
        self._bytes = 0

    def floats(self, index: int, lengths: tuple[int, ...]) -> NDArray[np.float64]:
        """[count, L] finite numbers, with normalised integers mapped to [0, 1] or [-1, 1].

        L must be one of `lengths`.
        """
        item = self._document.entry("accessors", index)
        stored = self._array(index, item, lengths)
        values = stored.astype(np.float64)
        if not (np.abs(values) <= MAX_MAGNITUDE).all():
            raise item.error(f"holds values that are not finite, or beyond {MAX_MAGNITUDE:g}")
        if item.flag("normalized") and stored.dtype.kind in "iu":
            values = np.maximum(values / np.iinfo(np.dtype(stored.dtype).name).max, -1.0)
        return values

    def integers(self, index: int) -> NDArray[np.int64]:
        """[count] of an accessor of unsigned integers."""
        item = self._document.entry("accessors", index)
        stored = self._array(index, item, (1,))
        if stored.dtype.kind != "u":
            raise item.error("holds indices that are not unsigned integers")
        return stored[:, 0].astype(np.int64)

    def count(self, index: int) -> int:
        """Number of elements that the accessor states."""
        return self._document.entry("accessors", index).integer("count", low=1)

    def _array(self, index: int, item: Item, lengths: tuple[int, ...]) -> NDArray[np.generic]:
        kind = item.string("type", "none")
        if _LENGTHS.get(kind) not in lengths:
            raise item.error(f"is of type {shown(kind, 20)!r}; expected {lengths} components")
        if index not in self._decoded:
            self._decoded[index] = self._decode(item, _LENGTHS[kind])
        return self._decoded[index]

    def _decode(self, item: Item, length: int) -> NDArray[np.generic]:
        count = item.integer("count", low=1)
        dtype = _dtype(item)
        self._bytes += count * length * dtype.itemsize
        if self._bytes > MAX_DECODED_BYTES:
            raise item.error(
                f"claims {count} elements, which brings the model to {self._bytes} bytes of "
                f"geometry; at most {MAX_DECODED_BYTES}"
            )
        if (view := item.index("bufferView")) is not None:
            values = self._strided(item, view, dtype, count, length)
        elif count <= MAX_UNSTORED:
            values = np.zeros((count, length), dtype)
        else:
            raise item.error(
                f"has {count} elements and no data; at most {MAX_UNSTORED} may be left out"
            )
        if "sparse" in item:
            values = self._with_sparse(item.item("sparse"), values)
        return values

    def _strided(
        self, item: Item, view: int, dtype: np.dtype, count: int, length: int
    ) -> NDArray[np.generic]:
        data, stride = self._document.view(view)
        size = dtype.itemsize * length
        step = size if stride is None else stride
        if step < size:
            raise item.error(f"has elements of {size} bytes, {step} bytes apart")
        start = item.integer("byteOffset", 0)
        if start + step * (count - 1) + size > len(data):
            raise item.error(
                f"claims {count} elements of {size} bytes, but its buffer view has only "
                f"{max(len(data) - start, 0)} bytes"
            )
        return np.ndarray((count, length), dtype, data, start, (step, dtype.itemsize)).copy()

    def _with_sparse(self, sparse: Item, values: NDArray[np.generic]) -> NDArray[np.generic]:
        """`values` with some of its elements replaced."""
        count = sparse.integer("count", low=1)
        if count > len(values):
            raise sparse.error(f"replaces {count} of {len(values)} elements")
        places, new = sparse.item("indices"), sparse.item("values")
        dtype = _dtype(places)
        at = self._strided(places, places.integer("bufferView"), dtype, count, 1)[:, 0]
        if dtype.kind != "u" or at.max() >= len(values):
            raise sparse.error(f"replaces elements that are not among {len(values)}")
        values[at.astype(np.int64)] = self._strided(
            new, new.integer("bufferView"), np.dtype(values.dtype), count, values.shape[1]
        )
        return values


def _dtype(item: Item) -> np.dtype:
    component = item.integer("componentType")
    if component not in _COMPONENTS:
        raise item.error(f"has componentType {component}; expected one of {sorted(_COMPONENTS)}")
    return np.dtype(_COMPONENTS[component])
