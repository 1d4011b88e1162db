"""Every command's errors, in one line with status 2, and what they print."""

# pyright: reportCallIssue=false
import inspect
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time

import numpy as np
import pytest

import lumitree
from lumitree.cli import main
from lumitree.cli.app import _parsed
from lumitree.cli.commands import COMMANDS, _places
from lumitree.cli.output import print_photograph
from lumitree.core.files import MARKER
from lumitree.core.photometry import flux_text
from lumitree.lamp.source import LuminaireSource
from support.fields import make_asset, random_asset
from support.lamps import AREA, BALL, room, sphere

MODEL = "mtllib model.mtl\nusemtl glow\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n"
MODEL += "f 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch, mi):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "lamp.xml").write_text(BALL)
    (tmp_path / "dark.xml").write_text('<scene version="3.0.0"><shape type="sphere"/></scene>')
    (tmp_path / "empty.xml").write_text('<scene version="3.0.0"/>')
    (tmp_path / "half.xml").write_text(BALL[: len(BALL) // 2])
    (tmp_path / "room.xml").write_text(room(30, 20))
    (tmp_path / "model.obj").write_text(MODEL)
    (tmp_path / "model.mtl").write_text("newmtl glow\nKd 0.5 0.5 0.5\n")
    (tmp_path / "bright.toml").write_text("[material.glow]\nemitter = { lumens = 800 }\n")
    (tmp_path / "wrong.toml").write_text("[material.glow]\nemiter = { lumens = 800 }\n")
    (tmp_path / "lamp.fbx").write_bytes(b"")
    lumitree.save(random_asset(0), tmp_path / "lamp.lumitree")
    return tmp_path


def fails(capsys, *arguments):
    """The one-line error of a command that must end with status 2."""
    before = sorted(os.listdir())
    assert main(list(arguments)) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("lumitree: error: ")
    assert captured.err.count("\n") == 1
    assert "Traceback" not in captured.err
    assert [name for name in os.listdir() if name.startswith(".")] == []
    return captured.err, set(os.listdir()) - set(before)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["paint"], 'Unknown command "paint"'),
        (["capture", "lamp.xml"], "--output"),
        (["preview", "no.xml", "-o", "s.png"], "neither a file nor built in"),
        (["preview", "dark.xml", "-o", "s.png"], "no emitter"),
        (["preview", "empty.xml", "-o", "s.png"], "no shapes"),
        (["preview", "half.xml", "-o", "s.png"], "half.xml cannot be loaded"),
        (["preview", "lamp.xml", "-o", "s.png", "--resolution", "0"], "resolution is 0"),
        (["capture", "lamp.xml", "-o", "d", "--views", "many"],
         "--views is 'many'; expected a whole number"),
        (["capture", "lamp.xml", "-o", "d", "--views", "2.5"],
         "--views is '2.5'; expected a whole number"),
        (["bak", "lamp.xml"], 'Did you mean "bake"?; see \'lumitree --help\''),
        (["capture", "lamp.xml", "-o", "d", "--variant", "scalar_rgb"], "choose llvm_ad_rgb"),
        (["bake", "lamp.xml", "-o", "a.lumitree", "--quality", "paper"],
         "quality of the method octree is 'paper'; expected preview, standard, high"),
        (["bake", "-o", "a.lumitree"], "SOURCE is needed"),
        (["info", "no.lumitree"], "no.lumitree does not exist"),
        (["render", "no.xml", "-o", "a.png"], "no.xml does not exist"),
        (["render", "room.xml", "-o", "a.gif"], "neither .exr"),
        (["render", "lamp.xml", "-o", "a.png"], "no sensor"),
        (["render", "room.xml", "-o", "a.png", "--at", "1,2,3"], "comes before any --place"),
        (["render", "room.xml", "-o", "a.png", "--place", "lamp.lumitree", "--at", "1,2"],
         "not 3 finite numbers"),
        (["render", "room.xml", "-o", "a.png", "--place", "lamp.lumitree", "--size", "1",
          "--size", "2"], "given twice"),
        (["render", "room.xml", "-o", "a.png", "--place", "lamp.lumitree", "--size", "1e300"],
         "size 1e+300 is not a length of 1e-12 to 1e+12 scene units"),
        (["render", "room.xml", "-o", "a.png", "--place", "lamp.lumitree", "--at", "0,2,0",
          "--place", "lamp.lumitree", "--at", "0,2,0"],
         "lamp.lumitree is placed twice in the same place"),
        (["render", "room.xml", "-o", "a.exr", "--layers", "./a.exr"],
         "a.exr is given for two outputs"),
        (["mix", "a.exr", "-o", "b.png", "--gain", "x=1", "--gain", "x=2"],
         "--gain is given twice for 'x'"),
        (["mix", "lamp.xml", "-o", "lamp.xml"], "lamp.xml is read, and would be written over"),
        (["refine", "lamp.lumitree", "lamp.xml", "-o", "lamp.lumitree"],
         "lamp.lumitree is read, and would be written over; choose another output"),
        (["view", "lamp.lumitree", "-o", "v.png"], "page name 'v.png' does not end in .html"),
        (["render", "room.xml", "-o", "a.png", "--spp", "1" + 20 * "0"],
         "expected 1 to 1,048,576"),
        (["render", "room.xml", "-o", "a.png", "--exposure", "-41"], "exposure is -41.0; expected"),
        (["render", "room.xml", "-o", "a.png", "--exposure", "ev=dark"], "such as ev=9.5"),
        (["render", "room.xml", "-o", "a.png", "--white-balance", "warm"], "expected auto, off or"),
        (["render", "x" * 300 + ".xml", "-o", "a.png"], "File name too long"),
        (["render", "room.xml", "-o", "x" * 300 + ".png"], "File name too long"),
        (["render", "room.xml", "-o", "a.png", "--json", "no/such/x.json"], "no folder no/such"),
        (["info", "a\nb"], "a?b does not exist"),
        (["info", "\x1b[31m.lumitree"], "?[31m.lumitree does not exist"),
        (["bake", "lamp.xml", "-o", "a.lumitree", "--seed", "-1"],
         "seed is -1; expected a whole number from 0 to 2147483647"),
        (["bake", "lamp.xml", "-o", "a.lumitree", "--parts", "geometry"],
         "parts are geometry; expected"),
        (["render", "room.xml", "-o", "a.png", "--place", "lamp.lumitree", "--rotate", "0,0,0,9"],
         "no direction"),
        (["render", "room.xml", "-o", "a.png", "--place", "lamp.lumitree", "--gain", "-1,1,1"],
         "gain is [-1.0, 1.0, 1.0]; expected one number or three (R, G, B) from 0 to 1,000,000"),
        (["render", "room.xml", "-o", "a.png", "--place", "lamp.xml", "--gain", "2"],
         "is placed as explicit geometry"),
        (["render", "room.xml", "-o", "a.png", "--place", "lamp.xml", "--grid", "3x2",
          "--pitch", "1,2"], "lamp.xml has a grid; say by at where its centre is"),
        (["render", "room.xml", "-o", "a.png", "--place", "lamp.xml", "--at", "0,1,0", "--grid",
          "3,2"], "grid is '3,2'; expected whole numbers such as 3x2"),
        (["render", "room.xml", "-o", "a.png", "--place", "lamp.lumitree", "--keep", "bulb"],
         "keep: not for an asset"),
        (["render", "room.xml", "-o", "a.png", "--keep", "x"], "--keep comes before any --place"),
        (["render", "room.xml", "-o", "a.png", "--gain", "2"], "--gain comes before any --place"),
        (["demo", "--variant", "cuda_ad_spectral"], "choose llvm_ad_rgb"),
        (["capture", "lamp.fbx", "-o", "d"], "(a Mitsuba 3 scene), .obj, .gltf, .glb"),
        (["bake", "lamp.lumitree", "-o", "a.lumitree"], "is an asset, which is baked already"),
        (["capture", "model.obj", "-o", "d"], "has no emitter (materials: glow); name one in"),
        (["capture", "model.obj", "-o", "d", "--materials", "wrong.toml"],
         "wrong.toml: unknown key 'material.glow.emiter'"),
        (["capture", "lamp.xml", "-o", "d", "--materials", "bright.toml"],
         "--materials does not apply"),
        (["capture", "bulbs", "-o", "d", "--materials", "bright.toml"], "takes no --materials"),
        (["bake", "lamp.xml", "-o", "a.lumitree", "--keep", "bulb"], "matches no shape's id"),
        # Values that are empty, or that are the next option; further arguments.
        (["capture", "lamp.xml", "-o", ""], "-o needs a value; found ''"),
        (["preview", ""], "an argument needs a value; found ''"),
        (["info", "lamp.lumitree", "--json="], "--json needs a value; found ''"),
        (["bake", "--write-config", "--seed", "5"], "--write-config needs a value; found '--seed'"),
        (["render", "room.xml", "-o", "a.png", "--place="], "--place needs a value; found ''"),
        (["render", "room.xml", "-o", "a.png", "--place", "--at", "1,2,3"],
         "--place needs a value; found '--at'"),
        (["render", "room.xml", "-o", "a.png", "--place", "lamp.xml", "--at", "--size", "1"],
         "--at needs a value; found '--size'"),
        (["bake", "lamp.xml", "-o", "--seed", "5"], "-o requires an argument"),
        (["render", "room.xml", "lamp.xml", "-o", "a.png"], "too many arguments: lamp.xml"),
        (["bake", "lamp.xml", "-o", "a.lumitree", "dark.xml"], "there are 2 luminaires"),
        # Options that exclude each other; unknown options whose words an option's help has.
        (["view", "lamp.lumitree", "-o", "a.html", "--port", "5"],
         "--output and --port are given; give one of them"),
        (["bake", "lamp.xml", "-o", "a.lumitree", "--workers", "2", "--scheduler", "tcp://a:1"],
         "--workers and --scheduler are given; give one of them"),
        (["bake", "lamp.xml", "--budget", "9"], "--budget, which may be --time or --rays"),
        (["bake", "lamp.xml", "--tree-depth", "9"], "--tree-depth, which may be --config"),
    ],
)  # fmt: skip
def test_bad_input(capsys, arguments, message):
    error, created = fails(capsys, *arguments)
    assert message in error
    assert created == set()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["train", "no", "-o", "run"], "holds no manifest.json"),
        (["extract", "no", "-o", "a.lumitree"], "expected a run made by"),
    ],
)
def test_bad_input_of_the_network(network_packages, capsys, arguments, message):
    error, created = fails(capsys, *arguments)
    assert message in error
    assert created == set()


