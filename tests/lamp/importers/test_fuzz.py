"""Damage to OBJ models and scenes: each file is read, or refused in one printable line."""

import numpy as np
import pytest

from lumitree.lamp.model_reading import read_model
from lumitree.lamp.opening import scene_path
from lumitree.lamp.scene_file import SceneFile
from lumitree.lamp.source import as_source
from support.damage import damaged, refused
from support.lamps import AREA, GLASS, scene, sphere
from support.obj_files import obj_model


@pytest.fixture(scope="module")
def lamp(tmp_path_factory):
    """Folder of an OBJ model with everything beside it."""
    folder = tmp_path_factory.mktemp("fuzz")
    for name, content in obj_model().items():
        (folder / name).write_bytes(content)
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
