"""NumPy arrays on the device."""

import subprocess
import sys

import numpy as np
import pytest

# An array that ends where memory does, and all of it read.
BEFORE_A_WALL = """
import ctypes, mmap
import numpy as np
from lumitree.core.backend import load_mitsuba
from lumitree.core.device import on_device
mi = load_mitsuba("llvm_ad_rgb")
page = mmap.PAGESIZE
memory = mmap.mmap(-1, 17 * page)
address = np.frombuffer(memory, np.uint8).ctypes.data
values = np.frombuffer(memory, np.float32, offset=16, count=16 * page // 4 - 4)
assert ctypes.CDLL(None).mprotect(ctypes.c_void_p(address + 16 * page), page, 0) == 0
print(np.array(on_device(mi.Float, values) + 1).sum() == len(values))
points = values.reshape(3, -1)
print(np.array(on_device(mi.Point3f, points.T) + 1).sum() == points.size)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="no mprotect")
def test_nothing_is_read_beyond_an_arrays_end():
    run = subprocess.run([sys.executable, "-c", BEFORE_A_WALL], capture_output=True, text=True)
    assert (run.returncode, run.stdout) == (0, "True\nTrue\n"), run.stderr


def test_values_are_copied_flattened_and_converted(mi):
    from lumitree.core.device import on_device

    values = np.arange(6, dtype=np.float64).reshape(2, 3)
    floats, whole = on_device(mi.Float, values), on_device(mi.UInt32, values)
    values[:] = -1
    assert np.array_equal(floats, np.arange(6))
    assert np.array(whole).dtype == np.uint32
    assert np.array_equal(whole, np.arange(6))
    assert np.array_equal(on_device(mi.Float, [0.5]), [0.5])


def test_vectors_have_a_row_each(mi):
    from lumitree.core.device import on_device

    values = np.arange(12.0).reshape(4, 3)
    assert np.array_equal(on_device(mi.Point3f, values), values.T)
    assert np.array_equal(on_device(mi.Vector3i, values.tolist()), values.T)
    with pytest.raises(ValueError, match=r"\[N, 2\]"):
        on_device(mi.Point2f, values)


def test_kernels_do_not_depend_on_where_numpy_puts_an_array(mi):
    """An array at an odd address is read by other instructions: by another kernel."""
    from lumitree.core.device import on_device

    copies = [on_device(mi.Float, np.arange(count)).numpy() for count in range(1, 40)]
    assert [copy.ctypes.data % 64 for copy in copies] == [0] * len(copies)
