"""TOML files and tables of points."""

import contextlib
import tomllib

import numpy as np

from fuzz import json_trees
from fuzz.reader import Reader
from fuzz.values import chance, pick, text, token
from lumitree.measure.receivers import read_points
from lumitree.rendering.placement_file import read_placements
from support.damage import damaged
from support.placement_text import PLACEMENTS

_TOML_SEPARATORS = (b" ", b" = ", b", ", b".", b'"', b"[")


def changed_toml(content, rng):
    """A TOML file with some changes."""
    if chance(rng, 0.8):
        # An earlier change may have left no TOML, or one that is nested too deeply.
        with contextlib.suppress(ValueError, RecursionError):
            tree = tomllib.loads(content.decode())
            return json_trees.written_toml(json_trees.changed(tree, rng))
    return damaged(content, rng, _TOML_SEPARATORS)


def _placements(rng):
    return {"lights.toml": changed_toml(PLACEMENTS.encode(), rng)}


def _sound_placements(found):
    for each in found:
        assert each.label is not None
        for values in (each.at, each.rotate, each.size, each.gain, each.lumens, each.temperature):
            assert values is None or np.isfinite(np.array(values, float)).all()


def _points(rng):
    names = ["x", "y", "z", "nx", "ny", "nz", "room"][: pick(rng, (6, 6, 7))]
    rng.shuffle(names)
    rows = [names]
    for _ in range(int(rng.integers(0, 8))):
        row = [f"{value:.6g}" for value in rng.normal(size=len(names))]
        if chance(rng, 0.1):
            row[int(rng.integers(len(row)))] = text(rng) if chance(rng, 0.3) else token(rng, row[0])
        rows.append(row)
    separator = pick(rng, (",",) * 9 + (", ",) * 3 + (";",))
    content = pick(rng, ("\n", "\r\n")).join(separator.join(row) for row in rows)
    content = content.encode(pick(rng, ("utf-8", "utf-8-sig")), "surrogatepass")
    if chance(rng, 0.4):
        content = damaged(content, rng, (b",",))
    return {"points.csv": content}


def _sound_points(found):
    points, normals = found
    assert points.shape == normals.shape
    assert points.shape[1] == 3
    assert len(points) > 0


READERS = (
    Reader(
        "placements",
        _placements,
        lambda folder: read_placements(folder / "lights.toml"),
        _sound_placements,
    ),
    Reader(
        "points",
        _points,
        lambda folder: read_points(folder / "points.csv"),
        _sound_points,
    ),
)