def test_each_command_removes_what_killed_ones_left(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    left = tmp_path / "lumitree-scratch-12345678"
    left.mkdir()
    (left / MARKER).touch()
    assert main(["list"]) == 0
    assert not left.exists()
    # Without such a folder, commands that need none run.
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "missing"))
    assert main(["list"]) == 0


def test_what_a_command_cannot_do_is_refused_before_it_works(capsys, monkeypatch):
    """Nothing is loaded, traced or imported for seconds before the refusal."""

    def work(*_, **__):
        raise AssertionError("worked before it refused")

    monkeypatch.setattr("lumitree.fit.bake.load_rgb", work)
    monkeypatch.setattr("lumitree.fit.bake_network.load_rgb", work)
    monkeypatch.setattr("lumitree.measure.evaluate.load_rgb", work)
    monkeypatch.setattr("lumitree.measure.preview.load_rgb", work)
    for arguments in (
        ["bake", "bulbs", "-o", "a.lumitree", "--method", "network", "--seed", "-1"],
        ["bake", "bulbs", "-o", "a.lumitree", "--seed", "-1"],
        ["bake", "bulbs", "-o", "room.xml/a.lumitree"],
        ["refine", "lamp.lumitree", "bulbs", "-o", "a.lumitree", "--seed", str(2**31)],
        ["evaluate", "lamp.lumitree", "bulbs", "-o", "x.jpg"],
        ["evaluate", "lamp.lumitree", "bulbs", "-o", "room.xml/x.png"],
        ["preview", "bulbs", "-o", "s.png", "--resolution", "0"],
        ["capture", "bulbs", "-o", "d", "--spp", "0"],
        ["render", "room.xml", "-o", "a.png", "--place", "lamp.lumitree", "--size", "0"],
        ["render", "room.xml", "-o", "a.png", "--spp", "0"],
    ):
        fails(capsys, *arguments)


