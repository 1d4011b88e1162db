"""The model of an asset as tensors of its file, see docs/format.md.

Shapes, materials and the sizes of images are one JSON text. Images follow each other as bytes.
"""

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.materials import Json
from lumitree.asset.model import ARRAYS, MAX_IMAGE_SIDE, MAX_IMAGES, MAX_SHAPES, AssetModel
from lumitree.core.reading import Record, parse_json
from lumitree.errors import LumitreeError

_DTYPES = {np.float32: "F32", np.uint32: "U32"}
MODEL_TENSORS = {
    "model.shapes": "U8",
    "model.images": "U8",
    **{f"model.{name}": _DTYPES[dtype] for name, (dtype, _) in ARRAYS.items()},  # type: ignore[index]
}
# Largest JSON text; a shape takes about 200 bytes.
_MAX_TEXT = 1 << 24
_PIXELS: dict[str, Any] = {"uint8": np.uint8, "float32": np.dtype("<f4")}


def model_tensors(model: AssetModel) -> dict[str, NDArray[Any]]:
    """Tensors of a model, by name."""
    description = {
        "images": [{"shape": list(i.shape), "dtype": str(i.dtype)} for i in model.images],
        "materials": list(model.materials),
        "shapes": list(model.shapes),
    }
    text = json.dumps(description, sort_keys=True, separators=(",", ":"), allow_nan=False)
    pixels = b"".join(image.astype(_PIXELS[str(image.dtype)]).tobytes() for image in model.images)
    return {
        "model.shapes": np.frombuffer(text.encode(), np.uint8),
        "model.images": np.frombuffer(pixels, np.uint8),
        **{f"model.{name}": array for name, array in model.arrays.items()},
    }


def build_model(tensors: dict[str, NDArray[Any]]) -> AssetModel:
    """The model of a file's tensors; the inverse of `model_tensors`.

    Raises:
        LumitreeError: a tensor is missing, or the model is invalid.
    """
    if not tensors.keys() >= MODEL_TENSORS.keys():
        raise LumitreeError("the tensors of the model are missing")
    text = tensors["model.shapes"].tobytes()
    if len(text) > _MAX_TEXT:
        raise LumitreeError(f"the model's description has {len(text)} bytes (limit {_MAX_TEXT})")
    description = Record(parse_json(text), "the model")
    description.expect_keys("images", "materials", "shapes")
    return AssetModel(
        **{name: tensors[f"model.{name}"] for name in ARRAYS},
        images=_images(description.items("images"), tensors["model.images"].tobytes()),
        shapes=tuple(description.items("shapes")[: MAX_SHAPES + 1]),
        materials=tuple(description.items("materials")),
    )


def _images(descriptions: list[Json], content: bytes) -> tuple[NDArray[Any], ...]:
    if len(descriptions) > MAX_IMAGES:
        raise LumitreeError(f"the model has {len(descriptions)} images (limit {MAX_IMAGES})")
    images, start = [], 0
    for each in descriptions:
        record = Record(each, "an image")
        record.expect_keys("shape", "dtype")
        dtype = np.dtype(_PIXELS[record.choice("dtype", tuple(_PIXELS))])
        shape = record.integers("shape")
        if len(shape) != 3 or not all(0 < side <= MAX_IMAGE_SIDE for side in shape):
            raise LumitreeError(f"an image of the model has the shape {str(shape)[:60]}")
        count = int(np.prod(shape))
        end = start + count * dtype.itemsize
        if end > len(content):
            raise LumitreeError(f"the images of the model have {len(content)} bytes, not {end}")
        pixels = np.frombuffer(content, dtype, count, start).reshape(shape)
        images.append(pixels.astype(dtype.newbyteorder("=")))
        start = end
    if start != len(content):
        raise LumitreeError(f"the images of the model have {len(content)} bytes, not {start}")
    return tuple(images)
