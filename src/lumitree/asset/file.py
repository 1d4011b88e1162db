"""The `.lumitree` file: one safetensors container, laid out in docs/format.md."""

import dataclasses
import hashlib
import json
import os
import struct
from typing import Annotated, Literal

import numpy as np
import safetensors
import safetensors.numpy

from lumitree.asset.array_stream import Arrays
from lumitree.asset.asset import Asset, EmittedSpectrum
from lumitree.asset.field_file import FieldSizes, build_field, rounded_field, stored_field
from lumitree.asset.geometry_file import (
    GEOMETRY_SHAPES,
    GEOMETRY_TENSORS,
    build_geometry,
    geometry_tensors,
)
from lumitree.asset.light_field_file import LightDescription, build_light_field, stored_light_field
from lumitree.core.file_kinds import ASSET, what_it_is
from lumitree.core.files import atomic_path
from lumitree.core.frames import LocalFrame, with_frame
from lumitree.core.harmonics import MAX_L
from lumitree.core.photometry import RGB
from lumitree.core.reading import parse_json, read_bytes
from lumitree.core.tables import Range, check_version, converted, shown_value
from lumitree.core.transmittance import Law
from lumitree.errors import LumitreeError, shown

FORMAT = "lumitree"
VERSION = 4
ACTIVATION = "sigmoid"
_MAX_HEADER_BYTES = 1 << 20
MAX_BYTES = 1 << 32


@dataclasses.dataclass(frozen=True)
class _Spectrum:
    share: float


@dataclasses.dataclass(frozen=True, kw_only=True)
class _Description:
    format: str
    version: int
    luminaire: str
    tree_depth: int
    l_max: Annotated[int, Range(0, MAX_L)]
    law: Law
    activation: Literal["sigmoid"]
    max_radiance: float
    gain: RGB
    field: FieldSizes
    frame: LocalFrame
    light: LightDescription | None = None
    spectrum: _Spectrum | None = None
    fingerprint: str = ""


@dataclasses.dataclass(frozen=True)
class _Tensor:
    """A tensor in the header; safetensors checks whether its values fit the file."""

    dtype: str
    shape: tuple[int, ...]
    data_offsets: tuple[int, ...]


def save(asset: Asset, path: str | os.PathLike[str], *, fingerprint: str = "") -> None:
    """Write an asset to a file; equal assets give equal bytes.

    The field is rounded: densities by at most 3.2 %, and coefficients by at most 1/64 in band 0 and
    by 1/8 to 1 in the others, less the brighter a leaf is. The light field, the geometry and
    the spectrum are stored as they are.

    The file appears, or replaces another one, only when it is complete.

    Args:
        asset: the asset to write.
        path: path of the file, usually with the suffix `.lumitree`.
        fingerprint: of the luminaire and the settings of its bake, for `fingerprint_of`.

    Raises:
        LumitreeError: the file cannot be written.
    """
    tensors, field = stored_field(asset)
    description = {
        "format": FORMAT,
        "version": VERSION,
        "luminaire": asset.luminaire,
        "tree_depth": asset.tree_depth,
        "l_max": asset.l_max,
        "law": asset.law,
        "activation": ACTIVATION,
        "max_radiance": asset.max_radiance,
        "gain": asset.light_factors,
        "field": field,
        **asset.frame.members(),
    }
    if asset.light_field is not None:
        light, description["light"] = stored_light_field(asset.light_field)
        tensors |= light
    if asset.geometry is not None:
        tensors |= geometry_tensors(asset.geometry)
    if asset.spectrum is not None:
        tensors["spectrum.power"] = asset.spectrum.power
        description["spectrum"] = {"share": asset.spectrum.share}
    if fingerprint:
        description["fingerprint"] = fingerprint
    text = json.dumps(description, sort_keys=True, separators=(",", ":"), allow_nan=False)
    # One key only: safetensors does not keep the order of several keys.
    metadata = {"lumitree": f"{_digest(text, tensors)} {text}"}
    with atomic_path(path) as temporary:
        arrays = {name: np.ascontiguousarray(array) for name, array in tensors.items()}
        # Not by `save_file`: its temporary file stays if the process is killed.
        temporary.write_bytes(safetensors.numpy.save(arrays, metadata))


