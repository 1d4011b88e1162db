"""Manifests: what is saved opens again, and everything else is refused in one line."""

import dataclasses
import json

import numpy as np
import pytest

from lumitree.core.frames import LocalFrame, view_pose
from lumitree.errors import LumitreeError
from lumitree.lamp.dataset import MANIFEST, Dataset, Frame, Manifest


def rows(matrix):
    return tuple(map(tuple, np.asarray(matrix, float).tolist()))


@pytest.fixture
def manifest():
    frames = tuple(Frame(f"view_{i}.exr", i, rows(view_pose(i, 2.0))) for i in (1, 2))
    return Manifest(
        luminaire="lamps/lamp",
        fingerprint="0" * 64,
        split="train",
        resolution=16,
        spp=4,
        path_depth=128,
        half_width=1.5,
        local_frame=LocalFrame((1.0, 0.5, 1e-3), np.diag([2, 2, 2, 1])),
        frames=frames,
    )


def test_what_is_saved_opens_again(manifest, tmp_path):
    Dataset(tmp_path, manifest).save_manifest()
    assert Dataset.open(tmp_path).manifest == manifest


def test_names_of_any_characters_are_kept_readable(manifest, tmp_path):
    named = dataclasses.replace(manifest, luminaire="a\nb\x1b/" + 2000 * "x")
    Dataset(tmp_path, named).save_manifest()
    assert Dataset.open(tmp_path).manifest == named
    assert named.luminaire.startswith("a?b?/xxx")


def change(*path, to):
    """Replaces what is at a path of keys and indices by a JSON text."""

    def changed(data):
        inner = data
        for key in path[:-1]:
            inner = inner[key]
        inner[path[-1]] = "@"
        return json.dumps(data).replace('"@"', to)

    return changed


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda data: "", "not valid JSON"),
        (lambda data: "[" * 100_000, "too deep"),
        (lambda data: "[]", "its version is"),
        (lambda data: json.dumps(data)[:-1] + ',"split":"test"}', "two members of one name"),
        (lambda data: json.dumps(data | {"extra": 1}), "unknown key 'extra'"),
        (lambda data: json.dumps({k: data[k] for k in data if k != "split"}), "has no split"),
        (change("version", to="2"), "version is '2'; this lumitree reads 1"),
        (change("version", to="true"), "version is 'True'; this lumitree reads 1"),
        (change("split", to='"other"'), "split is 'other'; expected 'train' or 'test'"),
        (change("resolution", to="1e9"), "expected a whole number"),
        (change("resolution", to="1000000"), "expected 1 to 16384"),
        (change("half_width", to="1e300"), "half_width is 1e+300"),
        (change("half_extents", 0, to="2"), "the longest 1"),
        (change("half_extents", 2, to="1e-300"), "expected 3 lengths of 0.001 or more"),
        (change("world_from_proxy", 0, 3, to="1e39"), "4 x 4 numbers of at most 1e+12"),
        (change("world_from_proxy", 0, 0, to="-2"), "mirrors"),
        (change("frames", to="[]"), "at least one view"),
        (change("frames", to="7"), "expected a list"),
        (change("frames", 0, "file", to='"view_2.exr"'), "a file for each"),
        (change("frames", 0, "file", to='"../x.exr"'), "outside the dataset's folder"),
        (change("frames", 0, "file", to=f'"{200 * "é"}"'), "too long a name"),
        (change("frames", 0, "halton_index", to="1.5"), "expected a whole number"),
        (change("frames", 0, "proxy_from_camera", 0, 0, to="1e300"), "pose of view_1.exr"),
        (change("frames", 0, "proxy_from_camera", 0, to="[1]"), "expected 4 x 4 numbers"),
    ],
)
def test_damaged_manifests_are_refused(manifest, tmp_path, damage, message):
    Dataset(tmp_path, manifest).save_manifest()
    data = json.loads((tmp_path / MANIFEST).read_text())
    (tmp_path / MANIFEST).write_text(damage(data))
    with pytest.raises(LumitreeError, match="is not a valid manifest") as caught:
        Dataset.open(tmp_path)
    assert message in str(caught.value)
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 1000


def test_what_is_no_dataset_is_refused(tmp_path):
    (tmp_path / "folder" / MANIFEST).mkdir(parents=True)
    for folder in (tmp_path, tmp_path / "none", tmp_path / "folder", tmp_path / ("x" * 300)):
        with pytest.raises(LumitreeError, match=r"holds no manifest\.json"):
            Dataset.open(folder)
    (tmp_path / MANIFEST).write_bytes(b"\xff\xfe{}")
    with pytest.raises(LumitreeError, match="not valid JSON"):
        Dataset.open(tmp_path)
