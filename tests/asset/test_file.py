"""The file format: byte-exact, and nothing damaged gets in."""

import json
import struct

import numpy as np
import pytest
import safetensors.numpy
from hypothesis import given, settings
from hypothesis import strategies as st

from fields import random_asset
from lumitree.asset.file import load, save
from lumitree.errors import LumitreeError


@pytest.fixture(scope="module")
def original(tmp_path_factory):
    path = tmp_path_factory.mktemp("asset") / "lamp.lumitree"
    save(random_asset(0, tree_depth=3, l_max=1), path)
    return path


def test_round_trip_byte_for_byte(original, tmp_path):
    save(load(original), tmp_path / "again.lumitree")
    assert (tmp_path / "again.lumitree").read_bytes() == original.read_bytes()


def test_loaded_equals_saved(tmp_path):
    asset = random_asset(3, law="exponential", half_extents=np.array([0.25, 1.0, 0.5]))
    save(asset, tmp_path / "a.lumitree")
    again = load(tmp_path / "a.lumitree")
    for name in ("children", "density", "coefficients", "half_extents", "world_from_proxy"):
        assert np.array_equal(getattr(asset, name), getattr(again, name))
    for name in ("law", "l_max", "tree_depth", "max_radiance", "luminaire"):
        assert getattr(asset, name) == getattr(again, name)


@settings(deadline=None, max_examples=300)
@given(data=st.data())
def test_every_flipped_bit_is_noticed(original, tmp_path_factory, data):
    content = bytearray(original.read_bytes())
    bit = data.draw(st.integers(0, 8 * len(content) - 1))
    content[bit // 8] ^= 1 << bit % 8
    path = tmp_path_factory.getbasetemp() / "flipped.lumitree"
    path.write_bytes(content)
    with pytest.raises(LumitreeError, match="flipped") as caught:
        load(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("length", [0, 1, 7, 8, 9, 200, -1])
def test_truncated_files_are_refused(original, tmp_path, length):
    path = tmp_path / "cut.lumitree"
    path.write_bytes(original.read_bytes()[:length])
    with pytest.raises(LumitreeError, match=r"cut.lumitree"):
        load(path)


@pytest.mark.parametrize("size", [2**20 + 1, 2**40, 2**64 - 1])
def test_oversized_headers_are_refused(original, tmp_path, size):
    path = tmp_path / "big.lumitree"
    path.write_bytes(struct.pack("<Q", size) + original.read_bytes()[8:])
    with pytest.raises(LumitreeError, match=f"a header of {size} bytes"):
        load(path)


def rewrite(path, target, change_tensors=lambda t: None, change_text=lambda d: None):
    """A file whose checksum is right but whose content breaks an invariant."""
    from lumitree.asset.file import _digest

    tensors = {name: array.copy() for name, array in safetensors.numpy.load_file(path).items()}
    with safetensors.safe_open(path, framework="np") as file:
        description = json.loads(file.metadata()["lumitree"].partition(" ")[2])
    change_tensors(tensors)
    change_text(description)
    text = json.dumps(description)
    safetensors.numpy.save_file(tensors, target, {"lumitree": f"{_digest(text, tensors)} {text}"})


def put(name, index, value):
    def change(tensors):
        tensors[name][index(tensors) if callable(index) else index] = value

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (put("density", 0, np.nan), "density holds NaN"),
        (put("density", 0, -1), "negative"),
        (put("coefficients", (0, 0, 0), np.inf), "coefficients hold NaN or infinity"),
        (put("children", (0, 0), 10**6), "node index is out of range"),
        (put("children", lambda t: t["children"] < 0, -(10**6)), "leaf index is out of range"),
        (put("children", (-1, slice(None)), 0), "referenced exactly once"),
        (lambda t: t.pop("density"), "tensors"),
        (lambda t: t.update(density=t["density"].astype(np.float64)), "tensors"),
        (lambda t: t.update(density=t["density"][:-1]), "coefficients is"),
        (lambda t: t.update(children=t["children"].reshape(-1, 4)), "children is"),
        (lambda t: t.update(extra=t["density"]), "tensors"),
    ],
)
def test_broken_tensors_are_refused(original, tmp_path, change, message):
    rewrite(original, tmp_path / "bad.lumitree", change_tensors=change)
    with pytest.raises(LumitreeError, match=message):
        load(tmp_path / "bad.lumitree")


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("version", 2, "version 2, this lumitree reads 1"),
        ("format", "other", "format of the description is"),
        ("activation", "relu", "activation"),
        ("tree_depth", 11, "tree depth 11"),
        ("tree_depth", 1, "deeper than 1 levels"),
        ("tree_depth", "3", 'tree_depth of the description is "3"; expected an integer'),
        ("l_max", 2, "coefficients is"),
        ("law", "cubic", "law of the description"),
        ("max_radiance", -1, "maximum radiance"),
        ("half_extents", [1, 1], "half_extents of the description is a list"),
        ("half_extents", [0.5, 0.5, 0.5], "half_extents are"),
        ("world_from_proxy", np.diag([1.0, 2, 1, 1]).tolist(), "shears"),
        ("world_from_proxy", [[1]], "4 x 4 numbers"),
    ],
)
def test_broken_descriptions_are_refused(original, tmp_path, key, value, message):
    rewrite(original, tmp_path / "bad.lumitree", change_text=lambda d: d.update({key: value}))
    with pytest.raises(LumitreeError, match=message) as caught:
        load(tmp_path / "bad.lumitree")
    assert "bad.lumitree" in str(caught.value)


def test_a_cycle_is_refused():
    from dataclasses import replace

    asset = random_asset(0, tree_depth=4)
    children = asset.children.copy()
    # Exchange two subtrees so that one contains its own parent.
    below = children[children[0][children[0] > 0][0]]
    grandchild = below[below > 0][0]
    child = children[0][children[0] > 0][0]
    children[0][children[0] == child] = 0
    slot = np.flatnonzero(children[grandchild] == 0)
    children[grandchild, slot[0] if len(slot) else 0] = child
    with pytest.raises(LumitreeError, match=r"not connected|exactly once"):
        replace(asset, children=children)


def test_other_files_are_refused(tmp_path):
    with pytest.raises(LumitreeError, match="does not exist"):
        load(tmp_path / "no.lumitree")
    safetensors.numpy.save_file({"x": np.zeros(3)}, tmp_path / "x.lumitree")
    with pytest.raises(LumitreeError, match="the header lacks"):
        load(tmp_path / "x.lumitree")
    (tmp_path / "code.lumitree").write_bytes(b"cos\nsystem\n(S'echo pwned'\ntR." * 9)
    with pytest.raises(LumitreeError, match=r"not a valid \.lumitree asset"):
        load(tmp_path / "code.lumitree")
