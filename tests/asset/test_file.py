"""The file format: nothing changes but by stated rounding, and nothing damaged gets in."""

import json
import struct
import zlib
from dataclasses import replace

import numpy as np
import pytest
import safetensors.numpy
from hypothesis import given, settings
from hypothesis import strategies as st

from lumitree.asset.asset import light_field_asset
from lumitree.asset.file import as_stored, load, save
from lumitree.asset.light_field import TracedPaths, make_light_field
from lumitree.asset.spectrum import EmittedSpectrum
from lumitree.errors import LumitreeError
from support import damage
from support.fields import make_asset, random_asset
from support.geometry_assets import small_geometry, with_geometry
from support.light_fields import assert_equal_fields, random_light_field, with_inside
from support.stored_arrays import change_field_arrays


@pytest.fixture(scope="module")
def original(tmp_path_factory):
    path = tmp_path_factory.mktemp("asset") / "lamp.lumitree"
    save(random_asset(0, tree_depth=3, l_max=1), path)
    return path


@pytest.fixture(scope="module")
def with_light_field(tmp_path_factory):
    """The same asset with a light field."""
    path = tmp_path_factory.mktemp("light") / "lamp.lumitree"
    save(replace(random_asset(0, tree_depth=3, l_max=1), light_field=random_light_field(0)), path)
    return path


@pytest.fixture(scope="module")
def light_field_only(tmp_path_factory):
    """An asset whose field is empty."""
    path = tmp_path_factory.mktemp("only") / "lamp.lumitree"
    save(light_field_asset(random_light_field(0), random_asset(0).frame, "test"), path)
    return path


@pytest.fixture(scope="module")
def with_gain(tmp_path_factory):
    """An asset with geometry and a gain."""
    path = tmp_path_factory.mktemp("gain") / "lamp.lumitree"
    save(replace(with_geometry(small_geometry()), light_factors=(0.5, 0.0, 2e3)), path)
    return path


@pytest.fixture(scope="module")
def with_spectrum(tmp_path_factory):
    """An asset with a light field, whose emitters have a spectrum."""
    path = tmp_path_factory.mktemp("spectrum") / "lamp.lumitree"
    frame = random_asset(0).frame
    save(light_field_asset(random_light_field(0), frame, "test", SPECTRUM), path)
    return path


@pytest.fixture(scope="module")
def lit_inside(tmp_path_factory):
    """An asset with a light field, light inside its box and geometry."""
    path = tmp_path_factory.mktemp("inside") / "lamp.lumitree"
    save(replace(with_geometry(small_geometry()), light_field=INSIDE), path)
    return path


INSIDE = with_inside(
    1, random_light_field(0, resolution=16, traced=TracedPaths(3, (1, 5), 64 * "0", 0.5))
)
SPECTRUM = EmittedSpectrum.of(np.random.default_rng(0).random(471), 0.75)
TRACED = {"count": 3, "seeds": [1, 5], "luminaire": 64 * "0", "noise": 0.5}


@pytest.mark.parametrize("noise", [0.25, None])
def test_the_record_of_light_paths_is_kept(tmp_path, noise):
    traced = TracedPaths(1 << 40, (0, 2, 2**31 - 1), 64 * "f", noise)
    asset = replace(random_asset(0), light_field=random_light_field(0, traced=traced))
    save(asset, tmp_path / "lamp.lumitree")
    found = load(tmp_path / "lamp.lumitree")
    assert found.light_field.traced == traced
    assert (found.info.light_field_paths, found.info.light_field_noise) == (1 << 40, noise)
    assert random_asset(0).info.light_field_paths is None


FILES = (
    *("original", "with_light_field", "light_field_only", "with_spectrum", "with_gain"),
    "lit_inside",
)


@pytest.fixture(params=FILES)
def any_file(request):
    """A file without a light field, with one, alone, with a spectrum, a gain, or light inside."""
    return request.getfixturevalue(request.param)


def test_round_trip_byte_for_byte(any_file, tmp_path):
    save(load(any_file), tmp_path / "again.lumitree")
    assert (tmp_path / "again.lumitree").read_bytes() == any_file.read_bytes()


