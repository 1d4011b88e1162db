"""Helpers of the tests of glTF materials."""

import warnings

import numpy as np

from lumitree.errors import LumitreeWarning
from lumitree.lamp.importers.gltf import read_gltf

RAMP = np.arange(4 * 8 * 3).reshape(4, 8, 3) * 2 + 20
PLASTIC = {"metallicFactor": 0}


def material_of(tmp_path, gltf, fields, notes="", **options):
    """The only material of a square that wears it; its warning matches `notes`."""
    gltf.quad(gltf.material(**fields), **options)
    return read_only(gltf.save(tmp_path), notes).materials[0]


def images_of(tmp_path, gltf, fields, notes=""):
    """As `material_of`, and a function of a texture that returns its pixels."""
    gltf.quad(gltf.material(**fields))
    model = read_only(gltf.save(tmp_path), notes)
    return model.materials[0], lambda texture: model.images[texture.image]


def read_only(path, notes="", variant=None):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        model = read_gltf(path, variant=variant)
    texts = [str(entry.message) for entry in caught]
    assert all(entry.category is LumitreeWarning for entry in caught)
    assert all("\n" not in text for text in texts)
    if notes:
        assert len(texts) == 1
        assert notes in texts[0]
    else:
        assert texts == []
    return model


def extended(core=None, **extensions):
    """A material's fields; extensions of KHR_materials by their last word."""
    found = {f"KHR_materials_{name}": value for name, value in extensions.items()}
    return {"pbrMetallicRoughness": {**PLASTIC, **(core or {})}, "extensions": found}
