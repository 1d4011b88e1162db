"""NumPy arrays on the device."""

import numpy as np
import pytest


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