def test_loaded_equals_saved(tmp_path):
    asset = random_asset(3, law="exponential", half_extents=np.array([0.25, 1.0, 0.5]))
    save(asset, tmp_path / "a.lumitree")
    again = load(tmp_path / "a.lumitree")
    for name in ("children", "density", "coefficients", "frame"):
        assert np.array_equal(getattr(asset, name), getattr(again, name))
    for name in ("law", "l_max", "tree_depth", "max_radiance", "luminaire"):
        assert getattr(asset, name) == getattr(again, name)
    assert again.light_field is None


def test_loaded_light_field_equals_saved(with_light_field):
    field, plain = random_light_field(0), random_asset(0, tree_depth=3, l_max=1)
    found = load(with_light_field)
    assert_equal_fields(found.light_field, field)
    assert np.array_equal(found.coefficients, plain.coefficients)
    assert found.num_bytes == plain.num_bytes + field.num_bytes
    assert found.info.light_field_cells == len(field.cells) == 5
    assert plain.info.light_field_cells == 0


def test_loaded_light_inside_equals_saved(lit_inside):
    found = load(lit_inside)
    assert_equal_fields(found.light_field, INSIDE)
    assert found.info.light_inside_cells == len(INSIDE.inside.cells)
    assert random_asset(0).info.light_inside_cells == 0
    plain = with_geometry(small_geometry())
    assert found.num_bytes == plain.num_bytes - plain.light_field.num_bytes + INSIDE.num_bytes


def test_the_fewest_bins_have_light_inside(tmp_path):
    """Four coarse bins are half a byte."""
    field = with_inside(0, random_light_field(0))
    assert field.inside.lit.shape == (7, 1)
    save(light_field_asset(field, random_asset(0).frame, "test"), tmp_path / "a.lumitree")
    assert_equal_fields(load(tmp_path / "a.lumitree").light_field, field)


def stream(change):
    """Change the content of the compressed light field."""

    def changed(tensors):
        content = change(zlib.decompress(tensors["light.stream"].tobytes()))
        tensors["light.stream"] = np.frombuffer(zlib.compress(content), np.uint8)

    return changed


def cut(tensors):
    tensors["light.stream"] = tensors["light.stream"][:-3]


def append(tensors):
    tensors["light.stream"] = np.append(tensors["light.stream"], np.uint8(0))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (stream(lambda content: content[:-1]), "does not decompress to"),
        (stream(lambda content: content + b"0"), "does not decompress to"),
        # A thousand times as much as is stored.
        (stream(lambda content: content + bytes(1 << 26)), "does not decompress to"),
        (stream(lambda content: b"\xff" + content[1:]), "a cell is outside the grid"),
        (stream(lambda content: content[:-4] + b"\xff\xff\xff\xff"), "reach curves are not"),
        (cut, "does not decompress to"),
        (append, "does not decompress to"),
        (lambda t: t.update({"light.stream": np.zeros(9, np.uint8)}), "cannot be decompressed"),
        (lambda t: t.update({"light.stream": np.zeros((), np.uint8)}), "decompress"),
        (lambda t: t.pop("light.stream"), 'the header lacks "light.stream"'),
        (lambda t: t.update({"light.cells": t["field.stream"]}), 'unknown key "light.cells"'),
        (
            lambda t: t.update({"light.stream": np.zeros(3, np.float32)}),
            'dtype of light.stream .* "F32"',
        ),
    ],
)
def test_broken_streams_are_refused(lit_inside, tmp_path, change, message):
    rewrite(lit_inside, tmp_path / "bad.lumitree", change_tensors=change)
    with pytest.raises(LumitreeError, match=message) as caught:
        load(tmp_path / "bad.lumitree")
    assert str(caught.value).isprintable()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d["light"].update(cells=6), "does not decompress to"),
        (lambda d: d["light"].update(bins=-1), "bins -1, expected 0 to"),
        (lambda d: d["light"].update(bins=1 << 40), "bins 1099511627776, expected 0 to"),
        (lambda d: d["light"].update(cells=1 << 28, bins=1 << 28), r"limit 2147483648"),
        (lambda d: d["light"].update(bins=True), "bins"),
        (lambda d: d["light"].pop("cells"), 'lacks "cells"'),
        (lambda d: d["light"].pop("inside"), "does not decompress to"),
        (lambda d: d["light"]["inside"].update(more=1), 'unknown key "more"'),
        (lambda d: d["light"]["inside"].update(distances=5), "does not decompress to"),
        (lambda d: d["light"]["inside"].update(scale=0.0), "scale 0.0, expected"),
        (lambda d: d["light"]["inside"].update(scale=1e16), "scale 1e"),
        (lambda d: d.update(gain=[1e15, 1, 1]), "emission exceeds"),
    ],
)
def test_broken_descriptions_of_streams_are_refused(lit_inside, tmp_path, change, message):
    rewrite(lit_inside, tmp_path / "bad.lumitree", change_text=change)
    with pytest.raises(LumitreeError, match=message) as caught:
        load(tmp_path / "bad.lumitree")
    assert str(caught.value).isprintable()


