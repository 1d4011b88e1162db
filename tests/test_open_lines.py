"""The last line of every long command: what to open."""

import os
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import lumitree
from lumitree.asset.asset import light_field_asset
from lumitree.cli import main
from lumitree.core.images import write_exr
from support.fields import random_asset
from support.lamps import AREA, room, scene, sphere
from support.light_fields import random_light_field
from support.slow import slow
from support.tiny_bakes import set_qualities

SMALL = ("--resolution", "16", "--spp", "1")
LAMP = ("bake", "lamp.xml", "--parts", "light")


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch, mi):
    monkeypatch.chdir(tmp_path)
    set_qualities(monkeypatch.setattr)
    (tmp_path / "lamp.xml").write_text(scene(sphere("ball", 1, inside=AREA)))
    (tmp_path / "room.xml").write_text(room(8, 8))
    frame = random_asset(0).frame
    lumitree.save(random_asset(0), "field.lumitree")
    write_exr("layers.exr", {"hall": np.ones((2, 3, 3), np.float32)})
    lumitree.save(light_field_asset(random_light_field(0), frame, "x"), "light.lumitree")


@pytest.mark.parametrize(
    ("command", "opens"),
    [
        ((*LAMP, "-o", "new/a.lumitree"), "new/a.lumitree"),
        ((*LAMP, "-o", "new/"), "new/index.html"),
        slow(("preview", "lamp.xml", "-o", "s.png", *SMALL), "s.png"),
        (("preview", "field.lumitree", "-o", "s.png", *SMALL), "s.png"),
        (("capture", "lamp.xml", "-o", "d", "--views", "1", *SMALL), "d"),
        slow(("evaluate", "field.lumitree", "lamp.xml", "--views", "1", *SMALL,
             "--irradiance-paths", "0"), "field-evaluation.png"),
        (("render", "room.xml", "-o", "r.png", "--spp", "1", "--place", "field.lumitree", "--at",
          "0,0,5"), "r.png"),
        (("mix", "layers.exr", "-o", "m.png", "--gain", "hall=0.5"), "m.png"),
        (("view", "field.lumitree", "-o", "v.html"), "v.html"),
        (("export", "light.lumitree", "-o", "e.py"), "e.py"),
        (("photometry", "light.lumitree", "-o", "p.ies", "-o", "p.html", "--paths", "16384",
          "--step", "10"), "p.html"),
        slow(("photometry", "light.lumitree", "-o", "p.ldt", "--paths", "16384", "--step", "10"),
            "p.ldt"),
    ],
    ids=lambda value: " ".join(value[:2]) if isinstance(value, tuple) else value,
)  # fmt: skip
def test_the_last_line_names_a_file_or_folder_that_is_there(command, opens, capsys):
    assert main(list(command)) == 0
    assert capsys.readouterr().out.splitlines()[-1] == f"Open: {opens}"
    assert os.path.exists(opens)


@pytest.mark.parametrize(
    ("command", "function", "field"),
    [
        (("train", "d", "-o", "run"), "train", "run"),
        (("extract", "run", "-o", "a.lumitree"), "extract", "path"),
        (("refine", "field.lumitree", "lamp.xml", "-o", "a.lumitree"), "refine", "path"),
    ],
)
def test_commands_that_take_minutes_end_likewise(command, function, field, monkeypatch, capsys):
    """Their functions are replaced; the result has the path."""
    result = SimpleNamespace(to_json=dict, stopped_by=None, **{field: Path("made")})
    monkeypatch.setattr(lumitree, function, lambda *_, **__: result, raising=False)
    assert main(list(command)) == 0
    assert capsys.readouterr().out == "Open: made\n"
