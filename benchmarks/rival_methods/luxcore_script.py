"""Renders images by LuxCore; run by a Python with pyluxcore, with a folder as its argument.

The folder holds `job.json` with the scene and the configuration of each image as LuxCore's
properties, and `meshes.npz`. The images are written to `result.npz`.
"""

import json
import os
import sys
import time

import numpy as np
import pyluxcore  # type: ignore[import-not-found]

_POLL = 0.02  # s


def properties(text):
    found = pyluxcore.Properties()
    found.SetFromString(text)
    return found


def make_scene(text, meshes):
    scene = pyluxcore.Scene()
    for name in sorted({key.partition(".")[0] for key in meshes}):
        arrays = [
            list(map(tuple, meshes[f"{name}.{kind}"].tolist()))
            if f"{name}.{kind}" in meshes
            else None
            for kind in ("vertices", "faces", "normals")
        ]
        scene.DefineMesh(name, *arrays, None, None, None)
    scene.Parse(properties(text))
    return scene


def render(scene, text, width, height):
    """Image float32 [H, W, 3], the upper row first, and wall and CPU seconds."""
    session = pyluxcore.RenderSession(pyluxcore.RenderConfig(properties(text), scene))
    # It returns when the scene is prepared.
    session.Start()
    start, start_cpu = time.perf_counter(), time.process_time()
    while not session.HasDone():
        time.sleep(_POLL)
        session.UpdateStats()
    wall, cpu = time.perf_counter() - start, time.process_time() - start_cpu
    session.Stop()
    pixels = np.zeros(width * height * 3, np.float32)
    session.GetFilm().GetOutputFloat(pyluxcore.FilmOutputType.RGB, pixels)
    return pixels.reshape(height, width, 3)[::-1], wall, cpu


def main(folder):
    with open(os.path.join(folder, "job.json"), encoding="utf-8") as file:
        job = json.load(file)
    pyluxcore.Init()
    with np.load(os.path.join(folder, "meshes.npz")) as found:
        scene = make_scene(job["scene"], dict(found))
    rendered = [render(scene, text, job["width"], job["height"]) for text in job["images"]]
    images, wall, cpu = zip(*rendered)  # noqa: B905
    np.savez(os.path.join(folder, "result.npz"), images=images, wall=wall, cpu=cpu)


if __name__ == "__main__":
    main(sys.argv[1])