@pytest.mark.parametrize(("kelvin", "balance"), [(3099.6, "3,100 K"), (None, "off")])
def test_exposure_and_white_balance_are_printed(capsys, kelvin, balance):
    print_photograph({"image": "a.png", "spp": 4, "ev": 9.46, "white_balance": kelvin})
    lines = capsys.readouterr().out.splitlines()
    assert (
        lines[-1].split() == f"exposure EV 9.5 (less is brighter), white balance {balance}".split()
    )
    assert "ev" not in {line.split()[0] for line in lines}


def test_bare_command_shows_its_help(capsys):
    assert main([]) == 0
    assert "Usage: lumitree" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        (["bake", "bulbs", "-o", "a.lumitree", "--qualty", "high"], "--quality"),
        (["bake", "bulbs", "-o", "a.lumitree", "--quality", "hihg"], "high"),
        (["rendr", "room.xml"], "render"),
    ],
)
def test_the_nearest_name_is_offered(capsys, arguments, name):
    assert re.search(f"Did you mean .?{name}.?\\?", fails(capsys, *arguments)[0])


def test_unknown_keywords_are_refused_by_the_nearest_name():
    with pytest.raises(TypeError, match="did you mean 'quality'"):
        lumitree.bake("bulbs", qualty="high")
    with pytest.raises(TypeError, match="did you mean 'views'"):
        lumitree.capture("bulbs", "d", view=3)