def as_stored(asset: Asset) -> Asset:
    """The asset that `load` gives back of a file of it: its field is rounded (`field_file`)."""
    return dataclasses.replace(asset, **rounded_field(asset))


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
    begins = content[8:9] == b"{" and _header_bytes(content) <= _MAX_HEADER_BYTES
    what = ASSET if begins else what_it_is(path, content) or "a file of another kind"
    if what != ASSET:
        raise LumitreeError(
            f"{shown(path, 300)} is {what}, not a .lumitree asset; expected a file that `lumitree "
            "bake` made of a luminaire or of a photometric file"
        )
    try:
        digest, text, description = _read_header(content)
        tensors = safetensors.numpy.load(content)
        if digest != _digest(text, tensors):
            raise LumitreeError("the checksum does not match its content")
        return _build(description, tensors)
    except (safetensors.SafetensorError, LumitreeError) as error:
        raise LumitreeError(
            f"{path} is not a valid .lumitree asset: {error}; bake it again"
        ) from None


def fingerprint_of(path: str | os.PathLike[str]) -> str:
    """The fingerprint with which a file was saved; empty if it has none.

    Raises:
        LumitreeError: the file is not an asset of this version.
    """
    return _read_header(read_bytes(path, "a .lumitree asset", MAX_BYTES))[2].fingerprint


def _build(description: _Description, tensors: Arrays) -> Asset:
    light, spectrum = None, None
    if description.light is not None:
        light = build_light_field(description.light, tensors)
    if description.spectrum is not None:
        spectrum = EmittedSpectrum(tensors["spectrum.power"], description.spectrum.share)
    return Asset(
        **build_field(description.field, description.l_max, tensors),
        tree_depth=description.tree_depth,
        l_max=description.l_max,
        law=description.law,
        max_radiance=description.max_radiance,
        frame=description.frame,
        luminaire=description.luminaire,
        light_field=light,
        geometry=build_geometry(tensors) if GEOMETRY_SHAPES in tensors else None,
        light_factors=description.gain,
        spectrum=spectrum,
    )


def _header_bytes(content: bytes) -> int:
    return struct.unpack("<Q", content[:8])[0] if len(content) >= 8 else len(content)


def _read_header(content: bytes) -> tuple[str, str, _Description]:
    """Checksum and description of a file; refuses every header that lumitree does not write.

    safetensors itself accepts a repeated key, and uses the last of its values.
    """
    size = len(content)
    length = _header_bytes(content)
    if length > min(_MAX_HEADER_BYTES, size - 8):
        raise LumitreeError(
            f"a header of {length} bytes in a file of {size} (limit {_MAX_HEADER_BYTES})"
        )
    header = parse_json(content[8 : 8 + length])
    metadata = header.pop("__metadata__", None) if isinstance(header, dict) else None
    if not isinstance(header, dict) or not isinstance(metadata, dict) or len(metadata) != 1:
        raise LumitreeError("its header has no __metadata__ of lumitree")
    digest, _, text = str(metadata.get(FORMAT)).partition(" ")
    # Checked first, because files of other versions may have other members and tensors.
    members = check_version(parse_json(text), VERSION)
    if members.get("format") != FORMAT:
        raise LumitreeError(f"its format is {shown_value(members.get('format'))}")
    description = converted(with_frame(members, "frame"), _Description)
    expected = {"field.stream": "U8"}
    if description.light is not None:
        expected["light.stream"] = "U8"
    if GEOMETRY_SHAPES in header:
        expected |= GEOMETRY_TENSORS
    if description.spectrum is not None:
        expected["spectrum.power"] = "F32"
    found = {name: converted(each, _Tensor, name=name).dtype for name, each in header.items()}
    if found != expected:
        name = min({*found, *expected}, key=lambda name: found.get(name) == expected.get(name))
        raise LumitreeError(
            f"its tensor {shown(name)} is {shown(found.get(name, 'missing'))}; expected "
            f"{expected.get(name, 'no such tensor')}"
        )
    return digest, text, description


def _digest(text: str, tensors: Arrays) -> str:
    """SHA-256 over the description, then each tensor's name, shape and little-endian bytes."""
    digest = hashlib.sha256(text.encode())
    for name in sorted(tensors):
        array = np.ascontiguousarray(tensors[name])
        digest.update(f"{name}{list(array.shape)}".encode())
        digest.update(array.data if array.size else b"")
    return digest.hexdigest()
