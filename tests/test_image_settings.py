"""Images state the settings that made them."""

import json

import numpy as np
import pytest
from PIL import Image

import lumitree
from lumitree.core.images import read_comment, read_exr, write_exr
from lumitree.errors import LumitreeError
from lumitree.output import preview as viewing
from support import tiny_bakes
from support.fields import random_asset
from support.lamps import AREA, scene, sphere
from support.tiny_bakes import standard

ROOM = """<scene version="3.0.0"><integrator type="path"/>
<sensor type="perspective"><transform name="to_world">
<lookat origin="0, 1, 6" target="0, 0, 0" up="0, 1, 0"/></transform>
<film type="hdrfilm"><integer name="width" value="6"/><integer name="height" value="4"/></film>
</sensor><shape type="rectangle"/></scene>"""


@pytest.fixture(autouse=True)
def folder(mi, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "room.xml").write_text(ROOM)
    (tmp_path / "lamp.xml").write_text(scene(sphere("ball", 0.5, inside=AREA)))
    lumitree.save(random_asset(3), "lamp.lumitree")
    return tmp_path


def comment(path):
    """Settings of an image file."""
    if str(path).endswith(".exr"):
        return json.loads(read_comment(path))
    with Image.open(path) as image:
        if image.format == "WEBP":
            return json.loads(image.getexif()[0x010E])
        return json.loads(image.text["Comment"])


@pytest.mark.slow
def test_renders_and_what_is_mixed_of_them():
    lamps = [lumitree.Placement("lamp.lumitree", at=(0, 0, 1), lumens=30.0, label="Küche")]
    image = lumitree.render("room.xml", lamps, samples_per_pixel=2, seed=7, layers=True, aov=True)
    for name in ("a.png", "a.exr"):
        image.save(name)
    image.save_layers("layers.exr")
    image.save_aov("buffers.exr")
    first = comment("a.png")
    assert first["command"] == "render"
    assert first["lumitree"] == lumitree.__version__
    assert (first["scene"], first["seed"], first["samples_per_pixel"]) == ("room.xml", 7, 2)
    lamp = first["lamps"]["Küche"]
    assert (lamp["source"], lamp["at"], lamp["lumens"]) == ("lamp.lumitree", [0, 0, 1], 30)
    assert comment("a.exr") == comment("layers.exr") == comment("buffers.exr") == first
    lumitree.mix("layers.exr", {"Küche": 0.5}).save("mixed.png")
    mixed = comment("mixed.png")
    assert mixed["gains"] == {"Küche": [0.5, 0.5, 0.5]}
    assert json.loads(mixed["rendered"]) == first


@pytest.mark.slow
def test_sheets(monkeypatch):
    monkeypatch.setattr(viewing, "FLUX_PATHS", 1 << 10)
    lumitree.preview("lamp.xml", "preview.png", resolution=8, samples_per_pixel=3)
    assert comment("preview.png")["samples_per_pixel"] == 3
    lumitree.preview("lamp.lumitree", "asset.png", resolution=8)
    assert comment("asset.png")["asset"] == "test"
    # Without a model its images have no paths.
    assert "samples_per_pixel" not in comment("asset.png")


@pytest.mark.slow
def test_thumbnails_of_bakes_and_sheets_of_evaluations(monkeypatch):
    tiny_bakes.set_qualities(monkeypatch.setitem, tree_depth=3)
    lumitree.bake_many(["lamp.xml"], "lamps", standard(parts=["light"], seed=4))
    assert comment("lamps/index-files/lamp.webp")["settings"]["seed"] == 4
    options = {
        "num_views": 1,
        "resolution": 12,
        "samples_per_pixel": 2,
        "irradiance_paths": 1 << 14,
    }
    lumitree.evaluate("lamps/lamp.lumitree", "lamp.xml", "sheet.png", **options)
    for name in ("sheet.png", "sheet-irradiance.png"):
        assert comment(name)["num_views"] == 1


def test_a_layers_file_without_a_comment(folder):
    write_exr("plain.exr", {"lamp": np.ones((2, 3, 3), np.float32)})
    assert read_comment("plain.exr") is None
    lumitree.mix("plain.exr").save("mixed.png")
    assert "rendered" not in comment("mixed.png")
    (folder / "broken.exr").write_bytes(b"\x76\x2f\x31\x01" + bytes(40))
    for read in (read_comment, read_exr):
        with pytest.raises(LumitreeError, match="not a readable OpenEXR image"):
            read("broken.exr")
