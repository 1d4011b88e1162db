"""Whatever is damaged in a glTF file, nothing but LumitreeError escapes."""

import copy
import json

import numpy as np

from lumitree.lamp.importers.gltf import read_gltf
from support.damage import refused
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


def inner(value, place):
    for key in place:
        value = value[key]
    return value
