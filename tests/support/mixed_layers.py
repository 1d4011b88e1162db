"""Layers of an image that was not rendered: a textured wall under two lamps and a window."""

import json

import numpy as np

from lumitree.core.images import write_exr
from lumitree.rendering.photograph import Highlights

PLACED = {"source": "lamp.lumitree", "at": [1, 2.5, 0], "size": 0.5, "gain": [2, 1, 1]}


def wall(height=90, width=161, *, noise=0.0):
    """Layers [H, W, 3] by name, and their highlights; "desk" has a filament, "room" a window."""
    random = np.random.default_rng(0)
    y, x = np.mgrid[:height, :width] / height
    paper = 0.5 + 0.3 * np.sin(40 * x) * np.sin(31 * y) + 0.1 * random.random((height, width))
    paper = paper[..., None] * np.where(x > 1.2, 0.2, 1)[..., None] * [1.0, 0.8, 0.6]

    def lamp(at, radiance, shadow):
        level = radiance / (0.05 + (x - at[0]) ** 2 + (y - at[1]) ** 2) * np.where(shadow, 0.05, 1)
        return level[..., None] * random.normal(1, noise, (height, width, 1)) ** 2

    layers = {
        "desk": paper * lamp((0.4, 0.3), 0.03, y > 0.8) * [1.6, 1.0, 0.4],
        "hall": paper * lamp((1.5, 0.6), 0.02, x + y < 0.9) * [1.2, 1.0, 0.8],
        "room": paper * lamp((0.9, -0.4), 0.2, x < 0.2) * [0.8, 1.0, 1.3],
    }
    filament, window = np.zeros((height, width, 2))[..., 0], np.zeros((height, width))
    filament[height // 3, width // 4 : width // 3] = 0.3
    window[5 : height // 3, -40:-12] = 1
    highlights = {}
    for name, share, radiance in (("desk", filament, 400.0), ("room", window, 30.0)):
        seen = share[..., None] * radiance * np.ones(3)
        layers[name] = layers[name] + seen
        highlights[name] = Highlights(seen.astype(np.float32), (share * radiance**2).astype("f4"))
    return {name: layer.astype(np.float32) for name, layer in layers.items()}, highlights


def write_wall(path, **options):
    """Write the layers as `RenderResult.save_layers` does, with the settings of a render."""
    layers, highlights = wall(**options)
    channels = dict(layers)
    for name, each in highlights.items():
        channels |= {f"{name}.seen": each.seen, f"{name}.square": each.square}
    lamps = {"desk": PLACED | {"watts": [3.0, 2.0, 0.9]}, "hall": PLACED | {"source": "bulbs"}}
    write_exr(path, channels, json.dumps({"command": "render", "lamps": lamps}))
    return layers
