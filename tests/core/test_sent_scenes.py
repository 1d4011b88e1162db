"""Values for other processes."""

import numpy as np
import pytest

from lumitree.core.packing import packed, unpacked
from lumitree.errors import LumitreeError


def test_values_are_unpacked():
    value = {"a": (1, "b"), "c": np.arange(3)}
    found = unpacked(packed(value, "the scene", "a path"))
    assert found["a"] == value["a"]
    assert np.array_equal(found["c"], value["c"])
    assert packed(value, "the scene", "a path") == packed(value, "the scene", "a path")


@pytest.mark.parametrize(
    "kind", ["ScalarTransform4f", "ScalarProjectiveTransform4f", "Transform4f", "ScalarTransform3f"]
)
def test_transforms_are_unpacked(mi, kind):
    transform = getattr(mi, kind)().translate([1, 2, 3][: int(kind[-2]) - 1])
    transform = transform @ type(transform)().scale(2.5)
    (found,) = unpacked(packed([transform], "the scene", "a path"))
    assert type(found) is type(transform)
    assert np.array_equal(np.array(found.matrix), np.array(transform.matrix))
    inverse = np.array(transform.inverse().matrix)
    assert np.array(found.inverse().matrix) == pytest.approx(inverse, rel=1e-5, abs=1e-6)


def test_arrays_and_points_of_mitsuba_are_unpacked(mi):
    value = [mi.ScalarPoint3f(1, 2, 3), mi.TensorXf(np.ones((2, 3)))]
    point, tensor = unpacked(packed(value, "the scene", "a path"))
    assert list(point) == [1, 2, 3]
    assert np.array(tensor).tolist() == np.ones((2, 3)).tolist()


def test_other_objects_are_refused(mi):
    expected = r"^the scene cannot be sent to other processes \(.+\); give a path$"
    for value in (lambda: 0, mi.load_dict({"type": "sphere"})):
        with pytest.raises(LumitreeError, match=expected):
            packed({"a": value}, "the scene", "a path")
