"""Lists of lamps: what is baked, kept, divided and continued, and the index page."""

import html
import os
import re
import shutil
import signal
import subprocess
import sys
import types
from pathlib import Path
from urllib.parse import unquote

import pytest

import lumitree
from lumitree.asset.file import fingerprint_of
from lumitree.cli import main
from lumitree.cli.output import print_lamps
from lumitree.core.executor import process_pool
from lumitree.core.files import WriteError
from lumitree.lamp.source import LuminaireSource
from lumitree.many import bake_many as module
from lumitree.many import page
from lumitree.many.result import BakedLamp
from support.browser import CHROMIUM
from support.executors import LastFirst
from support.fields import random_asset
from support.ies_text import ies_text
from support.lamps import AREA, scene, sphere
from support.tiny_bakes import set_qualities, standard

SETTINGS = {"parts": ("light",)}
ARGUMENTS = ("--parts", "light")
TABLE = "1\n3\n0 45 90\n0.9 1 1\n"


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch, mi):
    monkeypatch.chdir(tmp_path)
    set_qualities(monkeypatch.setattr)
    for name, radius in (("a", 1.0), ("b", 0.5), ("c", 0.25)):
        (tmp_path / f"{name}.xml").write_text(scene(sphere("ball", radius, inside=AREA)))
    (tmp_path / "dark.xml").write_text(scene(sphere("ball", 1)))
    return tmp_path


@pytest.fixture
def quick(monkeypatch):
    """Bakes write assets of nonsense; the names of those that were baked, in order."""
    names = []

    def bake(source, output, config, **options):
        names.append(output.stem)
        seed = int(getattr(source, "fingerprint", "1")[:4], 16)
        asset = random_asset(seed, tree_depth=2, l_max=0)
        lumitree.save(asset, output)
        return types.SimpleNamespace(
            asset=asset, irradiance=None, finished=True, stopped_by=None, seconds={"light": 1.0}
        )

    monkeypatch.setattr(module, "bake", bake)
    monkeypatch.setattr(module, "write_thumbnail", lambda *_: None)
    monkeypatch.setattr("lumitree.rendering.asset_flux.asset_lumens", lambda _: 5.0)
    return names


def bake(names, folder="out", **options):
    settings = {key: options.pop(key) for key in ("seed",) if key in options}
    return lumitree.bake_many(names, folder, standard(**SETTINGS, **settings), **options)


def states(result):
    return [(lamp.name, lamp.state) for lamp in result.lamps]


def contents(folder):
    """Bytes of the assets of a folder by name."""
    return {path.name: path.read_bytes() for path in Path(folder).glob("*.lumitree")}


def test_lamps_are_kept_while_luminaire_and_settings_are_equal(folder, quick):
    assert states(bake(["a.xml", "b.xml"])) == [("a", "baked"), ("b", "baked")]
    again = bake(["b.xml", "a.xml"])
    assert states(again) == [("b", "kept"), ("a", "kept")]
    assert (again.lamps[0].lumens, again.lamps[0].size) == (5.0, tuple(again.lamps[0].size))
    (folder / "a.xml").write_text(scene(sphere("ball", 2, inside=AREA)))
    assert states(bake(["a.xml", "b.xml"])) == [("a", "baked"), ("b", "kept")]
    assert states(bake(["b.xml"], seed=1)) == [("b", "baked")]
    # An asset of another lamp, and a damaged one.
    shutil.copy(folder / "out/a.lumitree", folder / "out/b.lumitree")
    (folder / "out/a.lumitree").write_text("x")
    assert states(bake(["a.xml", "b.xml"], seed=1)) == [("a", "baked"), ("b", "baked")]
    assert quick == ["a", "b", "a", "b", "a", "b"]


def test_a_lamp_is_known_by_all_its_files(folder, quick):
    """Materials of a model, overrides that are added, and the table of tilts of an IES file."""
    for name in ("one", "two"):
        (folder / f"{name}.obj").write_text(
            f"mtllib {name}.mtl\nusemtl light\nv 0 0 0\nv 0 0 1\nv 1 0 0\nf 1 2 3\n"
        )
        (folder / f"{name}.mtl").write_text("newmtl light\nKe 5 5 5\n")
    text = ies_text([[1000, 500, 0]], [0], [0, 45, 90])
    (folder / "t.ies").write_text(text.replace("TILT=NONE", "TILT=table.tlt"))
    (folder / "table.tlt").write_text(TABLE)
    lamps = ["one.obj", "two.obj", "t.ies"]
    assert {state for _, state in states(bake(lamps))} == {"baked"}
    assert {state for _, state in states(bake(lamps))} == {"kept"}
    (folder / "one.mtl").write_text("newmtl light\nKe 4 5 5\n")
    (folder / "two.toml").write_text('units = "cm"\n')
    (folder / "table.tlt").write_text(TABLE.replace("0.9", "0.85"))
    assert {state for _, state in states(bake(lamps))} == {"baked"}
    (folder / "table.tlt").unlink()
    assert states(bake(["t.ies"])) == [("t", "failed")]


