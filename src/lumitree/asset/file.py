"""The `.lumitree` file: one safetensors container, laid out in docs/format.md."""

import hashlib
import json
import os
import struct
from pathlib import Path
from typing import Any

import numpy as np
import safetensors
import safetensors.numpy
from numpy.typing import NDArray

from lumitree.asset.model import LuminaireAsset
from lumitree.core.files import atomic_path
from lumitree.errors import LumitreeError

FORMAT = "lumitree"
VERSION = 1
_MAX_HEADER_BYTES = 1 << 20
_TENSORS = {"children": "I32", "density": "F32", "coefficients": "F16"}


def save(asset: LuminaireAsset, path: str | os.PathLike[str]) -> None:
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
        "activation": "sigmoid",
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


def load(path: str | os.PathLike[str]) -> LuminaireAsset:
    """Read and check an asset; no code in the file is run.

    Raises:
        LumitreeError: the file is missing, is no asset, is damaged or breaks an invariant.
    """
    path = Path(path)
    _check_header(path)
    try:
        with safetensors.safe_open(path, framework="np") as file:
            metadata = file.metadata() or {}
            found = {name: file.get_slice(name).get_dtype() for name in file.keys()}  # noqa: SIM118
            if found != _TENSORS:
                raise _damaged(path, f"tensors {found}, expected {_TENSORS}")
            tensors = {name: file.get_tensor(name) for name in _TENSORS}
        digest, _, text = metadata["lumitree"].partition(" ")
        if digest != _digest(text, tensors):
            raise _damaged(path, "the checksum does not match its content")
        return _build(json.loads(text), tensors)
    except (safetensors.SafetensorError, ValueError, KeyError, TypeError) as error:
        raise _damaged(path, f"{type(error).__name__}: {error}") from None
    except LumitreeError as error:
        if str(path) in str(error):
            raise
        raise LumitreeError(f"{path}: {error}") from None


def _build(description: dict[str, Any], tensors: dict[str, NDArray[Any]]) -> LuminaireAsset:
    if description["format"] != FORMAT or description["version"] != VERSION:
        raise LumitreeError(
            f"format {description['format']!r} version {description['version']!r}; this lumitree "
            f"reads {FORMAT!r} version {VERSION}"
        )
    if description["activation"] != "sigmoid":
        raise LumitreeError(f"activation {description['activation']!r}, expected 'sigmoid'")
    return LuminaireAsset(
        **tensors,
        tree_depth=description["tree_depth"],
        l_max=description["l_max"],
        law=description["law"],
        max_radiance=float(description["max_radiance"]),
        half_extents=np.asarray(description["half_extents"], np.float64),
        world_from_proxy=np.asarray(description["world_from_proxy"], np.float64),
        luminaire=str(description["luminaire"]),
    )


def _check_header(path: Path) -> None:
    """Refuse a file whose header could not be one of ours, before a parser sees it."""
    if not path.is_file():
        raise LumitreeError(f"{path} does not exist; expected a .lumitree asset")
    size = path.stat().st_size
    with open(path, "rb") as file:
        start = file.read(8)
    header = struct.unpack("<Q", start)[0] if len(start) == 8 else size
    if header > min(_MAX_HEADER_BYTES, size - 8):
        raise _damaged(
            path, f"a header of {header} bytes in a file of {size} (limit {_MAX_HEADER_BYTES})"
        )


def _digest(text: str, tensors: dict[str, NDArray[Any]]) -> str:
    """SHA-256 over the description, then each tensor's name, shape and little-endian bytes."""
    digest = hashlib.sha256(text.encode())
    for name in sorted(tensors):
        array = np.ascontiguousarray(tensors[name])
        digest.update(f"{name}{list(array.shape)}".encode())
        digest.update(array.data if array.size else b"")
    return digest.hexdigest()


def _damaged(path: Path, reason: str) -> LumitreeError:
    return LumitreeError(f"{path} is not a valid .lumitree asset: {reason}; bake it again")