@pytest.mark.parametrize("name", ["with_light_field", "lit_inside"])
def test_a_random_stream_is_refused_or_read(request, tmp_path, name):
    """Any bytes of the right number: no other exception than a `LumitreeError`."""
    random = np.random.default_rng(0)
    refused = 0
    for _ in range(200):

        def change(content):
            content = bytearray(content)
            for _ in range(random.integers(1, 4)):
                content[random.integers(len(content))] = random.integers(256)
            return bytes(content)

        path = request.getfixturevalue(name)
        rewrite(path, tmp_path / "bad.lumitree", change_tensors=stream(change))
        refused += damage.refused(lambda: load(tmp_path / "bad.lumitree"))
    assert 20 < refused < 200


def test_an_asset_of_an_light_field_alone(light_field_only):
    found = load(light_field_only)
    assert_equal_fields(found.light_field, random_light_field(0))
    assert found.num_leaves == 0
    assert (found.info.nodes, found.info.leaves) == (1, 0)
    assert not found.children.any()


def test_equal_assets_give_equal_bytes(with_light_field, tmp_path):
    """Also if the arrays lie otherwise in memory."""
    plain, field = random_asset(0, tree_depth=3, l_max=1), random_light_field(0)
    fortran = replace(field, cells=np.asfortranarray(field.cells), lit=np.asfortranarray(field.lit))
    save(replace(plain, light_field=fortran), tmp_path / "again.lumitree")
    assert (tmp_path / "again.lumitree").read_bytes() == with_light_field.read_bytes()
    save(replace(plain, light_field=random_light_field(1)), tmp_path / "other.lumitree")
    assert (tmp_path / "other.lumitree").read_bytes() != with_light_field.read_bytes()


@pytest.mark.parametrize("name", FILES)
@settings(max_examples=150)
@given(data=st.data())
def test_every_flipped_bit_is_noticed(request, tmp_path_factory, name, data):
    content = bytearray(request.getfixturevalue(name).read_bytes())
    bit = data.draw(st.integers(0, 8 * len(content) - 1))
    content[bit // 8] ^= 1 << bit % 8
    path = tmp_path_factory.getbasetemp() / "flipped.lumitree"
    path.write_bytes(content)
    with pytest.raises(LumitreeError, match="flipped") as caught:
        load(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("length", [0, 1, 7, 8, 9, 200, -1])
def test_truncated_files_are_refused(any_file, tmp_path, length):
    path = tmp_path / "cut.lumitree"
    path.write_bytes(any_file.read_bytes()[:length])
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
    # safetensors writes memory as it lies.
    tensors = {name: np.array(array, order="C") for name, array in tensors.items()}
    change_text(description)
    text = json.dumps(description)
    safetensors.numpy.save_file(tensors, target, {"lumitree": f"{_digest(text, tensors)} {text}"})


def changed(array, index, value):
    array = array.copy()
    array[index] = value
    return array


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("density", lambda a: changed(a, 0, np.nan), "density holds NaN"),
        ("density", lambda a: changed(a, 0, -1), "negative"),
        ("coefficients", lambda a: changed(a, (0, 0, 0), np.inf), "hold NaN or infinity"),
        ("children", lambda a: changed(a, (0, 0), 10**6), "node index is out of range"),
        ("children", lambda a: changed(a, a < 0, -(10**6)), "leaf index is out of range"),
        ("children", lambda a: changed(a, (-1, slice(None)), 0), "referenced exactly once"),
        ("density", lambda a: a.astype(np.float64), "density is float64"),
        ("density", lambda a: a[:-1], "coefficients is"),
        ("children", lambda a: a.reshape(-1, 4), "children is"),
        ("density", lambda a: np.array(1, np.float32), r"density is float32 \(\)"),
        ("children", lambda a: np.array(0, np.int32), r"children is int32 \(\)"),
    ],
)
def test_broken_arrays_are_refused(name, change, message):
    asset = random_asset(0, tree_depth=3, l_max=1)
    with pytest.raises(LumitreeError, match=message):
        replace(asset, **{name: change(getattr(asset, name))})


