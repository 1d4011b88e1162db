"""Seeded mutations of an asset: each loads to a sound asset or is refused in one printable line."""

import json
import struct
from dataclasses import replace

import numpy as np
import pytest

from lumitree.asset.asset import (
    MAX_DENSITY,
    MAX_RADIANCE,
    MAX_TREE_DEPTH,
    MIN_RADIANCE,
    light_field_asset,
)
from lumitree.asset.field_bytes import field_description, field_tensors
from lumitree.asset.file import _digest, load, save
from lumitree.asset.light_field import MAX_BINS, MAX_DEPTH, MAX_RESOLUTION, TracedPaths, unpack
from lumitree.asset.light_field_bytes import light_field_description, light_field_tensors
from lumitree.asset.spectrum import EmittedSpectrum, spectrum_description, spectrum_tensors
from lumitree.core.frames import MAX_SCALE, MIN_HALF_EXTENT, MIN_SCALE, similarity_scale
from lumitree.core.harmonics import MAX_L, num_coefficients
from lumitree.core.reading import MAX_LABEL
from lumitree.core.transmittance import LAWS
from lumitree.errors import LumitreeError
from support.fields import random_asset
from support.light_fields import assert_equal_fields, random_light_field
from support.reference_field import leaf_boxes
from support.stored_arrays import change_field_arrays

ROUNDS = 100
TRACED = TracedPaths(1 << 20, (0, 7), 64 * "a", 0.02)
SPECTRUM = EmittedSpectrum.of(np.random.default_rng(0).random(471), 0.75)
DEEP = "[" * 100_000 + "]" * 100_000
# JSON texts in place of a value.
VALUES = [
    *("0", "-1", "1", "2", "3", "1.0", "0.5", "-0.0", "true", "false", "null", '"3"', '""'),
    *("1e-300", "1e-46", "1e-16", "1e-15", "1e15", "1e16", "1e39", "1e300", "1e400", "-1e400"),
    *("NaN", "Infinity", "-Infinity", "1" + 400 * "0", "1" + 5000 * "0", "2147483648", "1e13"),
    *("[]", "{}", "[1, 1, 1]", "[1, 1e-300, 1]", '["1", 1, 1]', "[true, 1, 1]", "[[1]]", DEEP),
    *('"linear"', '"exponential"', '"sigmoid"', '"lumitree"', '"\\u001b[2J"', '"a\\nb"'),
    *('"\\ud800"', f'"{100_000 * "x"}"', f'"{1000 * "é"}"', "01", "", "{", '"', "\x00", "é"),
]
DTYPES = {"children": np.int32, "density": np.float32, "coefficients": np.float16}
LIGHT_FIELD_DTYPES = {"cells": np.uint8, "lit": np.uint8, "intensity": np.uint32}
SAFETENSORS = {
    **{"int32": "I32", "float32": "F32", "float16": "F16", "float64": "F64"},
    **{"uint8": "U8", "uint32": "U32"},
}


class Draft:
    """An asset about to be written: its description as JSON texts by key, and its tensors."""

    def __init__(self, asset):
        self.asset = asset
        self.tensors = {name: each.copy() for name, each in field_tensors(asset).items()}
        self.members = [
            ("format", '"lumitree"'),
            ("version", "3"),
            ("luminaire", '"test"'),
            ("tree_depth", str(asset.tree_depth)),
            ("l_max", str(asset.l_max)),
            ("law", json.dumps(asset.law)),
            ("activation", '"sigmoid"'),
            ("max_radiance", str(asset.max_radiance)),
            ("gain", str(list(asset.gain))),
            ("field", json.dumps(field_description(asset))),
            ("half_extents", str(asset.frame.half_extents.tolist())),
            ("world_from_proxy", str(asset.frame.world_from_local.tolist())),
        ]
        if (field := asset.light_field) is not None:
            self.tensors |= {name: each.copy() for name, each in light_field_tensors(field).items()}
            self.members.append(("light", json.dumps(light_field_description(field))))
        if asset.spectrum is not None:
            self.tensors |= {n: each.copy() for n, each in spectrum_tensors(asset.spectrum).items()}
            self.members.append(("spectrum", json.dumps(spectrum_description(asset.spectrum))))

    @property
    def full(self):
        """Names of the tensors that hold numbers."""
        return [name for name, array in self.tensors.items() if array.size]

    def description(self):
        return "{" + ",".join(f'"{key}":{value}' for key, value in self.members) + "}"

    def header(self, description=None):
        """Members of the header, as JSON texts by key."""
        description = self.description() if description is None else description
        try:
            checksum = _digest(description, self.tensors)
        except UnicodeEncodeError:
            checksum = "0" * 64
        metadata = json.dumps({"lumitree": f"{checksum} {description}"})
        members, end = [("__metadata__", metadata)], 0
        for name, array in self.tensors.items():
            start, end = end, end + array.nbytes
            entry = {
                "dtype": SAFETENSORS[array.dtype.name],
                "shape": array.shape,
                "data_offsets": [start, end],
            }
            members.append((name, json.dumps(entry)))
        return members

    def file(self, members=None):
        members = self.header() if members is None else members
        header = "{" + ",".join(f'"{key}":{value}' for key, value in members) + "}"
        content = header.encode("utf-8", "surrogatepass")
        body = b"".join(array.tobytes() for array in self.tensors.values())
        return struct.pack("<Q", len(content)) + content + body


