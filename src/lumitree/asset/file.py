"""The `.lumitree` file: one safetensors container, laid out in docs/format.md."""

import hashlib
import json
import os
import struct
from typing import Any

import numpy as np
import safetensors
import safetensors.numpy
from numpy.typing import NDArray

from lumitree.asset.asset import Asset
from lumitree.core.files import atomic_path
from lumitree.core.reading import Record, parse_json, read_bytes
from lumitree.core.transmittance import LAWS
from lumitree.errors import LumitreeError

FORMAT = "lumitree"
VERSION = 1
ACTIVATION = "sigmoid"
_MAX_HEADER_BYTES = 1 << 20
# Three million leaves, the most that a bake makes, take at most 0.6 GB.
MAX_BYTES = 1 << 32
_TENSORS = {"children": "I32", "density": "F32", "coefficients": "F16"}
_KEYS = (
    "format",
    "version",
    "luminaire",
    "tree_depth",
    "l_max",
    "law",
    "activation",
    "max_radiance",
    "half_extents",
    "world_from_proxy",
)


def save(asset: Asset, path: str | os.PathLike[str]) -> None:
    """Write `asset` to `path`, atomically; equal assets give equal bytes."""
    tensors = {
        "children": asset.children,
        "density": asset.density,
        "coefficients": asset.coefficients,
    }
    description = {
        "format": FORMAT,
        "version": VERSION,
        "luminaire": asset.luminaire,
        "tree_depth": asset.tree_depth,
        "l_max": asset.l_max,
        "law": asset.law,
        "activation": ACTIVATION,
        "max_radiance": asset.max_radiance,
        "half_extents": asset.half_extents.tolist(),
        "world_from_proxy": asset.world_from_proxy.tolist(),
    }
    text = json.dumps(description, sort_keys=True, separators=(",", ":"), allow_nan=False)
    # One key only: safetensors does not keep the order of several.
    metadata = {"lumitree": f"{_digest(text, tensors)} {text}"}
    with atomic_path(path) as temporary:
        try:
            safetensors.numpy.save_file(
                {name: np.ascontiguousarray(array) for name, array in tensors.items()},
                temporary,
                metadata,
            )
        except safetensors.SafetensorError as error:
            raise OSError(None, str(error)) from error


def load(path: str | os.PathLike[str]) -> Asset:
    """Read and check an asset; no code in the file is run.

    Raises:
        LumitreeError: the file is missing, is no asset, is damaged or breaks an invariant.
    """
    content = read_bytes(path, "a .lumitree asset", MAX_BYTES)
    try:
        digest, _, text = _read_header(content).partition(" ")
        tensors = safetensors.numpy.load(content)
        if digest != _digest(text, tensors):
            raise LumitreeError("the checksum does not match its content")
        return _build(parse_json(text), tensors)
    except (safetensors.SafetensorError, LumitreeError) as error:
        raise _damaged(path, str(error)) from None


def _build(value: Any, tensors: dict[str, NDArray[Any]]) -> Asset:
    description = Record(value, "the description")
    # First: another version may have other members.
    description.choice("format", (FORMAT,))
    description.expect_version(VERSION)
    description.expect_keys(*_KEYS)
    description.choice("activation", (ACTIVATION,))
    return Asset(
        **tensors,
        tree_depth=description.integer("tree_depth"),
        l_max=description.integer("l_max"),
        law=description.choice("law", LAWS),
        max_radiance=description.number("max_radiance"),
        half_extents=description.array("half_extents", 3),
        world_from_proxy=description.array("world_from_proxy", 4, 4),
        luminaire=description.label("luminaire"),
    )


def _read_header(content: bytes) -> str:
    """The metadata of a file; refuses every header that is not one of ours.

    safetensors itself takes the last of two members of one name.
    """
    size = len(content)
    length = struct.unpack("<Q", content[:8])[0] if size >= 8 else size
    if length > min(_MAX_HEADER_BYTES, size - 8):
        raise LumitreeError(
            f"a header of {length} bytes in a file of {size} (limit {_MAX_HEADER_BYTES})"
        )
    header = Record(parse_json(content[8 : 8 + length]), "the header")
    header.expect_keys("__metadata__", *_TENSORS)
    for name, dtype in _TENSORS.items():
        tensor = header.record(name)
        tensor.expect_keys("dtype", "shape", "data_offsets")
        tensor.choice("dtype", (dtype,))
        # What these say, and whether they fit the file, safetensors checks.
        for key in ("shape", "data_offsets"):
            tensor.integers(key)
    metadata = header.record("__metadata__")
    metadata.expect_keys("lumitree")
    return metadata.text("lumitree", _MAX_HEADER_BYTES)


def _digest(text: str, tensors: dict[str, NDArray[Any]]) -> str:
    """SHA-256 over the description, then each tensor's name, shape and little-endian bytes."""
    digest = hashlib.sha256(text.encode())
    for name in sorted(tensors):
        array = np.ascontiguousarray(tensors[name])
        digest.update(f"{name}{list(array.shape)}".encode())
        digest.update(array.data if array.size else b"")
    return digest.hexdigest()


def _damaged(path: str | os.PathLike[str], reason: str) -> LumitreeError:
    return LumitreeError(f"{path} is not a valid .lumitree asset: {reason}; bake it again")
