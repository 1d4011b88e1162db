"""Mitsuba makes every material of assets, with values that are finite and not negative."""

import dataclasses
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from lumitree.asset.geometry import AssetGeometry, MeshShape
from lumitree.rendering.placement import Placement
from lumitree.rendering.scene import PlacedLuminaire, default_integrator, place_luminaires
from support.geometry_assets import with_geometry
from support.material_combinations import IMAGES, RANDOM, accepted, materials


def faults(count):
    """By `scalar_materials.py`, which tries thousands of materials without compiling any."""
    script = Path(__file__).parents[1] / "support" / "scalar_materials.py"
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    run = subprocess.run(
        [sys.executable, str(script), str(count)], env=environment, capture_output=True, text=True
    )
    assert run.returncode == 0, run.stderr[-2000:]
    return json.loads(run.stdout)


@pytest.mark.slow
def test_materials_that_are_accepted_can_be_rendered():
    found = faults(300)
    assert found["faults"] == {}
    assert found["tried"] > 1500
    assert found["accepted"] > 800


@pytest.mark.slow
def test_all_pairs_of_parameters_can_be_rendered():
    found = faults(0)
    assert found["faults"] == {}
    assert found["accepted"] > 10000


@pytest.mark.slow
def test_geometry_of_many_materials_renders(mi):
    """100 of them, each on a square, half of which are seen from behind."""
    usable = [material for material in materials(3000) if accepted(material)]
    chosen = [usable[index] for index in RANDOM.permutation(len(usable))[:100]]
    square = np.array([[-0.09, -0.09, 0], [0.09, -0.09, 0], [0.09, 0.09, 0.05], [-0.09, 0.09, 0]])
    at = [[0.2 * (i % 10) - 0.9, 0.2 * (i // 10) - 0.9, 0] for i in range(len(chosen))]
    shape = MeshShape(material=0, vertices=4, faces=2, texcoords=True, colours=True)
    count = len(chosen)
    geometry = AssetGeometry(
        vertices=np.concatenate([square + place for place in at]).astype(np.float32),
        normals=np.zeros((0, 3), np.float32),
        texcoords=np.tile(np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32), (count, 1)),
        colours=RANDOM.random((4 * count, 3)).astype(np.float32),
        faces=np.tile(np.array([[0, 1, 2], [0, 2, 3]], np.uint32), (count, 1)),
        images=IMAGES,
        shapes=tuple(
            dataclasses.replace(
                shape, material=i, flipped=bool(i % 2), radiance=1 if i % 3 else None
            )
            for i in range(count)
        ),
        materials=tuple(chosen),
    )
    sensor = {
        "type": "orthographic",
        "to_world": mi.ScalarTransform4f().look_at([0, 0, 3], [0, 0, 0], [0, 1, 0]),
        "film": {"type": "hdrfilm", "width": 80, "height": 80},
    }
    room = mi.load_dict({"type": "scene", "sensor": sensor, "sky": {"type": "constant"}})
    lamp = PlacedLuminaire(Placement(with_geometry(geometry)))
    whole = place_luminaires(room, [lamp], appearance="geometry")
    pixels = np.array(mi.render(whole, integrator=default_integrator(), spp=8))
    assert np.isfinite(pixels).all()
    assert pixels.min() >= 0
    assert pixels.max() < 100
