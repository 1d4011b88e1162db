"""Images state the settings that made them."""

import json

import numpy as np
import pytest
from PIL import Image

import lumitree
from lumitree.core.images import read_comment, read_exr, write_exr
from lumitree.errors import LumitreeError
from support.fields import random_asset
from support.lamps import AREA, room, scene, sphere


@pytest.fixture(autouse=True)
def folder(mi, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "room.xml").write_text(room(6, 4))
    (tmp_path / "lamp.xml").write_text(scene(sphere("ball", 0.5, inside=AREA)))
    lumitree.save(random_asset(3), "lamp.lumitree")
    return tmp_path


def comment(path):
    """Settings of an image file."""
    if str(path).endswith(".exr"):
        return json.loads(read_comment(path))
    with Image.open(path) as image:
        return json.loads(image.text["Comment"])


@pytest.mark.slow
def test_renders_and_what_is_mixed_of_them():
    lamps = [lumitree.Placement("lamp.lumitree", at=(0, 9, 0), lumens=30.0, label="Küche")]
    image = lumitree.render("room.xml", lamps, spp=2, seed=7, layers=True, aov=True)
    for name in ("a.png", "a.exr"):
        image.save(name)
    image.save_layers("layers.exr")
    image.save_aov("buffers.exr")
    first = comment("a.png")
    assert first["command"] == "render"
    assert first["lumitree"] == lumitree.__version__
    assert (first["scene"], first["seed"], first["spp"]) == ("room.xml", 7, 2)
    lamp = first["lamps"]["Küche"]
    assert (lamp["source"], lamp["at"], lamp["lumens"]) == ("lamp.lumitree", [0, 9, 0], 30)
    assert comment("a.exr") == comment("layers.exr") == comment("buffers.exr") == first
    lumitree.mix("layers.exr", {"Küche": 0.5}).save("mixed.png")
    mixed = comment("mixed.png")
    assert mixed["gain"] == {"Küche": [0.5, 0.5, 0.5]}
    assert json.loads(mixed["rendered"]) == first


def test_a_layers_file_without_a_comment(folder):
    write_exr("plain.exr", {"lamp": np.ones((2, 3, 3), np.float32)})
    assert read_comment("plain.exr") is None
    lumitree.mix("plain.exr").save("mixed.png")
    assert "rendered" not in comment("mixed.png")
    (folder / "broken.exr").write_bytes(b"\x76\x2f\x31\x01" + bytes(40))
    for read in (read_comment, read_exr):
        with pytest.raises(LumitreeError, match="not a readable OpenEXR image"):
            read("broken.exr")