def flip_tensor_bits(draft, random):
    name = random.choice(draft.full)
    data = bytearray(draft.tensors[name].tobytes())
    for _ in range(random.integers(1, 4)):
        data[random.integers(len(data))] ^= 1 << random.integers(8)
    array = draft.tensors[name]
    draft.tensors[name] = np.frombuffer(bytes(data), array.dtype).reshape(array.shape)
    return draft.file()


def flip_bits_of_the_field(draft, random):
    """Within its stream, whose own checksum is right."""

    def change(arrays):
        array = arrays[random.choice([name for name, each in arrays.items() if each.size])]
        bits = array.view(f"u{array.itemsize}")
        for _ in range(random.integers(1, 4)):
            bit = bits.dtype.type(1 << random.integers(8 * array.itemsize))
            bits.flat[random.integers(array.size)] ^= bit

    change_field_arrays(draft.tensors, draft.asset, change)
    return draft.file()


def flip_description_bits(draft, random):
    text = bytearray(draft.description().encode())
    for _ in range(random.integers(1, 4)):
        text[random.integers(len(text))] ^= 1 << random.integers(7)
    return draft.file(draft.header(text.decode("latin-1")))


def flip_header_bits(draft, random):
    content = bytearray(draft.file())
    end = 8 + struct.unpack("<Q", content[:8])[0]
    for _ in range(random.integers(1, 4)):
        content[random.integers(end)] ^= 1 << random.integers(8)
    return bytes(content)


def replace_values(draft, random):
    for _ in range(random.integers(1, 3)):
        index = random.integers(len(draft.members))
        draft.members[index] = (draft.members[index][0], VALUES[random.integers(len(VALUES))])
    return draft.file()


def replace_numbers(draft, random):
    """A number within the lists, or within the light field, of the description."""
    keys = [name for name, _ in draft.members]
    lists = ["half_extents", "world_from_proxy", "field", "light"]
    key = random.choice(lists[: 3 + ("light" in keys)])
    index = keys.index(key)
    values = json.loads(draft.members[index][1])
    if key in ("field", "light"):
        values[random.choice(list(values))] = "@"
    else:
        values = np.array(values).astype(object)
        values.flat[random.integers(values.size)] = "@"
        values = values.tolist()
    text = json.dumps(values).replace('"@"', VALUES[random.integers(len(VALUES))])
    draft.members[index] = (key, text)
    return draft.file()


def change_keys(draft, random):
    """Members of the description or of the header dropped, doubled, renamed, or exchanged."""
    inner = random.random() < 0.5
    members = draft.members if inner else draft.header()
    index, other = random.integers(len(members), size=2)
    key, value = members[index]
    names = ("extra", "\\u001b[31m", "\\n", "__metadata__", 5000 * "k", "\\ud800")
    match random.integers(4):
        case 0:
            del members[index]
        case 1:
            members.append((key, members[other][1]))
        case 2:
            members[index] = (names[random.integers(len(names))], value)
        case 3:
            members[index] = (key, members[other][1])
    return draft.file(None if inner else members)


def change_tensors(draft, random):
    """Tensors cut, reshaped, of other types, or with extreme numbers."""
    name = random.choice(draft.full)
    array = draft.tensors[name]
    match random.integers(5):
        case 0:
            array = array[: random.integers(len(array))]
        case 1:
            array = array.reshape([(-1,), (1, -1), (*array.shape, 1)][random.integers(3)])
        case 2:
            array = array.astype([np.float64, np.uint8, np.int32][random.integers(3)])
        case 3:
            array = array[random.permutation(len(array))]
        case 4:
            kind = np.finfo if array.dtype.kind == "f" else np.iinfo
            extremes = [kind(array.dtype).max, kind(array.dtype).min, 0, 1]
            if array.dtype.kind != "u":
                extremes.append(-1)
            if array.dtype.kind == "f":
                extremes += [np.inf, np.nan, kind(array.dtype).smallest_subnormal]
            value = extremes[random.integers(len(extremes))]
            array.flat[random.integers(array.size)] = value
    draft.tensors[name] = array
    return draft.file()


def change_header_values(draft, random):
    """Types, shapes and offsets of tensors, and the metadata."""
    members = draft.header()
    index = random.integers(len(members))
    key, text = members[index]
    entry = json.loads(text)
    inner = random.choice(list(entry))
    entry[inner] = "@"
    text = json.dumps(entry).replace('"@"', VALUES[random.integers(len(VALUES))])
    members[index] = (key, text)
    return draft.file(members)