def test_the_options_of_a_command_are_the_parameters_of_its_function():
    """Public parameters that are no option are objects, and are made of others or not needed."""
    for name, each in COMMANDS.items():
        if each.function and name != "demo":
            parameters = set(inspect.signature(getattr(lumitree, each.function)).parameters)
            missing = parameters - each.all_options().keys()
            assert missing <= {
                "executor", "progress", "so_far", "planes", "surfaces", "normals"
            }, name  # fmt: skip
            assert all(option.help for option in each.all_options().values()), name


def test_damaged_dataset(network_packages, capsys, folder):
    assert main(["capture", "lamp.xml", "-o", "d", "--views", "2", "--resolution", "16",
                 "--spp", "4"]) == 0  # fmt: skip
    capsys.readouterr()
    manifest = (folder / "d" / "manifest.json").read_text()
    for text, message in (
        ("{", "not a valid manifest"),
        ("[]", "not a valid manifest"),
        (manifest.replace('"version": 1', '"version": 9'), "version is '9'; this lumitree reads 1"),
        (manifest.replace("view_000001.exr", "../x.exr"), "outside the dataset's folder"),
        (manifest.replace('"resolution": 16', '"resolution": 8'), "holds channels"),
    ):
        (folder / "d" / "manifest.json").write_text(text)
        error, _ = fails(capsys, "train", "d", "-o", "run")
        assert message in error
    (folder / "d" / "manifest.json").write_text(manifest)
    view = folder / "d" / "view_000001.exr"
    view.write_bytes(view.read_bytes()[:200])
    error, _ = fails(capsys, "train", "d", "-o", "run")
    assert error.rstrip().endswith("remove it, and the same capture makes it again")


def test_asset_of_another_luminaire(capsys):
    lumitree.save(random_asset(0, half_extents=np.array([1.0, 0.5, 1.0])), "flat.lumitree")
    error, _ = fails(capsys, "evaluate", "flat.lumitree", "lamp.xml", "--views", "1",
                     "--resolution", "16", "--spp", "4")  # fmt: skip
    assert "lamp have bounding boxes of different proportions" in error


def test_model_with_overrides_is_captured_and_placed(capsys, folder):
    """Named overrides for the capture; those beside the model for the render."""
    short = ["--views", "1", "--resolution", "16", "--spp", "4"]
    assert main(["capture", "model.obj", "-o", "d", "--materials", "bright.toml", "--keep", "gl*",
                 *short]) == 0  # fmt: skip
    (folder / "bright.toml").rename("model.toml")
    assert main(["capture", "model.obj", "-o", "d", *short]) == 0
    assert main(["render", "room.xml", "-o", "a.exr", "--spp", "4", "--place", "model.obj",
                 "--at", "0,1,0", "--size", "1"]) == 0  # fmt: skip
    assert capsys.readouterr().err == ""
    (folder / "model.toml").write_text("[material.glow]\nemitter = { lumens = 900 }\n")
    error, _ = fails(capsys, "capture", "model.obj", "-o", "d", *short)
    assert "a capture of other settings or of another luminaire" in error


