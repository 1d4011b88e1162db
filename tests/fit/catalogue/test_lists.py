"""Lists of lamps, whose bakes are replaced by quick ones: what is baked, kept and divided."""

import json
import os
import signal
from pathlib import Path
from types import SimpleNamespace

import pytest

import lumitree
from lumitree.cli import bake as bake_command
from lumitree.cli import main
from lumitree.cli.output import print_lamps
from lumitree.core.dask_executor import dask_executor
from lumitree.core.files import WriteError
from lumitree.fit.catalogue import lamp_job
from lumitree.fit.catalogue.record import BakedLamp, LampFiles
from lumitree.lamp.source import LuminaireSource
from support.baked_folders import bake_nothing, make_old
from support.executors import LastFirst
from support.lamps import AREA, scene, sphere
from support.tiny_bakes import set_qualities, standard

SETTINGS = {"parts": ("light",)}
ARGUMENTS = ("--parts", "light")


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch, mi):
    monkeypatch.chdir(tmp_path)
    set_qualities(monkeypatch.setattr)
    for name, radius in (("a", 1.0), ("b", 0.5), ("c", 0.25)):
        (tmp_path / f"{name}.xml").write_text(scene(sphere("ball", radius, inside=AREA)))
    (tmp_path / "dark.xml").write_text(scene(sphere("ball", 1)))
    return tmp_path


@pytest.fixture(autouse=True)
def baked(monkeypatch):
    """Names of the assets that were baked, in order."""
    return bake_nothing(monkeypatch, lambda source: int(source.fingerprint[:4], 16))


def bake(names, folder="out", **options):
    return lumitree.bake_many(names, folder, standard(**SETTINGS), **options)


def states(result):
    return [(lamp.name, lamp.state) for lamp in result.lamps]


def contents(folder):
    """Bytes of the assets of a folder by name."""
    return {path.name: path.read_bytes() for path in Path(folder).glob("*.lumitree")}


def test_lamps_are_kept_without_being_loaded(folder, monkeypatch):
    make_old(folder / "a.xml", folder / "b.xml")
    bake(["a.xml", "b.xml"], "out")
    monkeypatch.setattr(
        "lumitree.lamp.loading.load_luminaire", lambda *_: pytest.fail("a lamp was loaded")
    )
    kept = bake(["a.xml", "b.xml"], "out")
    assert states(kept) == [("a", "kept"), ("b", "kept")]
    # The same content, written again.
    (folder / "a.xml").write_bytes((folder / "a.xml").read_bytes())
    kept = bake(["a.xml"], "out")
    assert states(kept) == [("a", "kept")]


def test_a_folder_of_the_first_version_is_kept(folder, baked):
    """Once the lamps are loaded; the records then are of this version."""
    bake(["a.xml"], "out")
    path = folder / "out/index-files/a.json"
    record = json.loads(path.read_text())
    first = {key: record[key] for key in ("fingerprint", "settings", "seconds", "figures", "state")}
    path.write_text(json.dumps({"version": 1, "asset_sha256": record["asset"][-1], **first}))
    make_old(folder / "a.xml")
    again = bake(["a.xml"], "out")
    assert states(again) == [("a", "kept")]
    assert baked == ["a"]
    after = json.loads(path.read_text())
    assert after["version"] == 2
    assert [name for name, *_ in after["files"]] == ["../a.xml"]
    (folder / "out/index-files/folder/version.json").write_text('{"version": 3}')
    with pytest.raises(lumitree.LumitreeError, match="out has records of version 3"):
        bake(["a.xml"], "out")


def test_an_executor_gives_the_same_bytes(folder):
    names = ["a.xml", "dark.xml", "b.xml"]
    bake(names, "one")
    executor = LastFirst()
    result = bake(names, "out", executor=executor)
    assert states(result) == [("a", "baked"), ("dark", "failed"), ("b", "baked")]
    assert {job.name for job in executor.order} == {"a", "b", "dark"}
    assert [lamp.source for lamp in result.lamps] == names
    assert result.lamps[0].path == Path("out/a.lumitree")
    assert contents("out") == contents("one")
    assert result.index.read_text().count("<dt>flux</dt>") == 2
    again = bake(names[::2], "out", executor=executor)
    assert states(again) == [("a", "kept"), ("b", "kept")]
    # The records of both are the same but for their times.
    for name in ("a", "b"):
        records = [LampFiles(folder / each, name).read() for each in ("one", "out")]
        assert records[0].options == records[1].options
        assert records[0].figures == records[1].figures


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_lists_that_windows_writes(folder, monkeypatch, encoding):
    """With its marks, its ends of lines, and the sign that ends the name of a folder there."""
    monkeypatch.setattr(bake_command, "SEPARATORS", ("/", "\\"))
    taken = []
    monkeypatch.setattr(lumitree, "bake_many", lambda names, *_, **__: taken.extend(names))
    monkeypatch.setattr(bake_command, "show", lambda *_: None)
    (folder / "lamps.txt").write_bytes("größe.xml\r\n".encode(encoding))
    assert main(["bake", "@lamps.txt", "-o", "out\\"]) == 0
    assert [Path(str(getattr(each, "name", each))).name for each in taken] == ["größe.xml"]


