"""A small OBJ model with materials, an image and overrides."""

import io

import numpy as np
import trimesh
from PIL import Image

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


def obj_model():
    """Contents of the files by name; the model is `lamp.obj`."""
    ball = trimesh.creation.icosphere(subdivisions=0)
    lines = ["mtllib lamp.mtl", "s 1", "vt 0 0", "vt 1 0", "vn 0 0 1"]
    lines += [f"v {x:.4f} {y:.4f} {z:.4f}" for x, y, z in ball.vertices]
    for material, faces in zip(
        ("glass", "shade", "bulb"), np.split(ball.faces, [14, 17]), strict=True
    ):
        lines.append(f"usemtl {material}")
        lines += ["f " + " ".join(f"{corner + 1}/1/1" for corner in face) for face in faces]
    lines.append("f -1/2 -2/1 -3/1 -4/2 -5/1")
    image, pixels = io.BytesIO(), np.random.default_rng(0).integers(0, 255, (4, 4, 4), np.uint8)
    Image.fromarray(pixels).save(image, "PNG")
    return {
        "lamp.obj": "\n".join(lines).encode(),
        "lamp.mtl": MTL.encode(),
        "lamp.toml": TOML.encode(),
        "image.png": image.getvalue(),
    }
