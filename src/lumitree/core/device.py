"""NumPy arrays on the device.

Dr.Jit is imported when it is used. Modules that import this one are imported before
`load_mitsuba`, which explains what is missing before Dr.Jit does.
"""

import threading
import weakref
from collections.abc import Callable, Hashable, Iterable
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    import mitsuba as mi

# Dr.Jit may read this many values beyond an array's end: a packet of the widest vector unit.
_PACKET = 64
# Bytes. Dr.Jit compiles a different kernel for unaligned arrays, and NumPy aligns only some.
_ALIGNMENT = 64

T = TypeVar("T")
_LOCK = threading.Lock()
_SHARED: weakref.WeakKeyDictionary[object, dict[Hashable, Any]] = weakref.WeakKeyDictionary()


def shared(owner: object, key: Hashable, make: Callable[[], T]) -> T:
    """Device data of an owner, such as an asset: made on first use in the variant that is set.

    It lives as long as the owner, to which it must not refer.

    Args:
        key: that stands for it among the owner's data.
        make: function that makes it.
    """
    import drjit as dr
    import mitsuba as mi

    with _LOCK:
        known = _SHARED.setdefault(owner, {})
    key, backend = (str(mi.variant()), key), dr.backend_v(mi.Float)
    if key not in known:
        # Mitsuba creates plugins in parallel, and a thread that waits for the device may create
        # others meanwhile. So the lock is not held here; of two copies, the first is kept.
        made = make()
        known.setdefault(key, (made, dr.detail.scope(backend)))
    made, scope = known[key]
    # Such a thread has a scope of its own, and may read variables of earlier scopes only.
    if scope > dr.detail.scope(backend):
        dr.detail.new_scope(backend)
    return made


def parameter(kind: Callable[..., T], *values: float) -> T:
    """Small device array of the numbers given, which kernels read from memory.

    Lamps whose numbers are parameters share one kernel. A number in the code of a kernel would make
    Dr.Jit compile another one for each lamp.

    Args:
        kind: type of the result, such as `mi.Float` or `mi.Point3f`.
        values: its components.
    """
    import drjit as dr

    result = kind(*values)
    dr.make_opaque(result)
    return result


def random_numbers(count: int, seed: int) -> "mi.PCG32":
    """Generators of `count` independent streams, whose seed is a `parameter`."""
    import mitsuba as mi

    return mi.PCG32(count, initstate=parameter(mi.UInt64, seed))


def channel_mean(values: Any) -> "mi.Float":
    """Mean of the components of a vector, such as a colour, for each lane.

    `dr.mean` of Dr.Jit 1.5 puts the number of lanes into the code of the kernel.
    """
    import drjit as dr

    return dr.sum(values) / len(values)


def concatenate(arrays: Iterable[T]) -> T:
    """Flat device arrays, one after the other; derivatives pass through.

    `dr.concat` of Dr.Jit 1.5 puts the lengths of the arrays into the code of kernels.
    """
    import drjit as dr
    import mitsuba as mi

    parts = list(arrays)
    result = dr.zeros(type(parts[0]), sum(map(dr.width, parts)))
    parts = [part for part in parts if dr.width(part)]
    first = 0
    for part in parts:
        index = parameter(mi.UInt32, first) + dr.arange(mi.UInt32, dr.width(part))
        dr.scatter(result, part, index)
        first += dr.width(part)
    return result


def as_rows(vectors: Any) -> NDArray[np.float64]:
    """Dr.Jit vectors of three components as an array [N, 3]."""
    import drjit as dr

    # By one kernel: otherwise each component would trace all paths again.
    dr.eval(vectors)
    # Each by itself: the number of vectors would be a part of a kernel's code.
    components = (np.array(each, np.float64) for each in vectors)
    return np.array(np.broadcast_arrays(*components)).T


def transforms_as_parameters(shapes: "Iterable[mi.Shape]") -> None:
    """Let kernels read the transforms of rectangles (of some mi.Shape) from memory.

    Mitsuba 3.9 does so for all other shapes, see `parameter`.
    """
    import drjit as dr
    import mitsuba as mi

    for shape in shapes:
        if shape.class_name() == "Rectangle":
            values = mi.traverse(shape)
            dr.make_opaque(values["to_world"])
            values.set_dirty("to_world")
            values.update()


def on_device(kind: Callable[..., T], values: ArrayLike) -> T:
    """Device array of a copy of some values, converted.

    Dr.Jit 1.5 reads NumPy arrays without copying them, and in whole packets, so it also reads
    memory beyond their end. If that memory is not mapped, the process is killed. It also compiles
    one kernel for arrays that begin at a multiple of 64 bytes, and another for all others. Every
    NumPy array therefore goes to the device through this function, whose copy is aligned and
    followed by padding.

    Args:
        kind: type of the result: `mi.Float` or another flat array, or vectors such as `mi.Point3f`.
        values: numbers, which are flattened; for vectors of D components [N, D].
    """
    import drjit as dr

    if dr.depth_v(kind) == 1:
        return kind(_padded(np.ravel(values), kind))
    columns = np.asarray(values)
    if columns.ndim != 2 or columns.shape[1] != dr.size_v(kind):
        raise ValueError(f"values {columns.shape}; expected [N, {dr.size_v(kind)}]")
    component = dr.value_t(kind)
    return kind(*(component(_padded(column, component)) for column in columns.T))


def _padded(values: NDArray[np.generic], kind: object) -> NDArray[np.generic]:
    """An aligned copy, followed by memory that may be read."""
    import drjit as dr

    dtype = np.dtype(dr.type_v(kind).name.lower())
    memory = np.empty(_ALIGNMENT + (len(values) + _PACKET) * dtype.itemsize, np.uint8)
    start = -memory.ctypes.data % _ALIGNMENT
    copy = memory[start : start + len(values) * dtype.itemsize].view(dtype)
    copy[:] = values
    return copy