def put(name, index, value):
    return lambda arrays: arrays[name].__setitem__(index, value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (put("density", 0, 255 << 4 | 1), "density holds NaN"),
        (put("density", 0, 255 << 4), "values above"),
        (put("density", 0, 1 << 12 | 127 << 4), "negative"),
        (put("density", 0, 1 << 13), "a density of more than 13 bits"),
        (put("occupied", 0, 0), "a tree of"),
        (put("occupied", slice(None), 255), "a tree of"),
        (put("ends", slice(None), 0), "a tree of"),
        (put("ends", slice(None), 255), "a tree of"),
    ],
)
def test_broken_arrays_of_the_field_are_refused(original, tmp_path, change, message):
    asset = load(original)
    rewrite(
        original,
        tmp_path / "bad.lumitree",
        change_tensors=lambda tensors: change_field_arrays(tensors, asset, change),
    )
    with pytest.raises(LumitreeError, match=message) as caught:
        load(tmp_path / "bad.lumitree")
    assert "bad.lumitree" in str(caught.value)


def test_a_node_that_is_not_reached_is_refused(tmp_path):
    """The numbers of nodes and leaves are right, but node 1 is below itself."""
    path = tmp_path / "lamp.lumitree"
    asset = make_asset([(0, 0, 0)], [2], [1.0], np.zeros((1, 3, 1)))
    save(asset, path)

    def change(arrays):
        assert arrays["occupied"].tolist() == [1, 1]
        assert arrays["ends"].tolist() == [0, 1]
        arrays["ends"][:] = 1, 0

    rewrite(path, path, change_tensors=lambda t: change_field_arrays(t, asset, change))
    with pytest.raises(LumitreeError, match="not connected"):
        load(path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t.pop("field.stream"), 'lacks "field.stream"'),
        (lambda t: t.update(extra=t["field.stream"]), 'unknown key "extra"'),
        (lambda t: t.update({"field.stream": np.zeros(3, np.float32)}), 'dtype .* "F32"'),
        (lambda t: t.update({"field.stream": np.zeros(3, np.uint8)}), "cannot be decompressed"),
        (lambda t: t.update({"field.stream": t["field.stream"][:-1]}), "does not decompress to"),
    ],
)
def test_broken_tensors_are_refused(original, tmp_path, change, message):
    rewrite(original, tmp_path / "bad.lumitree", change_tensors=change)
    with pytest.raises(LumitreeError, match=message):
        load(tmp_path / "bad.lumitree")


@pytest.mark.parametrize("l_max", [0, 2, 4])
@pytest.mark.parametrize("scale", [0.3, 30.0, 1000.0])
def test_a_field_is_rounded_by_no_more_than_is_stated(l_max, scale):
    random = np.random.default_rng(l_max)
    asset = random_asset(1, l_max=l_max)
    size = asset.coefficients.shape
    asset = replace(
        asset,
        coefficients=np.clip(random.normal(0, scale, size), -2000, 2000).astype(np.float16),
        density=(10 ** random.uniform(-30, 15, size[0])).astype(np.float32),
    )
    asset.density[:2] = 0, 1e15
    stored = as_stored(asset)
    # Leaves of `random_asset` are in the order of the file.
    assert np.array_equal(stored.children, asset.children)
    expected = asset.coefficients.astype(float)
    # Band 0 beyond this emits nothing, or L_max.
    expected[..., 0] = expected[..., 0].clip(-255.75, 255.75)
    error = np.abs(stored.coefficients - expected)
    # Halves have a precision of their own.
    largest = np.abs(asset.coefficients).astype(np.float16) + np.float16(0.25)
    brightest = stored.coefficients[:, :, 0].max(axis=1)
    others = np.select([brightest >= -8, brightest >= -16], [1 / 8, 1 / 2], 1)
    steps = np.repeat(others[:, None, None], size[2], axis=2)
    steps[..., 0] = 1 / 64
    # Of R and B the error is that of G and of the difference to it.
    steps = steps * np.array([1, 0.5, 1])[:, None]
    assert (error <= steps + np.spacing(largest)).all()
    assert (np.abs(stored.density / np.maximum(asset.density, 1e-37) - 1) <= 1 / 32)[1:].all()
    assert stored.density[0] == 0