def test_lamp_is_taken_out_of_a_scene(capsys, folder):
    lit = room(30, 20, '<emitter type="constant"/>' + sphere("a", 1, inside=AREA))
    (folder / "lit.xml").write_text(lit)
    error, _ = fails(capsys, "capture", "lit.xml", "-o", "d", "--views", "1")
    assert "(constant)" in error
    assert "--keep" in error
    assert main(["capture", "lit.xml", "-o", "d", "--views", "1", "--resolution", "16", "--spp",
                 "4", "--keep", "a"]) == 0  # fmt: skip


def test_stored_views_cannot_be_selected_from(capsys):
    assert main(["capture", "lamp.xml", "-o", "d", "--views", "1", "--resolution", "16",
                 "--spp", "4"]) == 0  # fmt: skip
    capsys.readouterr()
    error, _ = fails(capsys, "evaluate", "lamp.lumitree", "d", "--keep", "a")
    assert "keep: not for a dataset such as d" in error


def test_list_info_and_json(capsys):
    assert main(["list", "--json", "list.json"]) == 0
    assert "bulbs" in capsys.readouterr().out
    with open("list.json") as file:
        assert "bulbs" in json.load(file)["luminaires"]
    assert main(["info", "lamp.lumitree", "--json", "info.json"]) == 0
    out = capsys.readouterr().out
    assert "tree depth  4" in out
    with open("info.json") as file:
        assert json.load(file)["asset"]["law"] == "linear"


@pytest.mark.slow
def test_preview(capsys, monkeypatch):
    monkeypatch.setattr("lumitree.measure.preview.FLUX_PATHS", 1)
    monkeypatch.setattr("lumitree.measure.preview.BOUNCE_PATHS", 1)
    options = ["--resolution", "16", "--spp", "4", "--bounces", "--json", "report.json"]
    assert main(["preview", "lamp.xml", "-o", "sheet.png", "--sheet", *options]) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    assert "beyond 128 bounces  0 ± 0 % of the flux" in captured.out
    assert os.path.getsize("sheet.png") > 10_000
    with open("report.json") as file:
        report = json.load(file)
    assert report["flux"]["watts"] == pytest.approx([4 * np.pi**2 * x for x in (3, 2, 1)], rel=0.01)
    assert report["max_radiance"] == pytest.approx(3)
    assert report["size"] == [2, 2, 2]
    assert (report["emitters"], report["triangles"], report["has_media"]) == (1, 0, False)
    assert report["faults"] == []
    assert [item["path_depth"] for item in report["bounces"]] == [32, 64, 128]


@pytest.mark.parametrize(
    ("lumens", "error", "text"),
    [
        (3981234.5, 78912.3, "3,981,234 ± 78,912 lm"),
        (815.317, 2.652, "815.3 ± 2.7 lm"),
        (0.81234, 0.00123, "0.8123 ± 0.0012 lm"),
        (0.0, 0.0, "0 ± 0 lm"),
    ],
)
def test_flux_is_told_to_the_second_digit_of_its_error(lumens, error, text):
    assert flux_text(lumens, error) == text


@pytest.mark.slow
def test_render_places_several(capsys, folder):
    """Negative coordinates, an asset twice and an explicit luminaire, in one command."""
    assert main(["render", "room.xml", "-o", "image.exr", "--spp", "8",
                 "--place", "lamp.lumitree", "--at", "-1.5,1,0", "--size", "1",
                 "--rotate", "0,1,0,30",
                 "--place", "lamp.lumitree", "--at", "0,1,0", "--size", "0.5",
                 "--place", "lamp.xml", "--at", "1.5,1,-1", "--size", "0.6",
                 "--width", "60", "--json", "report.json"]) == 0  # fmt: skip
    from lumitree.core.images import read_exr

    image = read_exr("image.exr")["RGB"]
    assert image.shape == (40, 60, 3)
    assert image.max() > 1
    with open("report.json") as file:
        assert json.load(file)["resolution"] == [60, 40]
    assert capsys.readouterr().err == ""