def test_one_failure_does_not_lose_the_others(folder, capsys):
    (folder / "no.glb").write_bytes(b"no")
    assert main(["bake", "a.xml", "dark.xml", "no.glb", "-o", "out", *ARGUMENTS]) == 2
    captured = capsys.readouterr()
    assert "2 of 3 lamps failed (dark, no)" in captured.err
    assert captured.err.count("\n") == 1
    lines = captured.out.splitlines()
    assert re.search(r" a  baked, 57,\d{3} lm, 0\.\d MB, \d+ s", lines[0])
    assert "dark  failed: dark.xml has no emitter" in lines[1]
    assert "no  failed: no.glb is not a GLB file" in lines[2]
    files = sorted(str(path) for path in Path("out").rglob("*.*"))
    images = ["out/index-files/a.jpg", "out/index-files/a.svg"]
    assert files == ["out/a.lumitree", *images, "out/index.html"]
    assert 'src="index-files/a.svg"' in Path("out/index.html").read_text()
    text = Path("out/index.html").read_text()
    assert text.count("<article>") == 3
    assert "failed: dark.xml has no emitter" in text
    assert re.findall(r"<dt>flux</dt><dd>57,\d{3} lm</dd>", text)
    assert len(fingerprint_of("out/a.lumitree")) == 64
    assert main(["bake", "a.xml", "-o", "out/", *ARGUMENTS]) == 0
    assert "a  kept" in capsys.readouterr().out


def test_an_unexpected_error_is_a_failure_and_a_full_disk_ends_the_list(monkeypatch):
    errors = [ZeroDivisionError("division by zero")]

    def fail(*_, **__):
        raise errors[-1]

    monkeypatch.setattr(module, "bake", fail)
    (failed,) = bake(["a.xml"]).failed
    assert failed.error == "unexpected ZeroDivisionError: division by zero"
    errors.append(WriteError(Path("out/a.lumitree"), OSError(28, os.strerror(28))))
    for executor in (None, LastFirst()):
        with pytest.raises(WriteError, match="No space left on device"):
            bake(["a.xml", "b.xml"], executor=executor)


def test_an_executor_gives_the_same_bytes(quick):
    names = ["a.xml", "dark.xml", "b.xml"]
    one = bake(names, "one")
    executor = LastFirst()
    result = bake(names, executor=executor)
    assert states(result) == states(one) == [("a", "baked"), ("dark", "failed"), ("b", "baked")]
    assert {job.name for job in executor.order} == {"a", "b", "dark"}
    assert [lamp.source for lamp in result.lamps] == names
    assert result.lamps[0].path == Path("out/a.lumitree")
    assert contents("out") == contents("one")
    assert result.index.read_text().count("<dt>flux</dt>") == 2
    assert states(bake(names[::2], executor=executor)) == [("a", "kept"), ("b", "kept")]


@pytest.mark.slow
def test_processes_give_the_same_bytes():
    names = ["a.xml", "b.xml"]
    bake(names, "one")
    with process_pool(2) as executor:
        result = bake(names, executor=executor)
    assert states(result) == [("a", "baked"), ("b", "baked")]
    assert contents("out") == contents("one")