def test_what_is_rounded_is_not_rounded_again(tmp_path):
    random = np.random.default_rng(0)
    asset = random_asset(2, l_max=3)
    coefficients = random.normal(0, 10.0 ** random.integers(-2, 5, asset.num_leaves)[:, None, None],
                                 asset.coefficients.shape)  # fmt: skip
    finite = np.clip(coefficients, -65504, 65504).astype(np.float16)
    once = as_stored(replace(asset, coefficients=finite))
    save(once, tmp_path / "a.lumitree")
    twice = load(tmp_path / "a.lumitree")
    for name in ("children", "density", "coefficients"):
        assert np.array_equal(getattr(once, name), getattr(twice, name))


def test_nodes_and_leaves_in_any_order_are_stored_as_the_same_field():
    asset = random_asset(4)
    random = np.random.default_rng(0)
    nodes = np.append(0, 1 + random.permutation(len(asset.children) - 1))
    leaves = random.permutation(asset.num_leaves)
    children = np.zeros_like(asset.children)
    children[nodes] = asset.children
    children[children > 0] = nodes[children[children > 0]]
    children[children < 0] = ~leaves[~children[children < 0]]
    shuffled = replace(
        asset,
        children=children,
        density=asset.density[np.argsort(leaves)],
        coefficients=asset.coefficients[np.argsort(leaves)],
    )
    stored = as_stored(shuffled)
    for name in ("children", "density", "coefficients"):
        assert np.array_equal(getattr(stored, name), getattr(asset, name))


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("version", 1, "version 1, this lumitree reads 4; bake it again"),
        ("version", 0, "version 0, this"),
        ("version", 4.0, "version 4.0, this"),
        ("version", True, "version true, this"),
        ("light", {"depth": 1, "resolution": 4, "scale": 1.0}, 'lacks "light.stream"'),
        ("gain", None, "gain of the description is null; expected 3 numbers"),
        ("format", "other", "format of the description is"),
        ("activation", "relu", "activation"),
        ("tree_depth", 11, "tree depth 11"),
        ("tree_depth", 1, "deeper than 1 levels"),
        ("tree_depth", "3", 'tree_depth of the description is "3"; expected an integer'),
        ("l_max", 2, "the field does not decompress to"),
        ("l_max", 5, "l_max 5, expected 0 to 4"),
        ("l_max", -1, "l_max -1, expected 0 to 4"),
        ("field", {"nodes": 0, "leaves": 0}, "0 nodes and 0 leaves, expected"),
        ("field", {"nodes": 1, "leaves": 1 << 40}, "leaves, expected"),
        ("field", {"nodes": 1, "leaves": 1 << 27}, "limit 2147483648"),
        ("field", {"nodes": 1}, 'lacks "leaves"'),
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


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ([1.0, 1.0], "gain of the description is a list"),
        (2.0, "gain of the description is 2.0"),
        ([1, -1, 1], "three numbers of at least 0"),
        ([0, 0, 0], "not all 0"),
        ([1, 1, 1e300], "emission exceeds"),
    ],
)
def test_broken_gains_are_refused(with_gain, tmp_path, value, message):
    rewrite(with_gain, tmp_path / "bad.lumitree", change_text=lambda d: d.update(gain=value))
    with pytest.raises(LumitreeError, match=message):
        load(tmp_path / "bad.lumitree")


