"""Every command reads and writes paths with spaces, brackets and letters outside ASCII."""

import shlex

import numpy as np
import pytest
from PIL import Image

import lumitree
from lumitree.cli import main
from support.exported_lamps import lamp
from support.ies_text import ies_text
from support.lamps import BALL
from support.slow import slow
from support.tiny_bakes import set_qualities

FOLDER = "Leuchten für Zoë (灯) [1] & 100%"
ROOM = (
    '<scene version="3.0.0"><integrator type="path"><integer name="max_depth" value="4"/>'
    '</integrator><sensor type="perspective"><transform name="to_world">'
    '<lookat origin="0,1,6" target="0,0.5,0" up="0,1,0"/></transform>'
    '<film type="hdrfilm"><integer name="width" value="64"/><integer name="height" value="64"/>'
    '</film></sensor><shape type="rectangle" id="desk"><transform name="to_world">'
    '<rotate x="1" angle="-90"/></transform><bsdf type="diffuse"><texture name="reflectance" '
    'type="bitmap"><string name="filename" value="Stoff grün.png"/></texture></bsdf></shape>'
    "</scene>"
)
MODEL = "mtllib Lampe größer.mtl\nusemtl glow\nvt 0 0\nvt 1 0\nvt 0 1\n"
MODEL += "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1/1 3/3 2/2\nf 1/1 2/2 4/3\nf 1/1 4/2 3/3\n"
MODEL += "f 2/1 3/2 4/3\n"
MATERIAL = "newmtl glow\nKd 0.5 0.5 0.5\nmap_Kd Stoff grün.png\n"
OVERRIDES = "[material.glow]\nemitter = { lumens = 800 }\n"
PLACED = "--place '{0}/lamp.lumitree' --at 0,1,0 --size 1"
# Command, and a file that it writes. {0} is the folder.
COMMANDS = [
    ("list --json '{0}/Liste ä.json'", "Liste ä.json"),
    ("info '{0}/lamp.lumitree' --json '{0}/info ä.json'", "info ä.json"),
    (f"render '{{0}}/Zimmer ü.xml' -o '{{0}}/Bild ä.png' --spp 1 {PLACED}", "Bild ä.png"),
    ("view '{0}/lamp.lumitree' -o '{0}/Seite ä.html'", "Seite ä.html"),
    ("export '{0}/lamp.lumitree' -o '{0}/Lampe ä.rad'", "Lampe ä.rad"),
    ("blender-extension -o '{0}/Erweiterung ä.zip'", "Erweiterung ä.zip"),
]
SLOW_COMMANDS = [
    ("preview '{0}/Lampe ü.xml' -o '{0}/Blatt ä.png' --resolution 16 --spp 4", "Blatt ä.png"),
    ("preview '{0}/Lampe ü.obj' -o '{0}/Blatt ä.png' --resolution 16 --spp 4", "Blatt ä.png"),
    (
        "capture '{0}/Lampe ü.obj' -o '{0}/Bilder ä' --views 2 --resolution 16 --spp 4",
        "Bilder ä/manifest.json",
    ),
    (f"render '{{0}}/Zimmer ü.xml' -o '{{0}}/Bild ä.exr' --spp 1 {PLACED}", "Bild ä.exr"),
    (
        "illuminance '{0}/Zimmer ü.xml' --surface desk --spacing 1 --direct --error 0.2 "
        f"-o '{{0}}/Plan ä.png' -o '{{0}}/Plan ä.pdf' -o '{{0}}/Plan ä.csv' {PLACED}",
        "Plan ä.png",
    ),
    (
        "photometry '{0}/lamp.lumitree' --step 30 --paths 65536 -o '{0}/Licht ä.ies' "
        "-o '{0}/Licht ä.ldt' -o '{0}/Licht ä.pdf' -o '{0}/Licht ä.html'",
        "Licht ä.ldt",
    ),
    ("photometry '{0}/Licht ü.ies' --step 30 --paths 65536 -o '{0}/Licht ä.ies'", "Licht ä.ies"),
    *(
        (f"export '{{0}}/lamp.lumitree' -o '{{0}}/Lampe ä{suffix}'", f"Lampe ä{suffix}")
        for suffix in (".py", ".pbrt", ".glb", "")
    ),
    (
        "bake '{0}/Lampe ü.obj' -o '{0}/Lampe ä.lumitree' --parts light,geometry",
        "Lampe ä.lumitree",
    ),
    (
        "bake '{0}/Lampe ü.xml' '{0}/Licht ü.ies' -o '{0}/alle ä/' --parts light",
        "alle ä/index.html",
    ),
]


@pytest.fixture
def folder(tmp_path, monkeypatch, mi):
    """A folder of lamps and a room; the current folder is another one."""
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    folder = tmp_path / FOLDER
    folder.mkdir()
    (folder / "Lampe ü.xml").write_text(BALL, encoding="utf-8")
    (folder / "Zimmer ü.xml").write_text(ROOM, encoding="utf-8")
    (folder / "Lampe ü.obj").write_text(MODEL, encoding="utf-8")
    (folder / "Lampe größer.mtl").write_text(MATERIAL, encoding="utf-8")
    (folder / "Lampe ü.toml").write_text(OVERRIDES, encoding="utf-8")
    even = ies_text(np.full((1, 3), 100.0), [0], [0, 90, 180])
    (folder / "Licht ü.ies").write_text(even, encoding="ascii")
    Image.new("RGB", (2, 2), (90, 200, 90)).save(folder / "Stoff grün.png")
    lumitree.save(lamp(), folder / "lamp.lumitree")
    return folder


@pytest.mark.parametrize(
    ("command", "written"),
    [*COMMANDS, *(slow(*each) for each in SLOW_COMMANDS)],
)
def test_the_command_works(folder, monkeypatch, command, written):
    set_qualities(monkeypatch.setattr)
    assert main(shlex.split(command.format(folder))) == 0
    assert (folder / written).exists()
    assert not list((folder.parent / "elsewhere").iterdir())
