"""Assets about to be written, and changes of them that leave the checksum right."""

import json
import struct

import numpy as np

from lumitree.asset.field_file import stored_field
from lumitree.asset.file import _digest
from lumitree.asset.geometry_file import geometry_tensors
from lumitree.asset.light_field_file import stored_light_field
from support.stored_arrays import change_field_arrays

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
SAFETENSORS = {
    **{"int32": "I32", "float32": "F32", "float16": "F16", "float64": "F64"},
    **{"uint8": "U8", "uint32": "U32"},
}


class Draft:
    """An asset about to be written: its description as JSON texts by key, and its tensors."""

    def __init__(self, asset):
        self.asset = asset
        tensors, stored = stored_field(asset)
        self.members = [
            ("format", '"lumitree"'),
            ("version", "4"),
            ("luminaire", '"test"'),
            ("tree_depth", str(asset.tree_depth)),
            ("l_max", str(asset.l_max)),
            ("law", json.dumps(asset.law)),
            ("activation", '"sigmoid"'),
            ("max_radiance", str(asset.max_radiance)),
            ("gain", str(list(asset.light_factors))),
            ("field", json.dumps(stored)),
            ("half_extents", str(asset.frame.half_extents.tolist())),
            ("world_from_proxy", str(asset.frame.world_from_local.tolist())),
        ]
        if (field := asset.light_field) is not None:
            light, stored = stored_light_field(field)
            tensors |= light
            self.members.append(("light", json.dumps(stored)))
        if asset.spectrum is not None:
            tensors["spectrum.power"] = asset.spectrum.power
            self.members.append(("spectrum", json.dumps({"share": asset.spectrum.share})))
        if asset.geometry is not None:
            tensors |= geometry_tensors(asset.geometry)
        self.tensors = {name: each.copy() for name, each in tensors.items()}

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


CHANGES = (
    flip_tensor_bits,
    flip_bits_of_the_field,
    flip_description_bits,
    flip_header_bits,
    replace_values,
    replace_numbers,
    change_keys,
    change_tensors,
    change_header_values,
)
