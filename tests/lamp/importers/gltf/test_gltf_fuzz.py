"""Whatever is damaged in a glTF file, nothing but LumitreeError escapes."""

import copy
import json

import numpy as np

from lumitree.lamp.importers.gltf import read_gltf
from support.damage import damaged, refused
from support.gltf_models import rich


def places(value, path=()):
    """Paths of every value in a JSON document."""
    yield path
    if isinstance(value, dict | list):
        for key, entry in value.items() if isinstance(value, dict) else enumerate(value):
            yield from places(entry, (*path, key))


WRONG = (None, -1, 10**30, 1e308, True, "x", "\ud800", "\x1b" * 3000, [], [[]], {}, {"a": 1})


def test_any_wrong_value_is_refused_or_read(tmp_path):
    """Whatever stands anywhere in the JSON."""
    gltf = rich()
    whole = gltf.with_buffer(gltf.uri())
    path = tmp_path / "lamp.gltf"
    generator = np.random.default_rng(5)
    refusals = 0
    for place in places(whole):
        for pick in generator.choice(len(WRONG), 3, replace=False) if place else ():
            model = copy.deepcopy(whole)
            inner(model, place[:-1])[place[-1]] = WRONG[pick]
            path.write_text(json.dumps(model))
            variant = ("v", None)[pick % 2]
            refusals += refused(lambda variant=variant: read_gltf(path, variant=variant))
    assert refusals > 300


def test_flipped_bytes_are_refused_or_read(tmp_path):
    whole = rich().glb()
    path = tmp_path / "lamp.glb"
    generator = np.random.default_rng(2)
    for _ in range(300):
        data = bytearray(whole)
        for at in generator.integers(0, len(whole), 3):
            data[at] = generator.integers(0, 256)
        path.write_bytes(data[: generator.integers(1, 2 * len(whole))])
        refused(lambda: read_gltf(path))


def test_gltf_texts(tmp_path):
    gltf = rich()
    whole = json.dumps(gltf.with_buffer(gltf.uri()), indent=1).encode()
    rng = np.random.default_rng(8)
    path = tmp_path / "lamp.gltf"
    refusals = 0
    for _ in range(200):
        path.write_bytes(damaged(whole, rng))
        refusals += refused(lambda: read_gltf(path))
    assert refusals > 50


def test_gltf_structures(tmp_path):
    """Keys dropped, given twice, and values exchanged for others of the file."""
    whole = rich().with_buffer(rich().uri())
    every = [place for place in places(whole) if place]
    rng = np.random.default_rng(9)
    path = tmp_path / "lamp.gltf"
    refusals = 0
    for _ in range(200):
        model = copy.deepcopy(whole)
        for _ in range(rng.integers(1, 4)):
            place, other = (every[pick] for pick in rng.integers(len(every), size=2))
            try:
                parent, value = inner(model, place[:-1]), copy.deepcopy(inner(model, other))
                if rng.random() < 0.3:
                    del parent[place[-1]]
                else:
                    parent[place[-1]] = value
            except (KeyError, IndexError, TypeError):
                continue
        path.write_text(json.dumps(model))
        refusals += refused(lambda: read_gltf(path))
    assert refusals > 50


def inner(value, place):
    for key in place:
        value = value[key]
    return value
