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

from lumitree.asset.asset import NO_GAIN, Asset
from lumitree.asset.exitant_bytes import (
    COMPRESSED_TENSORS,
    PLAIN_TENSORS,
    build_exitant,
    exitant_description,
    exitant_tensors,
)
from lumitree.asset.model import NO_ORIGIN
from lumitree.asset.model_bytes import MODEL_TENSORS, build_model, model_tensors
from lumitree.core.file_kinds import ASSET, what_it_is
from lumitree.core.files import atomic_path
from lumitree.core.frames import FRAME_KEYS, LocalFrame
from lumitree.core.reading import Record, parse_json, read_bytes
from lumitree.core.transmittance import LAWS
from lumitree.errors import LumitreeError, shown

FORMAT = "lumitree"
# Files without an exitant light field have the first version, those without a model at most the
# second, those with neither a gain nor images of a model at most the third, those whose model has
# no media at most the fourth, those whose model has no origin at most the fifth, those without
# light inside the box at most the sixth, and those without media that scatter at most the seventh,
# which older readers know. Images are compressed from the fourth, exitant light fields with light
# inside the box from the seventh.
VERSION, VERSION_WITH_EXITANT, VERSION_WITH_MODEL, VERSION_WITH_GAIN = 1, 2, 3, 4
VERSION_WITH_MEDIA, VERSION_WITH_ORIGIN, VERSION_WITH_INSIDE = 5, 6, 7
VERSION_WITH_SCATTERING = 8
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
    *FRAME_KEYS,
)


def save(asset: Asset, path: str | os.PathLike[str]) -> None:
    """Write an asset to a file; equal assets give equal bytes.

    The file appears, or replaces another one, only when it is complete.

    Args:
        asset: the asset to write.
        path: path of the file, usually with the suffix `.lumitree`.

    Raises:
        LumitreeError: the file cannot be written.
    """
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
        **asset.frame.members(),
    }
    if (exitant := asset.exitant) is not None:
        tensors |= exitant_tensors(exitant)
        description["version"] = VERSION_WITH_EXITANT
        description["exitant"] = exitant_description(exitant)
    if asset.model is not None:
        tensors |= model_tensors(asset.model)
        description["version"] = VERSION_WITH_MODEL
    needed = _version_of(asset)
    if needed >= VERSION_WITH_GAIN:
        description["version"] = needed
        description["gain"] = asset.gain
    text = json.dumps(description, sort_keys=True, separators=(",", ":"), allow_nan=False)
    # One key only: safetensors does not keep the order of several keys.
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


def _version_of(asset: Asset) -> int:
    """The version that the gain, the light inside the box and the model of an asset need."""
    model, exitant = asset.model, asset.exitant
    if model is not None and model.has_scattering:
        return VERSION_WITH_SCATTERING
    if exitant is not None and exitant.inside is not None:
        return VERSION_WITH_INSIDE
    if model is not None and model.origin != NO_ORIGIN:
        return VERSION_WITH_ORIGIN
    if model is not None and model.has_media:
        return VERSION_WITH_MEDIA
    has_images = model is not None and len(model.images) > 0
    return VERSION_WITH_GAIN if asset.gain != NO_GAIN or has_images else VERSION


