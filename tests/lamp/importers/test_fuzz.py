"""Damage to OBJ models and scenes: each file is read, or refused in one printable line."""

import numpy as np
import pytest
import trimesh
from PIL import Image

from lumitree.lamp.model_reading import read_model
from lumitree.lamp.opening import scene_path
from lumitree.lamp.scene_file import SceneFile
from lumitree.lamp.source import as_source
from support.damage import damaged, refused
from support.lamps import AREA, GLASS, scene, sphere

MTL = """newmtl glass
illum 4
Ni 1.5
Tf 0.9 0.8 0.7
newmtl shade
Kd 0.5 0.5 0.5
Ns 20
Ks 0.1 0.1 0.1
map_Kd -s 2 2 -o 0.5 0 -clamp on image.png
map_d image.png
map_Bump -bm 0.5 image.png
newmtl bulb
Ke 10 8 6
map_Ke image.png
Pr 0.5
"""
TOML = """units = "cm"
up = "z"
[material.glass]
glass = { ior = 1.5, tint = [0.9, 1, 1], absorption = 2, thin = false }
[material.bulb]
emitter = { lumens = 800, temperature = 2700 }
[material.shade]
principled = { base_color = 0.5, roughness = 0.3 }
opacity = 0.5
"""


@pytest.fixture(scope="module")
def lamp(tmp_path_factory):
    """Folder of an OBJ model with everything beside it."""
    folder = tmp_path_factory.mktemp("fuzz")
    ball = trimesh.creation.icosphere(subdivisions=0)
    lines = ["mtllib lamp.mtl", "s 1", "vt 0 0", "vt 1 0", "vn 0 0 1"]
    lines += [f"v {x:.4f} {y:.4f} {z:.4f}" for x, y, z in ball.vertices]
    for material, faces in zip(
        ("glass", "shade", "bulb"), np.split(ball.faces, [14, 17]), strict=True
    ):
        lines.append(f"usemtl {material}")
        lines += ["f " + " ".join(f"{corner + 1}/1/1" for corner in face) for face in faces]
    lines.append("f -1/2 -2/1 -3/1 -4/2 -5/1")
    (folder / "lamp.obj").write_text("\n".join(lines))
    (folder / "lamp.mtl").write_text(MTL)
    (folder / "lamp.toml").write_text(TOML)
    pixels = np.random.default_rng(0).integers(0, 255, (4, 4, 4), np.uint8)
    Image.fromarray(pixels).save(folder / "image.png")
    return folder


@pytest.mark.parametrize(
    ("file", "count"),
    [("lamp.obj", 250), ("lamp.mtl", 250), ("lamp.toml", 250), ("image.png", 60)],
)
def test_obj_models(lamp, file, count):
    whole = (lamp / file).read_bytes()
    rng = np.random.default_rng(7)
    refusals = 0
    assert not refused(lambda: read_model(lamp / "lamp.obj"))
    try:
        for _ in range(count):
            (lamp / file).write_bytes(damaged(whole, rng))
            refusals += refused(lambda: read_model(lamp / "lamp.obj"))
    finally:
        (lamp / file).write_bytes(whole)
    assert refusals > count / 5


def test_scenes(mi, tmp_path):
    glass = sphere("glass", 1, inside=GLASS)
    whole = scene(glass, sphere("bulb", 0.5, inside='<bsdf type="diffuse"/>' + AREA))
    whole = whole.replace("><", ">\n<").encode()
    rng = np.random.default_rng(10)
    path = tmp_path / "lamp.xml"
    refusals = 0
    for _ in range(150):
        path.write_bytes(damaged(whole, rng))
        refusals += refused(lambda: SceneFile(scene_path(as_source(path))[0]).instantiate())
    assert refusals > 50