def test_a_gain_is_kept(original, with_gain):
    asset = load(with_gain)
    assert asset.light_factors == asset.info.light_factors == (0.5, 0.0, 2e3)
    assert asset.parts == ("light", "geometry")
    assert asset.without_factors.light_factors == load(original).light_factors == (1.0, 1.0, 1.0)


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (None, "spectrum of the description is null"),
        ([0.75], "spectrum of the description is a list"),
        ({}, 'lacks "share"'),
        ({"share": 0.5, "unit": 1}, 'unknown key "unit"'),
        ({"share": "1"}, "share of spectrum"),
        ({"share": 0}, r"share 0\.0, expected a number above 0"),
        ({"share": 1.5}, r"share 1\.5, expected"),
        ({"share": -1.0}, r"share -1\.0, expected"),
    ],
)
def test_broken_descriptions_of_the_spectrum_are_refused(with_spectrum, tmp_path, value, message):
    path = tmp_path / "bad.lumitree"
    rewrite(with_spectrum, path, change_text=lambda d: d.update(spectrum=value))
    with pytest.raises(LumitreeError, match=message):
        load(path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda a: a[:-1], r"power is float32 \(470,\), expected"),
        (lambda a: a[None], "power is float32"),
        (lambda a: a[:0], "power is float32"),
        (lambda a: a.astype(np.float64), 'dtype of spectrum.power of the header is "F64"'),
        (lambda a: a / 2, "with 1 as the largest"),
        (lambda a: a * 2, "power is not 0 to 1"),
        (lambda a: 0 * a, "with 1 as the largest"),
        (lambda a: changed(a, 5, np.nan), "power is not 0 to 1"),
        (lambda a: changed(a, 5, np.inf), "power is not 0 to 1"),
        (lambda a: changed(a, 5, -1e-9), "power is not 0 to 1"),
    ],
)
def test_broken_spectra_are_refused(with_spectrum, tmp_path, change, message):
    def apply(tensors):
        tensors["spectrum.power"] = change(tensors["spectrum.power"])

    rewrite(with_spectrum, tmp_path / "bad.lumitree", change_tensors=apply)
    with pytest.raises(LumitreeError, match=message):
        load(tmp_path / "bad.lumitree")


def test_a_spectrum_and_its_tensor_belong_together(with_spectrum, tmp_path):
    path = tmp_path / "bad.lumitree"
    rewrite(with_spectrum, path, change_text=lambda d: d.pop("spectrum"))
    with pytest.raises(LumitreeError, match=r'unknown key "spectrum\.power"'):
        load(path)
    rewrite(with_spectrum, path, change_tensors=lambda t: t.pop("spectrum.power"))
    with pytest.raises(LumitreeError, match=r'lacks "spectrum\.power"'):
        load(path)


def test_a_spectrum_is_kept_and_changes_nothing_else(with_spectrum, light_field_only):
    found, without = load(with_spectrum), load(light_field_only)
    assert found.spectrum.power.tolist() == SPECTRUM.power.tolist()
    assert found.spectrum.share == found.info.spectrum_share == 0.75
    assert without.spectrum is None
    assert without.info.spectrum_share is None
    assert_equal_fields(found.light_field, without.light_field)


def put_bytes(start, stop, value):
    return stream(lambda content: content[:start] + value + content[stop:])


BINS = len(random_light_field(0).intensity)