def load(path: str | os.PathLike[str]) -> Asset:
    """Read an asset from a file, and check it. Nothing in the file is executed.

    Args:
        path: path of a `.lumitree` file.

    Returns:
        The asset.

    Raises:
        LumitreeError: the file is missing, damaged or not an asset, or breaks an invariant.
    """
    content = read_bytes(path, "a .lumitree asset", MAX_BYTES)
    if (what := _other_kind(path, content)) is not None:
        raise LumitreeError(
            f"{shown(path, 300)} is {what}, not a .lumitree asset; expected a file that `lumitree "
            "bake` made of a luminaire or of a photometric file"
        )
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
    # Checked first, because files of other versions may have other members.
    description.choice("format", (FORMAT,))
    version = description.expect_version(
        VERSION,
        VERSION_WITH_EXITANT,
        VERSION_WITH_MODEL,
        VERSION_WITH_GAIN,
        VERSION_WITH_MEDIA,
        VERSION_WITH_ORIGIN,
        VERSION_WITH_INSIDE,
        VERSION_WITH_SCATTERING,
    )
    # A file of the eighth version may have light inside the box.
    may_have_inside = version > VERSION_WITH_INSIDE and "exitant.light" in tensors
    has_inside = version == VERSION_WITH_INSIDE or may_have_inside
    # A file of the third version or a later one may have an exitant light field.
    optional = version >= VERSION_WITH_MODEL and description.has("exitant")
    has_exitant = version == VERSION_WITH_EXITANT or has_inside or optional
    has_gain = version >= VERSION_WITH_GAIN
    has_model = version == VERSION_WITH_MODEL or (has_gain and "model.shapes" in tensors)
    description.expect_keys(
        *_KEYS, *(["exitant"] if has_exitant else []), *(["gain"] if has_gain else [])
    )
    description.choice("activation", (ACTIVATION,))
    exitant = None
    if has_exitant:
        record = description.record("exitant")
        exitant = build_exitant(record, tensors, compressed=has_inside)
    model = build_model(tensors, compressed=has_gain) if has_model else None
    if model is not None and model.has_media and version < VERSION_WITH_MEDIA:
        raise LumitreeError(f"version {version} has no media")
    if model is not None and model.has_scattering and version < VERSION_WITH_SCATTERING:
        raise LumitreeError(f"version {version} has no media that scatter light")
    if model is not None and model.origin != NO_ORIGIN and version < VERSION_WITH_ORIGIN:
        raise LumitreeError(f"version {version} has no origin of a model")
    red, green, blue = description.array("gain", 3).tolist() if has_gain else NO_GAIN
    stored = COMPRESSED_TENSORS if has_inside else PLAIN_TENSORS
    expected = {*_TENSORS, *(stored if has_exitant else ())}
    if extra := tensors.keys() - expected - (MODEL_TENSORS.keys() if model is not None else set()):
        raise LumitreeError(f"version {version} has no tensor {min(extra)}")
    return Asset(
        **{name: tensors[name] for name in _TENSORS},
        tree_depth=description.integer("tree_depth"),
        l_max=description.integer("l_max"),
        law=description.choice("law", LAWS),
        max_radiance=description.number("max_radiance"),
        frame=LocalFrame.of_record(description),
        luminaire=description.label("luminaire"),
        exitant=exitant,
        model=model,
        gain=(red, green, blue),
    )


def _other_kind(path: str | os.PathLike[str], content: bytes) -> str | None:
    """What a file is that does not begin as an asset; None for an asset, damaged or not."""
    if content[8:9] == b"{" and _header_bytes(content) <= _MAX_HEADER_BYTES:
        return None
    what = what_it_is(path, content) or "a file of another kind"
    return None if what == ASSET else what


def _header_bytes(content: bytes) -> int:
    return struct.unpack("<Q", content[:8])[0] if len(content) >= 8 else len(content)


def _read_header(content: bytes) -> str:
    """The metadata of a file; refuses every header that lumitree does not write.

    safetensors itself accepts a repeated key, and uses the last of its values.
    """
    size = len(content)
    length = _header_bytes(content)
    if length > min(_MAX_HEADER_BYTES, size - 8):
        raise LumitreeError(
            f"a header of {length} bytes in a file of {size} (limit {_MAX_HEADER_BYTES})"
        )
    header = Record(parse_json(content[8 : 8 + length]), "the header")
    tensors = dict(_TENSORS)
    if header.has("exitant.cells"):
        tensors |= PLAIN_TENSORS
    if header.has("exitant.light"):
        tensors |= COMPRESSED_TENSORS
    if header.has("model.shapes"):
        tensors |= MODEL_TENSORS
    header.expect_keys("__metadata__", *tensors)
    for name, dtype in tensors.items():
        tensor = header.record(name)
        tensor.expect_keys("dtype", "shape", "data_offsets")
        tensor.choice("dtype", (dtype,))
        # safetensors checks their values, and whether they fit the file.
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
