"""Settings that a source does not use: arguments, options of a command, and keys of a file."""

import re
from pathlib import Path

import pytest

import lumitree
from lumitree.cli import main
from lumitree.fit.config import BakeConfig, refuse_unused

FILE = "not for a photometric file such as a.ies; leave it out"
DATASET = "not for a dataset such as views; leave it out"
NO_FIELD = "for the radiance field, which is not made; add the part field"
NO_LIGHT = "for the part light, which is not made; leave it out"
NETWORK = "method = 'network'\n"
FIELD = "parts = ['field']\n"


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "views").mkdir()
    for name in ("a.ies", "b.ies", "c.ray", "lamp.xml", "views/manifest.json"):
        (tmp_path / name).touch()


@pytest.mark.parametrize(
    ("sources", "arguments", "message"),
    [
        (["a.ies"], {"quality": "high", "seed": 0}, f"quality, seed: {FILE}"),
        (["a.ies"], {"time": 3.0, "rays": 9}, f"time, rays: {FILE}"),
        (["a.ies", "b.ies"], {"quality": "high"}, f"quality: {FILE}"),
        (["lamp.xml"], {"time": 3.0}, f"time: {NO_FIELD}"),
        (["lamp.xml", "bulbs"], {"parts": ("light",), "rays": 9}, f"rays: {NO_FIELD}"),
        (["views"], {"method": "octree"}, f"method: {DATASET}"),
    ],
)  # fmt: skip
def test_one_table_serves_one_source_and_lists_and_both_interfaces(
    sources, arguments, message, capsys
):
    lists = len(sources) > 1
    bake = lumitree.bake_many if lists else lumitree.bake
    with pytest.raises(lumitree.LumitreeError, match=re.escape(message)):
        bake(sources if lists else sources[0], "out" if lists else None, **arguments)
    texts = {name: ",".join(value) if name == "parts" else str(value)
             for name, value in arguments.items()}  # fmt: skip
    options = [part for name, text in texts.items() for part in (f"--{name}", text)]
    output = "out/" if lists else "out.lumitree"
    assert main(["bake", *sources, "-o", output, *options]) == 2
    assert capsys.readouterr().err == f"lumitree: error: {message}\n"
    assert not Path("out").exists()


@pytest.mark.parametrize(
    ("source", "file", "options", "message"),
    [
        ("a.ies", "[light]\npaths = 9", [], f"light: {FILE}"),
        ("a.ies", NETWORK, [], f"method: {FILE}"),
        ("a.ies", "work = 'w'\nseed = 1", [], f"seed, work: {FILE}"),
        ("a.ies", "lumens = 9", ["--quality", "high"], f"quality: {FILE}"),
        ("a.ies", "", ["--workers", "2"], f"workers: {FILE}"),
        ("views", "[light]\npaths = 9\n[octree.estimate]\nrays = 16", [],
         f"light, octree.estimate: {DATASET}"),
        ("lamp.xml", "[octree]\ntree_depth = 5", [], f"octree: {NO_FIELD}"),
        ("lamp.xml", f"{FIELD}[light]\npaths = 9", [], f"light: {NO_LIGHT}"),
        ("lamp.xml", FIELD, ["--scheduler", "tcp://a:1"], f"scheduler: {NO_LIGHT}"),
        ("lamp.xml", "[network]\nviews = 9", [],
         "network: for the method network; add the method, or leave it out"),
        ("lamp.xml", f"{FIELD}[octree.views]\nhull_level = 5", [],
         "octree.views: only for a dataset; leave it out"),
        ("lamp.xml", f"{NETWORK}[octree]\ntree_depth = 5", [],
         "octree: of the method octree; leave it out"),
        ("lamp.xml", NETWORK, ["--time", "9"], "time: of the method octree; leave it out"),
    ],
)  # fmt: skip
def test_files_and_options_are_refused_as_they_are_written(source, file, options, message, capsys):
    Path("s.toml").write_text(file)
    assert main(["bake", source, "-o", "a.lumitree", "--config", "s.toml", *options]) == 2
    assert capsys.readouterr().err == f"lumitree: error: {message}\n"


def test_settings_that_some_lamps_use_are_a_warning():
    with pytest.warns(lumitree.LumitreeWarning, match="seed: not used for a.ies and 1 more"):
        refuse_unused(["seed"], BakeConfig(), ["a.ies", "bulbs", "b.ies"])
    # Ray files are binned to a light field, as light paths are.
    refuse_unused(["light"], BakeConfig(), ["c.ray"])
