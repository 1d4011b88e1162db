"""Two lamps of Khronos' sample assets, where the development set is at hand.

Its folder is ../shared/data beside the repository, or what LUMITREE_DATA names.
"""

import os
from pathlib import Path

import numpy as np
import pytest

from lumitree.core.backend import load_mitsuba
from lumitree.errors import LumitreeWarning
from lumitree.lamp.importers.gltf import read_gltf
from lumitree.lamp.parts import Glass, Texture
from lumitree.lamp.scene_writer import write_scene
from support.variant import VARIANT

DATA = Path(os.environ.get("LUMITREE_DATA", Path(__file__).parents[4].parent / "shared" / "data"))
pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason=f"no development set at {DATA}")
BARN = DATA / "luminaires" / "barn_lamp" / "AnisotropyBarnLamp.gltf"
STAINED = DATA / "luminaires" / "stained_glass_lamp" / "StainedGlassLamp.gltf"


def read(path, approximated, **options):
    with pytest.warns(
        LumitreeWarning, match=f"material '{approximated}' is approximated"
    ) as caught:
        model = read_gltf(path, **options)
    assert len(caught) == 1
    return model, {material.name: material for material in model.materials}


def loaded(model, folder):
    return load_mitsuba(VARIANT).load_file(str(write_scene(model, folder)))


def test_barn_lamp(tmp_path):
    model, materials = read(BARN, "lamp metal")
    assert sum(len(part.mesh.faces) for part in model.parts) == 10203
    assert materials["lamp_filament"].radiance == pytest.approx(np.array([25, 12.5, 6.25]) / 683)
    # A single open sheet around the filament, though its volume claims a thickness.
    assert materials["lamp_glass"].surface == Glass(thin=True)
    scene = loaded(model, tmp_path)
    np.testing.assert_allclose(np.ravel(scene.bbox().min), (-0.1046, -0.1983, 0), atol=1e-4)
    np.testing.assert_allclose(np.ravel(scene.bbox().max), (0.0862, 0.0569, 0.2265), atol=1e-4)
    assert len(scene.emitters()) == 1


def test_stained_glass_lamp_and_its_variants(tmp_path):
    model, on = read(STAINED, "stainedglass")
    assert sum(len(part.mesh.faces) for part in model.parts) == 35132
    for name, ior in (("amberbeads", 1.4), ("redgems", 1.52)):
        assert on[name].surface.ior == ior
        assert not on[name].surface.thin
    assert on["bulbs"].radiance == pytest.approx([1 / 683] * 3)
    assert isinstance(on["stainedglass"].surface.transmission, Texture)
    assert isinstance(on["grill"].opacity, Texture)
    again, _ = read(STAINED, "stainedglass", variant="Lamp on")
    assert [part.material for part in again.parts] == [part.material for part in model.parts]
    _, off = read(STAINED, "stainedglass_off", variant="Lamp off")
    assert all(material.radiance is None for material in off.values())
    scene = loaded(model, tmp_path)
    np.testing.assert_allclose(np.ravel(scene.bbox().min), (-0.22, 0, -0.22), atol=1e-3)
    np.testing.assert_allclose(np.ravel(scene.bbox().max), (0.22, 0.6889, 0.22), atol=1e-3)