def test_placed_lamps_have_parts_and_arrays():
    arguments = ["render", "room.xml", "-o", "a.png", "--place", "lamp.xml", "--keep", "ball"]
    arguments += ["--place", "model.obj", "--keep", "a", "--drop", "b*", "--keep", "c"]
    arguments += ["--at", "1,2,3", "--grid", "2x2", "--pitch", "-1,0.5"]
    parsed = _parsed(arguments)
    assert parsed is not None
    first, second = _places(parsed[1])
    assert first == lumitree.Placement(LuminaireSource("lamp.xml", keep=("ball",)))
    source = LuminaireSource("model.obj", keep=("a", "c"), drop=("b*",))
    assert second == lumitree.Placement(source, (1, 2, 3), grid=(2, 2), pitch=(-1, 0.5))


def test_render_warns_of_what_is_inside_a_box_and_not_lit(capsys, folder):
    inside = (
        '<shape type="sphere"><point name="center" x="0" y="1" z="0"/>'
        '<float name="radius" value="0.3"/></shape>'
    )
    (folder / "inside.xml").write_text(room(30, 20, inside))
    lumitree.save(
        make_asset(np.zeros((0, 3)), [], [], np.zeros((0, 3, 1))), folder / "empty.lumitree"
    )
    assert main(["render", "inside.xml", "-o", "a.png", "--spp", "1",
                 "--place", "empty.lumitree", "--at", "0,1.1,0", "--size", "2"]) == 0  # fmt: skip
    assert "an object of the room is inside its box, where it is not lit" in capsys.readouterr().err


def test_scene_that_names_an_asset_itself(capsys, folder):
    lamp = '<shape type="lumitree_proxy"><string name="filename" value="{}"/></shape>'
    (folder / "own.xml").write_text(room(30, 20, lamp.format("lamp.lumitree")))
    assert main(["render", "own.xml", "-o", "a.exr", "--spp", "4"]) == 0
    capsys.readouterr()
    (folder / "own.xml").write_text(room(30, 20, lamp.format("gone.lumitree")))
    error, _ = fails(capsys, "render", "own.xml", "-o", "b.exr", "--spp", "4")
    assert "gone.lumitree does not exist" in error
    assert "File " not in error


def test_render_says_when_it_replaces_the_integrator(capsys, folder):
    direct = room(30, 20).replace('<integer name="max_depth" value="4"/>', "")
    (folder / "direct.xml").write_text(direct.replace('type="path"', 'type="direct"'))
    assert main(["render", "direct.xml", "-o", "a.png", "--spp", "1"]) == 0
    assert "integrator 'direct'; using lumitree_path" in capsys.readouterr().err


@pytest.mark.slow
def test_interrupted_capture_continues():
    """Ctrl-C ends with one line and status 130; the same command then does the rest."""
    command = [sys.executable, "-m", "lumitree", "capture", "lamp.xml", "-o", "d",
               "--views", "150", "--resolution", "96", "--spp", "48"]  # fmt: skip
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 60
    while not os.path.exists("d/view_000003.exr") and time.monotonic() < deadline:
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert err.splitlines()[-1].startswith("lumitree: error: interrupted")
    assert "Traceback" not in err
    done = [name for name in os.listdir("d") if name.startswith("view")]
    assert 3 <= len(done) < 150
    assert main(command[3:]) == 0
    assert len([name for name in os.listdir("d") if name.startswith("view")]) == 150


def test_unexpected_errors_are_one_line(capsys, monkeypatch):
    monkeypatch.setattr("lumitree.rendering.asset_cache.read_asset", lambda path: 1 / 0)
    assert main(["info", "lamp.lumitree"]) == 1
    err = capsys.readouterr().err
    assert "unexpected ZeroDivisionError" in err
    assert err.count("\n") == 1


def test_help_is_quick_and_light():
    code = (
        "import sys, contextlib, io\n"
        "from lumitree.cli import main\n"
        "with contextlib.redirect_stdout(io.StringIO()):\n"
        "    main(['--help'])\n"
        "    main(['render', '--help'])\n"
        "heavy = {'mitsuba', 'drjit', 'jax', 'numpy', 'matplotlib'} & set(sys.modules)\n"
        "print(sorted(heavy))"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert result.stdout.strip() == "[]"