def assert_sound(asset):
    assert type(asset.tree_depth) is int
    assert 1 <= asset.tree_depth <= MAX_TREE_DEPTH
    assert type(asset.l_max) is int
    assert 0 <= asset.l_max <= MAX_L
    assert asset.law in LAWS
    assert type(asset.max_radiance) is float
    assert MIN_RADIANCE <= asset.max_radiance <= MAX_RADIANCE
    assert asset.frame.half_extents.shape == (3,)
    assert asset.frame.half_extents.min() >= MIN_HALF_EXTENT
    assert abs(asset.frame.half_extents.max() - 1) < 1e-6
    assert np.abs(asset.frame.world_from_local).max() <= MAX_SCALE
    assert similarity_scale(asset.frame.world_from_local) >= MIN_SCALE
    assert type(asset.luminaire) is str
    assert asset.luminaire.isprintable()
    assert len(asset.luminaire) <= MAX_LABEL
    for name, dtype in DTYPES.items():
        assert getattr(asset, name).dtype == dtype
    assert asset.density.min(initial=0) >= 0
    assert asset.density.max(initial=0) <= MAX_DENSITY
    assert asset.coefficients.shape == (asset.num_leaves, 3, num_coefficients(asset.l_max))
    assert np.isfinite(asset.coefficients).all()
    lower, upper = leaf_boxes(asset)
    sides = np.rint(np.log2(2 / (upper - lower)))
    assert sides.max(initial=1) <= asset.tree_depth
    # Leaves do not overlap: together they fill at most the cube.
    assert ((upper - lower) ** 3)[:, 0].sum() <= 8
    if asset.light_field is not None:
        assert_sound_field(asset.light_field)
    if asset.spectrum is not None:
        assert asset.spectrum.power.dtype == np.float32
        assert asset.spectrum.power.shape == (471,)
        assert asset.spectrum.power.min() >= 0
        assert asset.spectrum.power.max() == 1
        assert 0 < asset.spectrum.share <= 1


def assert_sound_field(field):
    """What the emitter of `rendering` computes with is in range."""
    assert type(field.depth) is type(field.resolution) is int
    assert type(field.scale) is float
    assert 1 <= field.depth <= MAX_DEPTH
    assert field.resolution in [2**power for power in range(2, 8)]
    assert field.resolution <= MAX_RESOLUTION
    for name, dtype in LIGHT_FIELD_DTYPES.items():
        assert getattr(field, name).dtype == dtype
    count, bins = len(field.cells), field.resolution**2
    assert 0 < count * bins <= MAX_BINS
    assert field.cells.shape == (count, 3)
    assert field.cells.max() < 2**field.depth
    assert len(np.unique(field.cells, axis=0)) == count
    dense = field.dense(unpack(field.intensity).sum(axis=1))
    assert dense.shape == (count, bins)
    assert (dense.sum(axis=1) > 0).all()
    intensity = (unpack(field.intensity) * field.scale).astype(np.float32)
    assert np.isfinite(intensity).all()
    assert (intensity.max(axis=1) > 0).all()


@pytest.fixture(scope="module", params=["field", "both", "light", "spectrum"])
def asset(request):
    """An asset with a field, with a light field too, with the latter alone, or with a spectrum."""
    plain = random_asset(0, tree_depth=3, l_max=1, half_extents=np.array([1.0, 0.5, 0.25]))
    return {
        "field": plain,
        "both": replace(plain, light_field=random_light_field(0, traced=TRACED)),
        "light": light_field_asset(random_light_field(0), plain.frame, "test"),
        "spectrum": light_field_asset(random_light_field(0), plain.frame, "test", SPECTRUM),
    }[request.param]


def test_the_draft_is_the_file(asset, tmp_path):
    """Unchanged, what this test writes loads: mutations reach the checks behind the checksum."""
    (tmp_path / "draft.lumitree").write_bytes(Draft(asset).file())
    save(load(tmp_path / "draft.lumitree"), tmp_path / "again.lumitree")
    save(asset, tmp_path / "saved.lumitree")
    content = (tmp_path / "again.lumitree").read_bytes()
    assert content == (tmp_path / "saved.lumitree").read_bytes()


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "mutate",
    [
        flip_tensor_bits,
        flip_bits_of_the_field,
        flip_description_bits,
        flip_header_bits,
        replace_values,
        replace_numbers,
        change_keys,
        change_tensors,
        change_header_values,
    ],
)
def test_mutations_are_sound_or_refused(asset, tmp_path, mutate):
    path, again = tmp_path / "mutant.lumitree", tmp_path / "again.lumitree"
    refused = 0
    for number in range(ROUNDS):
        path.write_bytes(mutate(Draft(asset), np.random.default_rng(number)))
        try:
            mutant = load(path)
        except LumitreeError as error:
            message = str(error)
            assert "mutant.lumitree" in message
            assert message.isprintable(), number
            assert len(message) < 1000, number
            refused += 1
        else:
            assert_sound(mutant)
            save(mutant, again)
            loaded = load(again)
            assert loaded.luminaire == mutant.luminaire
            assert (loaded.light_field is None) == (mutant.light_field is None)
            assert (loaded.spectrum is None) == (mutant.spectrum is None)
            if mutant.light_field is not None:
                assert_equal_fields(loaded.light_field, mutant.light_field)
    assert refused > ROUNDS // 8
