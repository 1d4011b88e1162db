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

from lumitree.asset.asset import EmittedSpectrum, light_field_asset
from lumitree.asset.file import _digest, as_stored, load, save
from lumitree.asset.light_field import TracedPaths, make_light_field
from lumitree.errors import LumitreeError
from support.asset_drafts import Draft
from support.fields import make_asset, random_asset
from support.geometry_assets import small_geometry, with_geometry
from support.light_fields import assert_equal_fields, random_light_field, with_inside
from support.stored_arrays import change_field_arrays

PLAIN, LIGHT = random_asset(0, tree_depth=3, l_max=1), random_light_field(0)
INSIDE = with_inside(
    1, random_light_field(0, resolution=16, traced=TracedPaths(3, (1, 5), 64 * "0", 0.5))
)
SPECTRUM = EmittedSpectrum.of(np.random.default_rng(0).random(471), 0.75)
TRACED = {"count": 3, "seeds": [1, 5], "luminaire": 64 * "0", "noise": 0.5}
ASSETS = {
    "field": PLAIN,
    "both": replace(PLAIN, light_field=LIGHT),
    "light": light_field_asset(LIGHT, random_asset(0).frame, "test"),
    "spectrum": light_field_asset(LIGHT, random_asset(0).frame, "test", SPECTRUM),
    "factors": replace(with_geometry(small_geometry()), light_factors=(0.5, 0.0, 2e3)),
    "inside": replace(with_geometry(small_geometry()), light_field=INSIDE),
}


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Files of `ASSETS` by name."""
    folder = tmp_path_factory.mktemp("assets")
    for name, asset in ASSETS.items():
        save(asset, folder / f"{name}.lumitree")
    return {name: folder / f"{name}.lumitree" for name in ASSETS}


def again(asset, folder):
    save(asset, folder / "again.lumitree")
    return load(folder / "again.lumitree")


def rewrite(path, target, change_tensors=lambda t: None, change_text=lambda d: None):
    """A file whose checksum is right but whose content breaks an invariant."""
    tensors = {name: array.copy() for name, array in safetensors.numpy.load_file(path).items()}
    with safetensors.safe_open(path, framework="np") as file:
        description = json.loads(file.metadata()["lumitree"].partition(" ")[2])
    change_tensors(tensors)
    # safetensors writes memory as it lies.
    tensors = {name: np.array(array, order="C") for name, array in tensors.items()}
    change_text(description)
    text = json.dumps(description)
    safetensors.numpy.save_file(tensors, target, {"lumitree": f"{_digest(text, tensors)} {text}"})


@pytest.mark.parametrize("name", ASSETS)
def test_round_trip_byte_for_byte(files, name, tmp_path):
    save(load(files[name]), tmp_path / "again.lumitree")
    assert (tmp_path / "again.lumitree").read_bytes() == files[name].read_bytes()


def test_loaded_equals_saved(files, tmp_path):
    asset = random_asset(3, law="exponential", half_extents=np.array([0.25, 1.0, 0.5]))
    found = again(asset, tmp_path)
    for name in ("children", "density", "coefficients", "frame"):
        assert np.array_equal(getattr(asset, name), getattr(found, name))
    for name in ("law", "l_max", "tree_depth", "max_radiance", "luminaire"):
        assert getattr(asset, name) == getattr(found, name)
    assert found.light_field is None
    both = load(files["both"])
    assert_equal_fields(both.light_field, LIGHT)
    assert np.array_equal(both.coefficients, PLAIN.coefficients)
    light = load(files["light"])
    assert_equal_fields(light.light_field, LIGHT)
    assert (light.num_leaves, light.info.nodes, light.info.leaves) == (0, 1, 0)
    assert not light.children.any()
    spectral = load(files["spectrum"])
    assert spectral.spectrum is not None
    assert SPECTRUM is not None
    assert spectral.spectrum.power.tolist() == SPECTRUM.power.tolist()
    assert_equal_fields(spectral.light_field, LIGHT)
    assert_equal_fields(load(files["inside"]).light_field, INSIDE)


def test_the_size_and_other_figures(files):
    plain, both, inside = (load(files[name]) for name in ("field", "both", "inside"))
    assert both.num_bytes == plain.num_bytes + LIGHT.num_bytes
    assert (plain.info.light_field_cells, both.info.light_field_cells) == (0, len(LIGHT.cells))
    assert (plain.info.light_inside_cells, plain.info.light_field_paths) == (0, None)
    assert INSIDE.inside is not None
    assert inside.info.light_inside_cells == len(INSIDE.inside.cells)
    other = with_geometry(small_geometry())
    assert other.light_field is not None
    assert inside.num_bytes == other.num_bytes - other.light_field.num_bytes + INSIDE.num_bytes
    spectrum, factors = load(files["spectrum"]), load(files["factors"])
    assert spectrum.spectrum is not None
    assert spectrum.spectrum.share == spectrum.info.spectrum_share == 0.75
    assert plain.spectrum is plain.info.spectrum_share is None
    assert factors.light_factors == factors.info.light_factors == (0.5, 0.0, 2e3)
    assert factors.without_factors.light_factors == plain.light_factors == (1.0, 1.0, 1.0)


@pytest.mark.parametrize("noise", [0.25, None])
def test_the_record_of_light_paths_is_kept(tmp_path, noise):
    traced = TracedPaths(1 << 40, (0, 2, 2**31 - 1), 64 * "f", noise)
    found = again(replace(PLAIN, light_field=random_light_field(0, traced=traced)), tmp_path)
    assert found.light_field is not None
    assert found.light_field.traced == traced
    assert (found.info.light_field_paths, found.info.light_field_noise) == (1 << 40, noise)


def test_the_fewest_and_the_most_bins_are_kept(tmp_path):
    """Inside the box, four coarse bins are half a byte."""
    few = with_inside(0, LIGHT)
    assert few.inside is not None
    assert few.inside.lit.shape == (7, 1)
    fine = make_light_field(np.array([[127, 0, 127]]), np.ones((1, 128**2, 3)), 7)
    for field in (few, fine):
        found = again(light_field_asset(field, PLAIN.frame, "test"), tmp_path)
        assert_equal_fields(found.light_field, field)


def test_equal_assets_give_equal_bytes(files, tmp_path):
    """Also if the arrays lie otherwise in memory."""
    fortran = replace(LIGHT, cells=np.asfortranarray(LIGHT.cells), lit=np.asfortranarray(LIGHT.lit))
    save(replace(PLAIN, light_field=fortran), tmp_path / "again.lumitree")
    assert (tmp_path / "again.lumitree").read_bytes() == files["both"].read_bytes()
    save(replace(PLAIN, light_field=random_light_field(1)), tmp_path / "other.lumitree")
    assert (tmp_path / "other.lumitree").read_bytes() != files["both"].read_bytes()


@pytest.mark.parametrize("name", ASSETS)
@settings(max_examples=100)
@given(data=st.data())
def test_every_flipped_bit_is_noticed(files, tmp_path_factory, name, data):
    content = bytearray(files[name].read_bytes())
    bit = data.draw(st.integers(0, 8 * len(content) - 1))
    content[bit // 8] ^= 1 << bit % 8
    path = tmp_path_factory.getbasetemp() / "flipped.lumitree"
    path.write_bytes(content)
    with pytest.raises(LumitreeError, match="flipped") as caught:
        load(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["field", "inside"])
def test_truncated_files_and_oversized_headers_are_refused(files, tmp_path, name):
    content, path = files[name].read_bytes(), tmp_path / "cut.lumitree"
    for length in (0, 1, 7, 8, 9, 200, -1):
        path.write_bytes(content[:length])
        with pytest.raises(LumitreeError, match=r"cut.lumitree"):
            load(path)
    for size in (2**20 + 1, 2**40, 2**64 - 1):
        path.write_bytes(struct.pack("<Q", size) + content[8:])
        with pytest.raises(LumitreeError, match=f"a header of {size} bytes"):
            load(path)


def test_other_files_are_refused(tmp_path):
    with pytest.raises(LumitreeError, match="does not exist"):
        load(tmp_path / "no.lumitree")
    safetensors.numpy.save_file({"x": np.zeros(3)}, tmp_path / "x.lumitree")
    with pytest.raises(LumitreeError, match="__metadata__"):
        load(tmp_path / "x.lumitree")
    (tmp_path / "code.lumitree").write_bytes(b"cos\nsystem\n(S'echo pwned'\ntR." * 9)
    with pytest.raises(LumitreeError, match=r"is a text file, not a \.lumitree asset"):
        load(tmp_path / "code.lumitree")


def text(**members):
    """A change of members of the description."""
    return {"change_text": lambda d: d.update(members)}


def light(**members):
    return {"change_text": lambda d: d["light"].update(members)}


def traced(**members):
    return light(traced=TRACED | members)


def inside(**members):
    return {"change_text": lambda d: d["light"]["inside"].update(members)}


def without(*keys):
    def change(description):
        for key in keys[:-1]:
            description = description[key]
        del description[keys[-1]]

    return {"change_text": change}


def tensor(name, change):
    """A change of a tensor; None drops it."""

    def apply(tensors):
        found = tensors.pop(name)
        if (changed := change(found)) is not None:
            tensors[name] = np.asarray(changed)

    return {"change_tensors": apply}


def stream(change):
    """A change of the content of the compressed light field."""

    def packed(array):
        content = change(zlib.decompress(array.tobytes()))
        return np.frombuffer(zlib.compress(content), np.uint8)

    return tensor("light.stream", packed)


def put_bytes(start, stop, value):
    return stream(lambda content: content[:start] + value + content[stop:])


def put(name, index, value):
    """A change of an array of the stored field."""

    def change(tensors):
        change_field_arrays(tensors, PLAIN, lambda arrays: arrays[name].__setitem__(index, value))

    return {"change_tensors": change}


def changed(array, index, value):
    array = array.copy()
    array[index] = value
    return array


BINS = len(LIGHT.intensity)
POWER = "spectrum.power"
# File, change of its content, and a word of the refusal. The stream of the light field has cells
# [5, 3], bits of bins [5, 2], intensities, which light each bin has, and bent parts.
BROKEN = [
    *(("field", text(version=value), "version") for value in (1, 0, 4.0, True)),
    ("field", text(light={"depth": 1, "resolution": 4, "scale": 1.0}), "light has no cells"),
    ("field", text(format="other"), "format"),
    ("field", text(activation="relu"), "activation"),
    ("field", text(tree_depth=11), "tree depth 11"),
    ("field", text(tree_depth=1), "deeper than 1 levels"),
    ("field", text(tree_depth="3"), "a whole number"),
    ("field", text(l_max=2), "does not decompress to"),
    *(("field", text(l_max=value), "l_max") for value in (5, -1)),
    ("field", text(field={"nodes": 0, "leaves": 0}), "field.nodes is"),
    ("field", text(field={"nodes": 1, "leaves": 1 << 40}), "leaves"),
    ("field", text(field={"nodes": 1, "leaves": 1 << 27}), "limit 2147483648"),
    ("field", text(field={"nodes": 1}), "leaves"),
    ("field", text(law="cubic"), "law"),
    ("field", text(max_radiance=-1), "maximum radiance"),
    *(("field", text(half_extents=value), "half_extents") for value in ([1, 1], [0.5] * 3)),
    ("field", text(world_from_proxy=np.diag([1.0, 2, 1, 1]).tolist()), "shears"),
    ("field", text(world_from_proxy=[[1]]), "4 x 4 numbers"),
    *(("factors", text(gain=value), "gain") for value in (None, [1.0, 1.0], 2.0)),
    ("factors", text(gain=[1, -1, 1]), "at least 0"),
    ("factors", text(gain=[0, 0, 0]), "not all 0"),
    ("factors", text(gain=[1, 1, 1e300]), "emission exceeds"),
    ("inside", text(gain=[1e15, 1, 1]), "emission exceeds"),
    *(("spectrum", text(spectrum=value), "spectrum") for value in (None, [0.75])),
    ("spectrum", text(spectrum={}), "share"),
    ("spectrum", text(spectrum={"share": 0.5, "unit": 1}), "unit"),
    *(("spectrum", text(spectrum={"share": each}), "share") for each in ("1", 0, 1.5, -1.0)),
    ("spectrum", without("spectrum"), "no such tensor"),
    ("spectrum", tensor(POWER, lambda a: None), "is missing"),
    ("spectrum", tensor(POWER, lambda a: a[:-1]), "power is float32"),
    ("spectrum", tensor(POWER, lambda a: a.astype(np.float64)), "F64"),
    ("spectrum", tensor(POWER, lambda a: a / 2), "1 as the largest"),
    ("spectrum", tensor(POWER, lambda a: a * 2), "not 0 to 1"),
    ("spectrum", tensor(POWER, lambda a: 0 * a), "1 as the largest"),
    ("spectrum", tensor(POWER, lambda a: changed(a, 5, np.nan)), "not 0 to 1"),
    ("spectrum", tensor(POWER, lambda a: changed(a, 5, -1e-9)), "not 0 to 1"),
    ("field", tensor("field.stream", lambda a: None), "is missing"),
    ("field", {"change_tensors": lambda t: t.update(extra=t["field.stream"])}, "extra"),
    ("field", tensor("field.stream", lambda a: np.zeros(3, np.float32)), "F32"),
    ("field", tensor("field.stream", lambda a: np.zeros(3, np.uint8)), "cannot be decompressed"),
    ("field", tensor("field.stream", lambda a: a[:-1]), "does not decompress to"),
    ("field", put("density", 0, 255 << 4 | 1), "NaN"),
    ("field", put("density", 0, 255 << 4), "values above"),
    ("field", put("density", 0, 1 << 12 | 127 << 4), "negative"),
    ("field", put("density", 0, 1 << 13), "more than 13 bits"),
    ("field", put("occupied", 0, 0), "a tree of"),
    ("field", put("occupied", slice(None), 255), "a tree of"),
    ("field", put("leaf", slice(None), 0), "a tree of"),
    ("field", put("leaf", slice(None), 255), "a tree of"),
    ("inside", stream(lambda content: content[:-1]), "does not decompress to"),
    ("inside", stream(lambda content: content + b"0"), "does not decompress to"),
    # A thousand times as much as is stored.
    ("inside", stream(lambda content: content + bytes(1 << 26)), "does not decompress to"),
    ("inside", stream(lambda content: b"\xff" + content[1:]), "outside the grid"),
    ("inside", stream(lambda content: content[:-4] + b"\xff" * 4), "reach curves are not"),
    ("inside", tensor("light.stream", lambda a: a[:-3]), "does not decompress to"),
    ("inside", tensor("light.stream", lambda a: np.append(a, a[:1])), "does not decompress to"),
    ("inside", tensor("light.stream", lambda a: np.zeros(9, np.uint8)), "cannot be decompressed"),
    ("inside", tensor("light.stream", lambda a: np.zeros((), np.uint8)), "decompress"),
    ("inside", tensor("light.stream", lambda a: None), "is missing"),
    ("inside", tensor("light.stream", lambda a: np.zeros(3, np.float32)), "F32"),
    ("inside", light(cells=6), "does not decompress to"),
    *(("inside", light(bins=value), "bins") for value in (-1, 1 << 40, True)),
    ("inside", light(cells=1 << 28, bins=1 << 28), "limit 2147483648"),
    ("inside", without("light", "cells"), "cells"),
    ("inside", without("light", "inside"), "does not decompress to"),
    ("inside", inside(more=1), "more"),
    ("inside", inside(distances=5), "does not decompress to"),
    *(("inside", inside(scale=value), "scale") for value in (0.0, 1e16)),
    *(
        (name, *each)
        for name in ("both", "light", "spectrum")
        for each in (
            (put_bytes(0, 3, b"\xff\xff\xff"), "outside the grid"),
            (put_bytes(3, 15, bytes(12)), "repeated or out of order"),
            (put_bytes(15, 25, bytes(10)), "intensities for"),
            (put_bytes(25, 29, bytes(4)), "an intensity is 0"),
            (put_bytes(-4, 1 << 30, b"\xff\xff\xff\xff"), "a bent part is larger"),
            (put_bytes(25 + 4 * BINS, 26 + 4 * BINS, b"\x03"), "bins that have both"),
        )
    ),
    *(("both", light(depth=value), "depth") for value in (0, 8, 2.0, True)),
    ("both", light(depth=1), "outside the grid"),
    *(("both", light(resolution=value), "does not decompress to") for value in (8, 5, 256)),
    ("both", light(resolution=1 << 40), "limit 2147483648"),
    *(("both", light(scale=value), "scale") for value in (0, "1", 1e16)),
    ("both", light(extra=1), "extra"),
    ("both", light(traced={"count": 1}), "traced"),
    ("both", traced(extra=1), "extra"),
    *(("both", traced(count=value), "count") for value in (0, 2.0)),
    *(("both", traced(seeds=value), "seeds") for value in ([], [2, 2], [-1], list(range(4097)))),
    *(("both", traced(luminaire=value), "luminaire") for value in ("x", 65 * "a")),
    *(("both", traced(noise=value), "noise") for value in (-0.1, "0")),
    ("both", without("light"), "light.stream"),
    *(("both", text(light=value), "light") for value in (None, [2, 4, 1.0])),
    ("both", without("light", "scale"), "scale"),
]


@pytest.mark.parametrize(("name", "change", "word"), BROKEN, ids=range(len(BROKEN)))
def test_broken_content_is_refused_in_a_line(files, tmp_path, name, change, word):
    rewrite(files[name], tmp_path / "bad.lumitree", **change)
    with pytest.raises(LumitreeError, match=word) as caught:
        load(tmp_path / "bad.lumitree")
    assert "bad.lumitree" in str(caught.value)
    assert str(caught.value).isprintable()


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("density", lambda a: changed(a, 0, np.nan), "density has NaN"),
        ("density", lambda a: changed(a, 0, -1), "negative"),
        ("coefficients", lambda a: changed(a, (0, 0, 0), np.inf), "NaN or infinity"),
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
    with pytest.raises(LumitreeError, match=message):
        replace(PLAIN, **{name: change(getattr(PLAIN, name))})


def test_a_node_that_is_not_reached_is_refused(tmp_path):
    """The numbers of nodes and leaves are right, but node 1 is below itself."""
    path = tmp_path / "lamp.lumitree"
    asset = make_asset([(0, 0, 0)], [2], [1.0], np.zeros((1, 3, 1)))
    save(asset, path)

    def change(arrays):
        assert arrays["occupied"].tolist() == [1, 1]
        assert arrays["leaf"].tolist() == [0, 1]
        arrays["leaf"][:] = 1, 0

    rewrite(path, path, change_tensors=lambda t: change_field_arrays(t, asset, change))
    with pytest.raises(LumitreeError, match="not connected"):
        load(path)


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
    # R and B are stored as differences to G, so they have the errors of G and of the difference.
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
    twice = again(once, tmp_path)
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


@pytest.mark.parametrize("name", ["field", "both", "light", "spectrum", "inside"])
def test_a_draft_is_the_file(files, name, tmp_path):
    """Unchanged, a draft loads: changes of it, in `fuzz`, reach the checks behind the checksum."""
    (tmp_path / "draft.lumitree").write_bytes(Draft(ASSETS[name]).file())
    save(load(tmp_path / "draft.lumitree"), tmp_path / "again.lumitree")
    assert (tmp_path / "again.lumitree").read_bytes() == files[name].read_bytes()


def test_coefficients_beyond_half_precision_are_refused(tmp_path):
    draft = Draft(random_asset(0, tree_depth=2, l_max=1))

    def change(arrays):
        # Dark leaves, whose other bands have the largest step.
        arrays["coefficients"][:, 0], arrays["coefficients"][:, 1:] = -32767, 32767

    change_field_arrays(draft.tensors, draft.asset, change)
    (tmp_path / "bad.lumitree").write_bytes(draft.file())
    with pytest.raises(LumitreeError, match="NaN or infinity"):
        load(tmp_path / "bad.lumitree")