# Cells [5, 3], the bins of each that emit [5, 2], intensities, which light each bin has, and bent
# parts, see `random_light_field`.
@pytest.mark.parametrize(
    ("change", "message"),
    [
        (put_bytes(0, 3, b"\xff\xff\xff"), "a cell is outside the grid"),
        (put_bytes(3, 15, bytes(12)), "repeated or out of order"),
        (put_bytes(15, 25, bytes(10)), "intensities for"),
        (put_bytes(25, 29, bytes(4)), "an intensity is 0"),
        (put_bytes(-4, 1 << 30, b"\xff\xff\xff\xff"), "a bent part is larger"),
        (put_bytes(25 + 4 * BINS, 26 + 4 * BINS, b"\x03"), "for [0-9]+ bins that have both"),
    ],
)
@pytest.mark.parametrize("name", FILES[1:-1])
def test_broken_arrays_of_the_light_field_are_refused(request, tmp_path, name, change, message):
    path = request.getfixturevalue(name)
    rewrite(path, tmp_path / "bad.lumitree", change_tensors=change)
    with pytest.raises(LumitreeError, match=message) as caught:
        load(tmp_path / "bad.lumitree")
    assert "bad.lumitree" in str(caught.value)
    assert str(caught.value).isprintable()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"depth": 0}, "depth 0, expected 1 to 7"),
        ({"depth": 8}, "depth 8, expected 1 to 7"),
        ({"depth": 1}, "a cell is outside the grid"),
        ({"depth": 2.0}, "depth of light of the description is 2.0; expected an integer"),
        ({"depth": True}, "depth of light of the description is true; expected an integer"),
        ({"resolution": 8}, "does not decompress to"),
        ({"resolution": 5}, "does not decompress to"),
        ({"resolution": 256}, "does not decompress to"),
        ({"resolution": 1 << 40}, "limit 2147483648"),
        ({"scale": 0}, "scale 0.0"),
        ({"scale": "1"}, 'scale of light of the description is "1"; expected a number'),
        ({"scale": 1e16}, "scale 1e"),
        ({"extra": 1}, 'light of the description has the unknown key "extra"'),
        (
            {"traced": None},
            "traced of light of the description is null; expected a JSON object",
        ),
        ({"traced": {"count": 1}}, 'traced of light of the description lacks "luminaire"'),
        ({"traced": TRACED | {"extra": 1}}, 'has the unknown key "extra"'),
        ({"traced": TRACED | {"count": 0}}, r"record of light paths: count 0, expected 1 to 2\^50"),
        ({"traced": TRACED | {"count": 2.0}}, "count of traced .* expected an integer"),
        ({"traced": TRACED | {"seeds": []}}, r"seeds \(\), expected 1 to 4096 increasing"),
        ({"traced": TRACED | {"seeds": [2, 2]}}, r"seeds \(2, 2\), expected"),
        ({"traced": TRACED | {"seeds": [-1]}}, r"seeds \(-1,\), expected"),
        ({"traced": TRACED | {"seeds": list(range(4097))}}, "expected 1 to 4096"),
        ({"traced": TRACED | {"luminaire": "x"}}, "luminaire x, expected 64 hexadecimal digits"),
        ({"traced": TRACED | {"luminaire": 65 * "a"}}, "at most 64 characters"),
        ({"traced": TRACED | {"noise": -0.1}}, "noise -0.1, expected a number of at least 0"),
        ({"traced": TRACED | {"noise": "0"}}, 'noise of traced .* is "0"; expected a number'),
    ],
)
def test_broken_descriptions_of_the_light_field_are_refused(
    with_light_field, tmp_path, change, message
):
    path = tmp_path / "bad.lumitree"
    rewrite(with_light_field, path, change_text=lambda d: d["light"].update(change))
    with pytest.raises(LumitreeError, match=message):
        load(path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.pop("light"), 'the header has the unknown key "light.stream"'),
        (
            lambda d: d.update(light=None),
            "light of the description is null; expected a JSON",
        ),
        (
            lambda d: d.update(light=[2, 4, 1.0]),
            "light of the description is a list of 3",
        ),
        (lambda d: d["light"].pop("scale"), 'light of the description lacks "scale"'),
    ],
)
def test_description_and_tensor_of_the_light_field_belong_together(
    with_light_field, tmp_path, change, message
):
    rewrite(with_light_field, tmp_path / "bad.lumitree", change_text=change)
    with pytest.raises(LumitreeError, match=message):
        load(tmp_path / "bad.lumitree")


def test_the_largest_resolution_and_depth_are_kept(tmp_path):
    intensity = np.ones((1, 128**2, 3))
    field = make_light_field(np.array([[127, 0, 127]]), intensity, 7)
    save(light_field_asset(field, random_asset(0).frame, "fine"), tmp_path / "fine.lumitree")
    assert_equal_fields(load(tmp_path / "fine.lumitree").light_field, field)


def test_a_cycle_is_refused():
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
    with pytest.raises(LumitreeError, match="__metadata__ of the header is null"):
        load(tmp_path / "x.lumitree")
    (tmp_path / "code.lumitree").write_bytes(b"cos\nsystem\n(S'echo pwned'\ntR." * 9)
    with pytest.raises(LumitreeError, match=r"is a text file, not a \.lumitree asset"):
        load(tmp_path / "code.lumitree")
