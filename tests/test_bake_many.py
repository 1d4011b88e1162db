"""Many lamps in one folder: what is baked, kept and continued, and the index page."""

import html
import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path
from urllib.parse import unquote

import pytest

import lumitree
from lumitree.cli import main
from lumitree.core.process_pool import process_pool
from lumitree.fit.catalogue import lamp_job
from lumitree.fit.catalogue.claim import claimed
from lumitree.fit.catalogue.record import LampFiles
from support.lamps import AREA, scene, sphere
from support.tiny_bakes import set_qualities, standard

SETTINGS = {"parts": ("light",)}
ARGUMENTS = ("--parts", "light")


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch, mi):
    monkeypatch.chdir(tmp_path)
    set_qualities(monkeypatch.setattr)
    for name, radius in (("a", 1.0), ("b", 0.5)):
        (tmp_path / f"{name}.xml").write_text(scene(sphere("ball", radius, inside=AREA)))
    (tmp_path / "dark.xml").write_text(scene(sphere("ball", 1)))
    return tmp_path


@pytest.fixture
def baked(monkeypatch):
    """Names of the assets that were baked, in order."""
    names, bake = [], lamp_job.bake_source

    def record(source, output, config, **options):
        names.append(output.stem)
        return bake(source, output, config, **options)

    monkeypatch.setattr(lamp_job, "bake_source", record)
    return names


def states(result):
    return [(lamp.name, lamp.state) for lamp in result.lamps]


def contents(folder):
    """Bytes of the assets of a folder by name."""
    return {path.name: path.read_bytes() for path in Path(folder).glob("*.lumitree")}


def files_of_lamps(folder):
    """Names in the folder of the records, without the folder of the pages."""
    return sorted(each.name for each in (folder / "index-files").iterdir() if each.is_file())


@pytest.mark.slow
def test_lamps_are_baked_and_kept_while_source_and_settings_are_equal(folder, baked):
    first = lumitree.bake_many(["a.xml", "b.xml"], "out", standard(**SETTINGS))
    assert states(first) == [("a", "baked"), ("b", "baked")]
    # Four times the area.
    bright, dim = (lamp.figures["lumens"] for lamp in first.lamps)
    assert bright / dim == pytest.approx(4, rel=0.02)
    again = lumitree.bake_many(["b.xml", "a.xml"], "out", standard(**SETTINGS))
    assert states(again) == [("b", "kept"), ("a", "kept")]
    assert again.lamps[1].figures == first.lamps[0].figures
    assert again.lamps[1].seconds > 0
    (folder / "a.xml").write_text(scene(sphere("ball", 2, inside=AREA)))
    changed = lumitree.bake_many(["a.xml", "b.xml"], "out", standard(**SETTINGS))
    assert states(changed) == [("a", "baked"), ("b", "kept")]
    other = lumitree.bake_many(["b.xml"], "out", standard(**SETTINGS, seed=1))
    assert states(other) == [("b", "baked")]
    # An asset that is not the one of the record.
    (folder / "out/b.lumitree").write_bytes((folder / "out/a.lumitree").read_bytes())
    (folder / "out/index-files/a.json").write_text('{"version": 1}')
    replaced = lumitree.bake_many(["a.xml", "b.xml"], "out", standard(**SETTINGS, seed=1))
    assert states(replaced) == [("a", "baked"), ("b", "baked")]
    assert baked == ["a", "b", "a", "b", "a", "b"]


def test_one_failure_does_not_lose_the_others(folder, capsys):
    (folder / "no.glb").write_bytes(b"no")
    assert main(["bake", "a.xml", "dark.xml", "no.glb", "-o", "out", *ARGUMENTS]) == 2
    captured = capsys.readouterr()
    assert "2 of 3 lamps failed (dark, no)" in captured.err
    assert captured.err.count("\n") == 1
    lines = captured.out.splitlines()
    assert re.search(r" a  baked, 57,\d{3} lm, 0\.\d MB, \d+ s", lines[0])
    assert "dark  failed: dark.xml holds no emitter" in lines[1]
    assert "no  failed: no.glb is not a GLB file" in lines[2]
    assert sorted(path.name for path in (folder / "out").iterdir()) == [
        "a.lumitree", "index-files", "index.html",
    ]  # fmt: skip
    assert files_of_lamps(folder / "out") == ["a.json", "a.webp", "dark.failed", "no.failed"]
    page = (folder / "out/index.html").read_text()
    assert page.count("<article>") == 3
    assert "failed: dark.xml holds no emitter" in page
    assert main(["bake", "a.xml", "-o", "out/", *ARGUMENTS]) == 0
    assert "a  kept" in capsys.readouterr().out


def test_an_unexpected_error_is_a_failure_too(monkeypatch):
    def fail(*_, **__):
        raise ZeroDivisionError("division by zero")

    monkeypatch.setattr(lamp_job, "bake_source", fail)
    result = lumitree.bake_many(["a.xml"], "out", standard(**SETTINGS))
    assert result.failed[0].error == "unexpected ZeroDivisionError: division by zero"


