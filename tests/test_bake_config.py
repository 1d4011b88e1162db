"""The settings of a bake, and the TOML files of `lumitree bake --config`."""

import dataclasses
import operator
import re
import tomllib

import pytest

import lumitree
from lumitree.cli import main
from lumitree.cli.config_file import config_text, read_config
from lumitree.core.toml_table import Table
from lumitree.fit.config import NETWORK_BAKES, QUALITIES, BakeConfig, NetworkConfig

PRESETS = [*QUALITIES.values(), *NETWORK_BAKES.values()]


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def read(text, config, path):
    table = Table(path, "", tomllib.loads(text))
    found = read_config(table, config)
    table.finish()
    return found


def names(config, within=""):
    """Full names of the fields of a dataclass and of its groups."""
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        if dataclasses.is_dataclass(value):
            yield from names(value, f"{within}{field.name}.")
        else:
            yield within + field.name


def test_the_defaults_are_the_documented_qualities():
    assert QUALITIES["standard"] == BakeConfig()
    assert NETWORK_BAKES["preview"] == NetworkConfig()


@pytest.mark.parametrize("config", PRESETS)
def test_a_file_with_all_values_has_the_settings(config, tmp_path):
    values = re.sub(r"^#(\w+ = (?!\.\.\.))", r"\1", config_text(config), flags=re.MULTILINE)
    other = QUALITIES["preview"] if isinstance(config, BakeConfig) else NETWORK_BAKES["preview"]
    found, given = read(values, other, tmp_path / "a.toml")
    assert found == config
    absent = {name for name in names(config) if operator.attrgetter(name)(config) is None}
    assert set(given) == set(names(config)) - absent


@pytest.mark.parametrize("config", [BakeConfig(), NetworkConfig()])
def test_a_written_file_describes_each_setting_and_changes_none(config, tmp_path):
    text = config_text(config)
    assert read(text, config, tmp_path / "a.toml") == (config, [])
    lines = text.splitlines()
    for line, before in zip(lines[1:], lines[:-1], strict=True):
        if re.match(r"#\w+ = ", line):
            assert before.startswith("# "), line


def test_a_budget_of_rays_replaces_that_of_time(tmp_path):
    path = tmp_path / "a.toml"
    assert read("rays = 9", BakeConfig(), path)[0] == BakeConfig(rays=9, time=None)
    both = BakeConfig(rays=9, time=2.0)
    assert read("rays = 9\ntime = 2", BakeConfig(), path)[0] == both
    # The rays of a group are no budget.
    group, given = read("[octree.refine]\nrays = 16", BakeConfig(), path)
    assert group.time == BakeConfig().time
    assert group.octree.refine.rays == 16
    assert given == ["octree.refine.rays"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("tree_depth = 99", "bake.toml: tree depth is 99; expected 1 to 10"),
        ("time = true", "time is 'True'; expected a number"),
        ("law = 'cubic'", "law is 'cubic'; expected linear, exponential"),
        ("tree_deep = 1", "unknown key 'tree_deep'"),
        ("[octree.refine]\nray = 1", "unknown key 'octree.refine.ray'"),
        ("[octree.refine]\nrays = 17", "rays is 17; expected a multiple of 16"),
        (
            'parts = ["field"]\n[octree.views]\nhull_level = 3',
            "octree.views.hull_level: not for a luminaire such as",
        ),
        ("rays = 5", "rays: for the radiance field, which is not made; add --parts all"),
        ("octree = 3", "octree is '3'; expected a table"),
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
    assert main(["bake", *method, "--write-config"]) == 0
    text = capsys.readouterr().out
    assert text == (folder / "bake.toml").read_text(encoding="utf-8")
    tomllib.loads(text)


def test_settings_out_of_range_are_refused_when_they_are_made():
    for options, message in (
        ({"tree_depth": 11}, "tree depth is 11"),
        ({"lumens": 0.0}, "lumens is 0"),
        ({"seed": -1}, "seed is -1"),
        ({"time": None}, "needs a budget"),
    ):
        with pytest.raises(lumitree.LumitreeError, match=message):
            BakeConfig(**options)
    train = dataclasses.replace(NetworkConfig().train, seed=3)
    with pytest.raises(lumitree.LumitreeError, match=r"train\.seed is 3; expected 0"):
        NetworkConfig(train=train)
    literal = dataclasses.replace(NetworkConfig().train, emission_weights="literal")
    with pytest.raises(lumitree.LumitreeError, match="expected decrease, as no asset has others"):
        NetworkConfig(train=literal)


def test_the_order_of_parts_is_no_setting():
    one, other = BakeConfig(parts=["geometry", "field"]), BakeConfig(parts=("field", "geometry"))
    assert one == other
    assert one.parts == ("field", "geometry")
