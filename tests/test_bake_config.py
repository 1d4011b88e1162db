"""The settings of a bake, and the TOML files of `lumitree bake --config`."""

import dataclasses
import re
import tomllib

import pytest

import lumitree
from lumitree.cli import main
from lumitree.cli.config_file import config_text, read_config
from lumitree.fit.config import BakeConfig, NetworkConfig
from lumitree.fit.octree.config import OctreeConfig

CONFIGS = [
    *(BakeConfig.of(quality) for quality in ("preview", "standard", "high")),
    *(BakeConfig.of(quality, "network") for quality in ("preview", "paper")),
]


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def read(text, path, **options):
    path.write_text(text)
    return read_config(str(path), **options)[0]


def test_the_defaults_are_the_documented_qualities():
    assert BakeConfig.of("standard") == BakeConfig() == BakeConfig.of()
    assert BakeConfig.of(method="network") == BakeConfig.of("preview", "network")
    for quality, method in (("paper", "octree"), ("high", "network"), ("highest", "octree")):
        with pytest.raises(lumitree.LumitreeError, match="quality"):
            BakeConfig.of(quality, method)


@pytest.mark.parametrize("config", CONFIGS)
def test_a_file_with_all_values_has_the_settings(config, tmp_path):
    values = re.sub(r"^#(\w+ = (?!\.\.\.))", r"\1", config_text(config), flags=re.MULTILINE)
    assert read(values, tmp_path / "a.toml", quality="preview") == config


def test_a_written_file_describes_each_setting_and_changes_none(tmp_path):
    text = config_text(BakeConfig())
    assert read(text, tmp_path / "a.toml", quality="high") == BakeConfig.of("high")
    lines = text.splitlines()
    for line, before in zip(lines[1:], lines[:-1], strict=True):
        if re.match(r"#\w+ = ", line):
            assert before.startswith("# "), line


def test_a_budget_of_rays_replaces_that_of_time(tmp_path):
    path = tmp_path / "a.toml"
    assert read("[octree]\nrays = 9", path).octree == OctreeConfig(rays=9, time=None)
    assert read("[octree]\nrays = 9\ntime = 2", path).octree == OctreeConfig(rays=9, time=2.0)
    # The rays of a group are no budget.
    group = read("[octree.refine]\nrays = 16", path)
    assert group.octree.time == BakeConfig().octree.time
    assert group.octree.refine.rays == 16


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[octree]\ntree_depth = 99", "bake.toml: tree depth is 99; expected 1 to 10"),
        ("[octree]\ntime = true", "octree.time is 'True'; expected a number"),
        ("[octree]\nlaw = 'cubic'", "octree.law is 'cubic'; expected 'linear' or 'exponential'"),
        ("[octree]\ntree_deep = 1", "'octree.tree_deep'; did you mean 'tree_depth'?"),
        ("[octree.refine]\nray = 1", "unknown key 'octree.refine.ray'"),
        ("[octree.refine]\nrays = 17", "rays is 17; expected a multiple of 16"),
        ("octree = 3", "octree is '3'; expected a table"),
        ("method = ['octree']", "bake.toml: method is \"['octree']\"; expected 'octree' or"),
    ],
)
def test_files_that_are_wrong_are_refused(folder, capsys, text, message):
    (folder / "bake.toml").write_text(text)
    assert main(["bake", "bulbs", "-o", "a.lumitree", "--config", "bake.toml"]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert [path.name for path in folder.iterdir()] == ["bake.toml"]


@pytest.mark.parametrize("method", [[], ["--method", "network", "--quality", "paper"]])
def test_a_command_writes_a_file(folder, capsys, method):
    assert main(["bake", *method, "--write-config", "bake.toml"]) == 0
    assert capsys.readouterr().out == "Open: bake.toml\n"
    assert main(["bake", *method, "--write-config", "-"]) == 0
    text = capsys.readouterr().out
    assert text == (folder / "bake.toml").read_text(encoding="utf-8")
    tomllib.loads(text)


def test_a_method_that_is_given_replaces_the_method_of_a_file(tmp_path):
    assert read("method = 'network'", tmp_path / "a.toml", method="octree") == BakeConfig()


def test_a_written_file_has_no_other_settings(folder, capsys):
    assert main(["bake", "--write-config", "bake.toml", "--time", "9"]) == 2
    assert "time: not written by --write-config" in capsys.readouterr().err
    assert list(folder.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"config": "high"}, "config is 'high'; expected an object of BakeConfig"),
        ({"config": OctreeConfig()}, "expected an object of BakeConfig"),
        ({"quality": ["high"]}, r"is \['high'\]; expected preview"),
        ({"parts": 3}, "parts are 3; expected a list of texts"),
        ({"lumens": True}, "lumens is True; expected"),
    ],
)
def test_arguments_of_other_types_are_refused(arguments, message):
    with pytest.raises(lumitree.LumitreeError, match=message):
        lumitree.bake("bulbs", **arguments)


def test_settings_out_of_range_are_refused_when_they_are_made():
    literal = dataclasses.replace(NetworkConfig().train, emission_weights="literal")
    for make, message in (
        (lambda: OctreeConfig(tree_depth=11), "tree depth is 11"),
        (lambda: OctreeConfig(time=None), "needs a budget"),
        (lambda: BakeConfig(lumens=0.0), "lumens is 0"),
        (lambda: BakeConfig(seed=-1), "seed is -1"),
        (lambda: NetworkConfig(views=0), "views is 0"),
        (lambda: BakeConfig(octree={"tree_depth": 7}), "expected an object of OctreeConfig"),
        (lambda: NetworkConfig(train=literal), "expected decrease"),
    ):
        with pytest.raises(lumitree.LumitreeError, match=message):
            make()


def test_the_order_of_parts_is_no_setting():
    one, other = BakeConfig(parts=["geometry", "field"]), BakeConfig(parts=("field", "geometry"))
    assert one == other
    assert one.parts == ("field", "geometry")