@pytest.mark.slow
def test_processes_give_the_same_bytes(folder):
    names = ["a.xml", "b.xml"]
    lumitree.bake_many(names, "one", standard(**SETTINGS))
    with process_pool(2) as executor:
        result = lumitree.bake_many(names, "out", standard(**SETTINGS), executor=executor)
    assert states(result) == [("a", "baked"), ("b", "baked")]
    assert contents("out") == contents("one")


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
    (folder / "c.xml").write_text(scene(sphere("ball", 0.25, inside=AREA)))
    config = standard(**SETTINGS)
    lumitree.bake_many(["a.xml", "b.xml", "c.xml"], "one", config)
    killed = subprocess.run(
        [sys.executable, "-c", KILLED], cwd=folder,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
    )  # fmt: skip
    assert killed.returncode == -signal.SIGKILL
    assert "b.claim" in files_of_lamps(folder / "out")
    assert sorted(contents("out")) == ["a.lumitree"]
    result = lumitree.bake_many(["a.xml", "b.xml", "c.xml"], "out", config)
    assert states(result) == [("a", "kept"), ("b", "baked"), ("c", "baked")]
    assert contents("out") == contents("one")
    assert files_of_lamps(folder / "out") == files_of_lamps(folder / "one")


def test_a_signal_while_a_list_waits_is_heeded(folder, monkeypatch):
    monkeypatch.setattr(
        "lumitree.fit.catalogue.bake_many.time.sleep", lambda _: signal.raise_signal(signal.SIGTERM)
    )
    with claimed(folder / "out/index-files/a.claim") as owner:
        assert owner is None
        with pytest.warns(
            lumitree.LumitreeWarning, match=f"^process {os.getpid()} on .* works on a; the"
        ):
            result = lumitree.bake_many(["a.xml"], "out", standard(**SETTINGS))
    assert result.stopped_by == signal.SIGTERM
    assert not result.finished


def test_a_signal_after_the_last_lamp_changes_nothing(monkeypatch, capfd):
    target = LampFiles, "write"
    original = getattr(*target)

    def write(*args, **options):
        signal.raise_signal(signal.SIGINT)
        return original(*args, **options)

    monkeypatch.setattr(*target, write)
    assert main(["bake", "a.xml", "-o", "out/", *ARGUMENTS]) == 0
    assert " a  baked" in capfd.readouterr().out


@pytest.mark.slow
def test_the_best_field_so_far_is_written_and_continued(folder, monkeypatch, baked):
    stopped = []

    def stop(report):
        if report.task.startswith("bake ") and report.within and report.done > 0.3 and not stopped:
            stopped.append(report)
            signal.raise_signal(signal.SIGINT)

    settings = {"parts": ("field",), "irradiance_paths": 0, "rays": 1 << 19}
    first = lumitree.bake_many(["a.xml"], "out", standard(**settings), progress=stop)
    assert states(first) == [("a", "interrupted")]
    assert first.stopped_by == signal.SIGINT
    assert first.lamps[0].figures["lumens"] > 0
    assert (folder / "out/a.work").is_dir()
    second = lumitree.bake_many(["a.xml"], "out", standard(**settings))
    assert states(second) == [("a", "baked")]
    assert not (folder / "out/a.work").exists()
    assert second.lamps[0].seconds > first.lamps[0].seconds


def test_names_and_arguments_are_checked_first(folder):
    (folder / "sub").mkdir()
    for name in ("sub/A.obj", "bulbs.glb"):
        (folder / name).touch()
    for names, message in (
        ([], "no luminaire"),
        (["a.xml", "sub/A.obj"], "a.xml and sub/A.obj would both be written to out/A.lumitree"),
        (["bulbs", "bulbs.glb"], "would both be written"),
    ):
        with pytest.raises(lumitree.LumitreeError, match=message):
            lumitree.bake_many(names, "out")
    (folder / "site").mkdir()
    (folder / "site/index.html").write_text("<title>mine</title>")
    with pytest.raises(lumitree.LumitreeError, match=r"site/index.html is not a page of lumitree"):
        lumitree.bake_many(["a.xml"], "site")
    assert (folder / "site/index.html").read_text() == "<title>mine</title>"
    assert not (folder / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["a.xml", "b.xml", "-o", "a.lumitree"], "is the name of one asset"),
        (["a.xml", "b.xml", "-o", "out", "--config", "work.toml"], "work: for one luminaire"),
        (["a.xml", "b.xml", "-o", "out", "--method", "network"], "method network: for one"),
        (["a.xml", "b.xml", "-o", "a.xml"], "a.xml is read, and would be written over"),
    ],
)
def test_command_refuses(folder, arguments, message, capsys):
    (folder / "work.toml").write_text('work = "w"')
    assert main(["bake", *arguments]) == 2
    assert message in capsys.readouterr().err


def test_the_page_loads_files_beside_it_and_escapes_names(folder):
    name = 'a & "b" <i>%'
    (folder / f"{name}.xml").write_text(scene(sphere("ball", 1, inside=AREA)))
    result = lumitree.bake_many([f"{name}.xml"], "out", standard(**SETTINGS))
    page = result.index.read_text()
    assert 'href="a%20%26%20%22b%22%20%3Ci%3E%25.lumitree"' in page
    assert "<i>" not in page
    # What is loaded lies beside it.
    for each in re.findall(r'(?:src|href)="([^"]*)"', page):
        assert (folder / "out" / unquote(html.unescape(each))).is_file()
    assert re.findall(r"<dt>flux</dt><dd>57,\d{3} lm</dd>", page)
    record = json.loads((folder / "out/index-files" / f"{name}.json").read_text())
    assert record["figures"]["size"] == [2, 2, 2]
    assert record["figures"]["irradiance_rms"] > 0
    assert LampFiles(folder / "out", name).read().finished