def test_a_list_in_another_encoding_is_refused(folder, capsys, monkeypatch):
    """Where names of files are in UTF-8, as on Windows."""
    monkeypatch.setattr(bake_command, "os", SimpleNamespace(fsdecode=lambda each: each.decode()))
    (folder / "lamps.txt").write_bytes("größe.xml".encode("cp1252"))
    assert main(["bake", "@lamps.txt", "-o", "out/"]) == 2
    assert "lamps.txt is not in UTF-8; save the list" in capsys.readouterr().err


def test_patterns_that_no_shell_replaces(folder, monkeypatch):
    monkeypatch.setattr(bake_command, "SHELL_EXPANDS", False)
    for name in ("[c].xml", "d[1].xml"):
        (folder / name).touch()
    names = ["?.xml", "d[1].xml", "none*.xml"]
    assert bake_command._listed(names) == ["a.xml", "b.xml", "c.xml", "d[1].xml", "none*.xml"]


def test_parts_of_a_list_are_baked_and_collected(folder, capsys):
    (folder / "c.xml").write_text(scene(sphere("ball", 0.25, inside=AREA)))
    # With the mark of editors of Windows.
    (folder / "lamps.txt").write_text("\ufeffa.xml\n\n b.xml\nc.xml\n", encoding="utf-8")
    line = ["bake", "@lamps.txt", "-o", "out/", *ARGUMENTS, "--task"]
    assert main([*line, "1/2"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [each.split()[0] for each in lines] == ["a", "c", "Open:"]
    assert lines[-1] == "Open: out"
    assert not (folder / "out/index.html").exists()
    assert main(["collect", "out"]) == 2
    captured = capsys.readouterr()
    assert "tasks that have not begun: 1 (2); the same tasks bake what is missing" in captured.err
    assert "Open: out/index.html" in captured.out
    assert main([*line, "2/2"]) == 0
    assert main(["collect", "out"]) == 0
    assert (folder / "out/index.html").read_text().count("<dt>flux</dt>") == 3
    assert sorted(contents("out")) == ["a.lumitree", "b.lumitree", "c.lumitree"]
    # A file that a killed process was about to rename.
    (folder / "out/index-files/.d.lumitree-abcdefgh.failed").write_text("{}")
    found = lumitree.collect("out")
    assert (found.problem, found.missing_tasks) == (None, [])
    with pytest.raises(lumitree.LumitreeError, match="sub is not a folder of baked lamps"):
        lumitree.collect("sub")


def test_a_part_that_is_stopped_is_missing(folder, monkeypatch):
    def stop(*_, **__):
        raise lumitree.Interrupted(number=signal.SIGTERM)

    with monkeypatch.context() as patch:
        patch.setattr(lamp_job, "bake_source", stop)
        stopped = lumitree.bake_many(
            ["a.xml", "dark.xml"], "out", standard(**SETTINGS), task=(1, 1)
        )
    assert stopped.stopped_by == signal.SIGTERM
    found = lumitree.collect("out")
    assert found.problem.startswith("of 2 lamps 2 not baked yet (a, dark); the same tasks")
    bake(["a.xml", "dark.xml"], "out", task=(1, 1))
    problem = lumitree.collect("out").problem
    assert problem.startswith("of 2 lamps 1 failed (dark); ")


def test_one_lamp_and_odd_tasks_in_place_of_lists_are_refused():
    with pytest.raises(lumitree.LumitreeError, match="luminaires is 'bulbs'; expected a list"):
        bake("bulbs")
    for task in ("1/3", (1, 2, 3), 1):
        with pytest.raises(lumitree.LumitreeError, match=r"task is .*; expected \(number, count\)"):
            bake(["a.xml"], task=task)


def test_workers_get_the_variant_that_is_set(mi):
    job = lamp_job.LampJob(Path("out"), "a", LuminaireSource("a.xml"), standard(), "", None)
    assert job.elsewhere().variant == mi.variant()


def test_a_full_disk_ends_the_list(folder, monkeypatch):
    def fail(*_, **__):
        raise WriteError(Path("out/a.lumitree"), OSError(28, os.strerror(28)))

    monkeypatch.setattr(lamp_job, "bake_source", fail)
    for executor in (None, LastFirst()):
        with pytest.raises(WriteError, match="No space left on device"):
            bake(["a.xml", "b.xml"], executor=executor)
    assert not list((folder / "out/index-files").glob("*.failed"))


def test_options_for_lists_are_refused_for_one_lamp(capsys):
    assert main(["bake", "a.xml", "-o", "a.lumitree", "--task", "1/2"]) == 2
    assert "--task: for several luminaires" in capsys.readouterr().err
    for text in ("0/2", "3/2", "1", "1/2/3", "a/b"):
        assert main(["bake", "a.xml", "b.xml", "-o", "out", "--task", text]) == 2
        assert "is not a task; write K/N" in capsys.readouterr().err
    assert main(["bake", "@none.txt", "-o", "out/"]) == 2
    assert "none.txt does not exist; expected a list of luminaires" in capsys.readouterr().err


def test_missing_files_are_named_before_the_start(folder, capsys):
    """All in one line, also files of overrides and unknown built-in names."""
    names = ["a.xml", "none.glb", "bulbs", "bulbz", "sub/two.gldf#x", "none.glb"]
    with pytest.raises(lumitree.LumitreeError, match=r"^3 of 4 files are missing") as error:
        bake(names)
    assert str(error.value).endswith(": none.glb, bulbz, sub/two.gldf")
    (folder / "lamps.txt").write_text("a.xml\nnone.xml\nhall=never.obj\n")
    assert main(["bake", "@lamps.txt", "b.xml", "-o", "out/", "--materials", "m.toml"]) == 2
    assert "3 of 5 files are missing: none.xml, never.obj, m.toml" in capsys.readouterr().err
    assert not (folder / "out").exists()


def test_a_lamp_may_have_another_name(folder, capsys):
    (folder / "x=y.xml").write_text((folder / "c.xml").read_text())
    (folder / "lamps.txt").write_text("desk=a.xml\nx=y.xml\n")
    names = ["hall 2=a.xml", "b.xml", "@lamps.txt", "spot=bulbs"]
    assert main(["bake", *names, "-o", "out/", *ARGUMENTS]) == 0
    assert sorted(contents("out")) == [
        f"{name}.lumitree" for name in ("b", "desk", "hall 2", "spot", "x=y")
    ]
    source = LuminaireSource("a.xml", title="hall 2")
    assert states(bake([source])) == [("hall 2", "kept")]
    capsys.readouterr()
    for arguments, message in (
        (
            ["h=a.xml", "H=b.xml", "-o", "out/"],
            "both be written to out/H.lumitree; give one",
        ),
        (["h=a.xml", "-o", "h.lumitree"], "h=: for several luminaires; leave it out"),
    ):
        assert main(["bake", *arguments]) == 2
        assert message in capsys.readouterr().err
    for title in ("", "..", "a/b", "/", "a\n"):
        with pytest.raises(lumitree.LumitreeError, match="; expected the name of a file"):
            LuminaireSource("a.xml", title=title)


def test_long_lists_are_printed_in_short(capsys):
    figures = {"lumens": 1.0, "file_bytes": 1 << 20}
    lamps = [BakedLamp(f"l{number}", "", "kept", figures=figures) for number in range(100)]
    print_lamps(lamps)
    assert len(capsys.readouterr().out.splitlines()) == 100
    lamps += [
        BakedLamp("new", "", "baked", figures=figures),
        BakedLamp("dark", "", "failed", error="no light"),
        BakedLamp("half", "", "interrupted", figures=figures),
    ]
    print_lamps(lamps)
    dark, half, last = capsys.readouterr().out.splitlines()
    assert dark.strip() == "dark  failed: no light"
    assert half.strip().startswith("half  interrupted, 1 lm")
    assert last == "1 lamp baked, 100 kept, 105.9 MB"


def test_a_model_is_kept_by_the_files_that_it_names(folder):
    for name in ("one", "two"):
        (folder / f"{name}.obj").write_text(f"mtllib {name}.mtl\nusemtl light\nv 0 0 0\n"
                                            "v 0 0 1\nv 1 0 0\nf 1 2 3\n")  # fmt: skip
        (folder / f"{name}.mtl").write_text("newmtl light\nKe 5 5 5\n")
        make_old(folder / f"{name}.obj", folder / f"{name}.mtl")
    assert states(bake(["one.obj", "two.obj"])) == [("one", "baked"), ("two", "baked")]
    assert states(bake(["one.obj", "two.obj"])) == [("one", "kept"), ("two", "kept")]
    stamps = LampFiles(folder / "out", "one").read().files
    assert [stamp.name for stamp in stamps] == ["../one.mtl", "../one.obj", "../one.toml"]
    # Materials that are changed, and overrides that are added.
    (folder / "one.mtl").write_text("newmtl light\nKe 4 5 5\n")
    (folder / "two.toml").write_text('units = "cm"\n')
    assert states(bake(["one.obj", "two.obj"])) == [("one", "baked"), ("two", "baked")]


# Dask's own, of its event loops.
@pytest.mark.filterwarnings("ignore::ResourceWarning")
def test_workers_of_dask_give_the_same_bytes(folder):
    distributed = pytest.importorskip("distributed")
    names = ["a.xml", "dark.xml", "b.xml", "c.xml"]
    bake(names, "one")
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=False, protocol="tcp://",
            dashboard_address=":0",
        ) as cluster,
        dask_executor(cluster.scheduler_address) as executor,
    ):  # fmt: skip
        result = bake(names, "out", executor=executor)
    assert states(result) == [("a", "baked"), ("dark", "failed"), ("b", "baked"), ("c", "baked")]
    assert contents("out") == contents("one")
