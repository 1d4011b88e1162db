"""NumPy arrays on the device."""

import dataclasses
import gc
import threading
import weakref

import numpy as np
import pytest

from support.kernels import kernels_of


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


def test_shared_data_are_made_once_and_live_as_long_as_their_owner(mi):
    """Also if making one makes it again meanwhile: the first copy is kept."""
    from lumitree.core.device import shared

    class Owner:
        pass

    owners = [Owner(), Owner()]
    inner = []

    def make():
        if not inner:
            inner.append(None)
            inner.append(shared(owners[0], "light", lambda: [1]))
        return [2]

    made = shared(owners[0], "light", make)
    assert made is inner[1] == [1]
    assert shared(owners[0], "light", make) is made
    assert shared(owners[0], "field", lambda: [3]) == [3]
    assert shared(owners[1], "light", lambda: [4]) == [4]
    owner = weakref.ref(owners[0])
    owners.clear()
    gc.collect()
    assert owner() is None


def test_the_copies_of_an_asset_do_not_keep_it(mi):
    """Its field, light and tables."""
    from lumitree.rendering.device import DeviceAsset
    from support.fields import random_asset
    from support.light_fields import random_light_field

    asset = dataclasses.replace(random_asset(0), light_field=random_light_field(0))
    device = DeviceAsset(asset)
    assert device.field is device.field
    assert device.stored_light(False).table is device.stored_light(False).table
    assert DeviceAsset(asset).inside_light(False) is device.inside_light(False)
    owner = weakref.ref(asset)
    del asset, device
    gc.collect()
    assert owner() is None


def test_arrays_one_after_the_other_and_their_derivatives(mi):
    import drjit as dr

    from lumitree.core.device import concatenate

    parts = [mi.Float(1, 2, 3), mi.Float(4), mi.Float(), mi.Float(5, 6)]
    dr.enable_grad(parts[0])
    joined = concatenate(parts)
    assert np.array_equal(joined, [1, 2, 3, 4, 5, 6])
    dr.backward(dr.square(joined))
    assert np.array_equal(parts[0].grad, [2, 4, 6])


def test_kernels_do_not_depend_on_numbers_of_lanes_or_seeds(mi):
    from lumitree.core.device import as_rows, channel_mean, concatenate, random_numbers

    def compute(count, seed):
        random = random_numbers(count, seed)
        colour = mi.Color3f(*(random.next_float32() for _ in range(3)))
        mean = channel_mean(colour)
        rows = as_rows(colour)
        assert np.array(mean) == pytest.approx(rows.mean(axis=1))
        concatenate([mean, mi.Float(mean)]).numpy()

    first = kernels_of(lambda: compute(100, 1))
    assert first
    assert kernels_of(lambda: compute(117, 2**40)) == first


def test_shared_data_of_another_thread_can_be_used(mi):
    """Mitsuba creates plugins in threads, whose variables are of later scopes."""
    import drjit as dr

    from lumitree.core.device import shared

    class Owner:
        pass

    owner = Owner()
    dr.detail.new_scope(dr.backend_v(mi.Float))

    def make():
        dr.detail.new_scope(dr.backend_v(mi.Float))
        shared(owner, "values", lambda: mi.Float(1, 2) + 1)

    thread = threading.Thread(target=make)
    thread.start()
    thread.join()
    assert np.array_equal(2 * shared(owner, "values", lambda: None), [4, 6])