def test_parts_of_a_list_are_baked_and_collected(folder, quick, capsys):
    # With the mark of editors of Windows.
    (folder / "lamps.txt").write_text("\ufeffa.xml\n\n b.xml\nc.xml\n", encoding="utf-8")
    line = ["bake", "@lamps.txt", "-o", "out/", *ARGUMENTS, "--task"]
    assert main([*line, "1/2"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [each.split()[0] for each in lines] == ["a", "c", "Open:"]
    assert lines[-1] == "Open: out"
    assert not (folder / "out/index.html").exists()
    assert main([*line, "2/2"]) == 0
    assert main(["collect", "out"]) == 0
    assert (folder / "out/index.html").read_text().count("<dt>flux</dt>") == 3
    found = lumitree.collect("out")
    assert states(found) == [("a", "kept"), ("b", "kept"), ("c", "kept")]
    with pytest.raises(lumitree.LumitreeError, match="sub has no assets"):
        lumitree.collect("sub")


KILLED = """
import os, signal
import lumitree
from support.tiny_bakes import set_qualities, standard

def die(report):
    if report.task.startswith("light of") and report.within.done == 1:
        os.kill(os.getpid(), signal.SIGKILL)

set_qualities(setattr)
lumitree.bake_many(["a.xml", "b.xml", "c.xml"], "out", standard(parts=("light",)), progress=die)
"""


@pytest.mark.slow
def test_a_killed_process_leaves_a_folder_that_continues(folder):
    """With the same bytes as if it had not been killed."""
    names = ["a.xml", "b.xml", "c.xml"]
    bake(names, "one")
    killed = subprocess.run(
        [sys.executable, "-c", KILLED],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
    )
    assert killed.returncode == -signal.SIGKILL
    assert sorted(contents("out")) == ["a.lumitree"]
    assert states(bake(names)) == [("a", "kept"), ("b", "baked"), ("c", "baked")]
    assert contents("out") == contents("one")


def test_a_signal_ends_the_list_and_the_same_call_continues(monkeypatch, quick):
    def stop(*_, **__):
        signal.raise_signal(signal.SIGTERM)

    with monkeypatch.context() as patch:
        patch.setattr(module, "bake", stop)
        stopped = bake(["a.xml", "b.xml"])
    assert stopped.stopped_by == signal.SIGTERM
    assert not stopped.finished
    assert states(stopped) == [("a", "interrupted"), ("b", "waiting")]
    assert "2 lamps (1 interrupted, 1 waiting)" in stopped.index.read_text()
    assert states(bake(["a.xml", "b.xml"])) == [("a", "baked"), ("b", "baked")]


def test_a_signal_after_the_last_bake_changes_nothing(monkeypatch, quick, capfd):
    save = module.save

    def signalled(*args, **options):
        signal.raise_signal(signal.SIGINT)
        return save(*args, **options)

    monkeypatch.setattr(module, "save", signalled)
    assert main(["bake", "a.xml", "-o", "out/", *ARGUMENTS]) == 0
    assert " a  baked" in capfd.readouterr().out


@pytest.mark.slow
def test_the_best_field_so_far_is_written_and_continued(folder):
    stopped = []

    def stop(report):
        if report.task.startswith("bake ") and report.within and report.done > 0.3 and not stopped:
            stopped.append(report)
            signal.raise_signal(signal.SIGINT)

    config = standard(parts=("field",), irradiance_paths=0)
    first = lumitree.bake_many(["a.xml"], "out", config, progress=stop)
    assert states(first) == [("a", "interrupted")]
    assert first.stopped_by == signal.SIGINT
    assert first.lamps[0].lumens > 0
    assert (folder / "out/a.work").is_dir()
    second = lumitree.bake_many(["a.xml"], "out", config)
    assert states(second) == [("a", "baked")]
    assert not (folder / "out/a.work").exists()


def test_wrong_arguments_are_refused_before_any_work(folder, quick):
    (folder / "sub").mkdir()
    for name in ("sub/A.obj", "bulbs.glb"):
        (folder / name).touch()
    (folder / "site").mkdir()
    (folder / "site/index.html").write_text("<title>mine</title>")
    missing = ["a.xml", "none.glb", "bulbs", "bulbz", "sub/two.gldf#x", "none.glb"]
    for names, options, message in (
        ([], {}, "no luminaire"),
        ("bulbs", {}, "luminaires is 'bulbs'; expected a list"),
        (["a.xml", "sub/A.obj"], {}, "a.xml and sub/A.obj would both be written"),
        (["bulbs", "bulbs.glb"], {}, "would both be written"),
        (missing, {}, r"^3 of 4 files are missing: none.glb, bulbz, sub/two.gldf$"),
        (["a.xml"], {"folder": "site"}, "site/index.html is not a page of lumitree"),
        (["a.xml"], {"task": "1/3"}, "task is .*; expected"),
        (["a.xml"], {"task": (1, 2, 3)}, "task is .*; expected"),
        (["a.xml"], {"task": (3, 2)}, "part is 3"),
        (["a.xml"], {"task": (1, 0)}, "parts is 0"),
    ):
        with pytest.raises(lumitree.LumitreeError, match=message):
            bake(names, **options)
    for title in ("", "..", "a/b", "/", "a\n"):
        with pytest.raises(lumitree.LumitreeError, match="; expected the name of a file"):
            LuminaireSource("a.xml", title=title)
    assert (folder / "site/index.html").read_text() == "<title>mine</title>"
    assert not (folder / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("a.xml b.xml -o a.lumitree", "is the name of one asset"),
        ("a.xml b.xml -o out --config work.toml", "work: for one luminaire"),
        ("a.xml b.xml -o out --method network", "method network: for one"),
        ("a.xml b.xml -o a.xml", "a.xml is read, and would be written over"),
        ("a.xml -o a.lumitree --task 1/2", "--task: for several luminaires"),
        ("a.xml b.xml -o out --task 1/2/3", "is not a task; write K/N"),
        ("@none.txt -o out/", "none.txt does not exist; expected a list"),
        ("h=a.xml H=b.xml -o out/", "both be written to out/H.lumitree; give one"),
        ("h=a.xml -o h.lumitree", "h=: for several luminaires; leave it out"),
    ],
)
def test_the_command_refuses(folder, arguments, message, capsys):
    (folder / "work.toml").write_text('work = "w"')
    assert main(["bake", *arguments.split()]) == 2
    assert message in capsys.readouterr().err


def test_the_command_names_settings_that_some_lamps_do_not_use(folder, quick, capsys):
    (folder / "spot.ies").write_text(ies_text([[1000, 500, 0]], [0], [0, 45, 90]))
    assert main(["bake", "a.xml", "spot.ies", "-o", "out/", "--seed", "1", *ARGUMENTS]) == 0
    assert capsys.readouterr().err.count("warning: seed: not used for spot.ies\n") == 1


def test_lamps_may_have_other_names(folder, quick):
    (folder / "x=y.xml").write_text((folder / "c.xml").read_text())
    (folder / "lamps.txt").write_bytes("desk=a.xml\r\nx=y.xml\r\n".encode("utf-16"))
    names = ["hall 2=a.xml", "b.xml", "@lamps.txt", "spot=bulbs"]
    assert main(["bake", *names, "-o", "out/", *ARGUMENTS]) == 0
    assert sorted(contents("out")) == [
        f"{name}.lumitree" for name in ("b", "desk", "hall 2", "spot", "x=y")
    ]
    assert states(bake([LuminaireSource("a.xml", title="hall 2")])) == [("hall 2", "kept")]


def test_long_lists_are_printed_in_short(capsys):
    asset = {"path": Path("a"), "lumens": 1.0, "file_bytes": 1 << 20}
    lamps = [BakedLamp(f"l{number}", "", "kept", **asset) for number in range(100)]
    print_lamps(lamps)
    assert len(capsys.readouterr().out.splitlines()) == 100
    lamps += [
        BakedLamp("new", "", "baked", **asset),
        BakedLamp("dark", "", "failed", error="no light"),
        BakedLamp("half", "", "interrupted", **asset),
    ]
    print_lamps(lamps)
    dark, half, last = capsys.readouterr().out.splitlines()
    assert dark.strip() == "dark  failed: no light"
    assert half.strip().startswith("half  interrupted, 1 lm")
    assert last == "1 lamp baked, 100 kept, 105.9 MB"


@pytest.fixture
def strange(tmp_path):
    """The page of a folder with a lamp of an odd name, and one that failed."""
    name = 'a & "b" <i>%#?'
    path, image = tmp_path / f"{name}.lumitree", tmp_path / "index-files" / f"{name}.jpg"
    image.parent.mkdir()
    image.touch()
    path.touch()
    failed = BakedLamp("Bad", "", "failed", error="<b>no</b> light")
    page.write_index(tmp_path, [BakedLamp(name, "", "baked", path, lumens=1234.5), failed])
    return tmp_path / "index.html"


def test_the_page_loads_files_beside_it_and_escapes_names(strange):
    text = strange.read_text()
    assert "<i>" not in text
    assert "<b>" not in text
    assert "2 lamps (1 failed)" in text
    assert "<dt>flux</dt><dd>1,234 lm</dd>" in text
    linked = re.findall(r'(?:src|href)="([^"]*)"', text)
    assert len(linked) == 2
    for each in linked:
        assert (strange.parent / unquote(html.unescape(each))).is_file()
    # Nothing of another place is loaded.
    assert not re.search(r"https?:|url\(|@import|<link|base64", text)


@pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium")
def test_search_works_in_a_page_that_is_opened_as_a_file(strange):
    script = """<script>
      const input = document.querySelector("input");
      input.value = "bad";
      input.dispatchEvent(new Event("input"));
      const shown = [...document.querySelectorAll("article")].filter(each => !each.hidden);
      document.title = shown.map(each => each.querySelector("h2").textContent).join();
    </script></html>"""
    strange.write_text(strange.read_text().replace("</html>", script))
    found = subprocess.run(
        [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--dump-dom", strange.as_uri()],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert "<title>Bad</title>" in found.stdout
