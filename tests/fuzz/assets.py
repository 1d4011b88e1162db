"""Assets: `.lumitree` files of all kinds of parts, with a checksum that is right."""

import copy
import dataclasses
import functools
import json

import numpy as np

from fuzz import json_trees, words
from fuzz.reader import MEBIBYTE, Reader
from fuzz.values import chance, pick
from lumitree.asset.array_stream import compressed, decompressed
from lumitree.asset.asset import EmittedSpectrum, light_field_asset
from lumitree.asset.field_file import field_layouts
from lumitree.asset.file import load
from lumitree.asset.geometry_file import _layouts as geometry_layouts
from lumitree.asset.light_field import TracedPaths
from lumitree.asset.light_field_file import _counts
from lumitree.asset.light_field_file import _layouts as light_layouts
from lumitree.errors import LumitreeError
from support.asset_drafts import CHANGES, Draft
from support.every_material import every_material
from support.fields import random_asset
from support.geometry_assets import small_geometry, with_geometry
from support.light_fields import random_light_field, with_inside
from support.sound_assets import assert_sound
from support.stored_arrays import (
    change_field_arrays,
    change_geometry_arrays,
    change_light_arrays,
)

_FILE = "lamp.lumitree"
# Words that JSON texts of assets use.
_KEYS = ("light", "spectrum", "inside", "traced", "origin", "nested", "image", "interior", "scale")


@functools.cache
def _drafts():
    """A draft of each kind of asset."""
    plain = random_asset(0, tree_depth=3, l_max=1, half_extents=np.array([1.0, 0.5, 0.25]))
    light = random_light_field(0, traced=TracedPaths(1 << 20, (0, 7), 64 * "a", 0.02))
    spectrum = EmittedSpectrum.of(np.random.default_rng(0).random(471), 0.75)
    inside = with_inside(1, random_light_field(1))
    whole = with_geometry(small_geometry())
    assets = (
        plain,
        random_asset(1, tree_depth=2, l_max=4, law="exponential", light_factors=(0.5, 1.0, 2.0)),
        dataclasses.replace(plain, light_field=light),
        light_field_asset(random_light_field(2, resolution=8), plain.frame, "test", spectrum),
        light_field_asset(inside, plain.frame, "test"),
        whole,
        dataclasses.replace(whole, light_field=inside, spectrum=spectrum),
        with_geometry(every_material()),
    )
    return tuple(map(Draft, assets))


def make(rng):
    """The file of an asset, changed in one to three places, or with its bytes damaged."""
    draft = copy.copy(pick(rng, _drafts()))
    draft.tensors, draft.members = dict(draft.tensors), list(draft.members)
    if chance(rng, 0.05):
        return {_FILE: words.flipped(draft.file(), rng)}
    content = None
    fitting = [change for change, fits in _OWN if fits(draft.asset)]
    for _ in range(pick(rng, (1, 1, 1, 1, 2, 3))):
        if chance(rng, 0.25):
            # These take fresh arrays, which they change in place.
            draft.tensors = {name: each.copy() for name, each in draft.tensors.items()}
            content = _tried(pick(rng, CHANGES), draft, rng)
        else:
            content = _tried(pick(rng, fitting), draft, rng)
    return {_FILE: content}


def _tried(change, draft, rng):
    """The file after a change; what an earlier one has damaged may be beyond a further one."""
    try:
        return change(draft, rng) or draft.file()
    except (LumitreeError, LookupError, TypeError, ValueError, AttributeError, RecursionError):
        return draft.file()


def _change_description(draft, rng):
    """Members of the description at any depth."""
    tree = json_trees.changed(json.loads(draft.description()), rng, keys=_KEYS)
    text = json_trees.written(tree).decode("utf-8", "surrogatepass")
    return draft.file(draft.header(text))


def _change_geometry_text(draft, rng):
    tree = json_trees.changed(json.loads(_geometry_text(draft)), rng, keys=_KEYS)
    _set_geometry_text(draft, json_trees.written(tree))


def _change_field(draft, rng):
    change_field_arrays(draft.tensors, draft.asset, _one_array(rng))


def _change_light(draft, rng):
    change_light_arrays(draft.tensors, draft.asset.light_field, _one_array(rng))


def _change_geometry(draft, rng):
    change_geometry_arrays(draft.tensors, _one_array(rng))


def _resize_field(draft, rng):
    asset = draft.asset
    layouts = field_layouts(len(asset.children), asset.num_leaves, asset.l_max)
    sizes = _resize(draft, rng, "field.stream", layouts)
    counts = {"nodes": sizes["occupied"], "leaves": sizes["density"]}
    _set_member(draft, "field", lambda field: field | counts)


def _resize_light(draft, rng):
    field = draft.asset.light_field
    outer, inner = light_layouts(_counts(field), field.resolution)
    sizes = _resize(draft, rng, "light.stream", outer + inner)
    counts = {"cells": sizes["cells"], "bins": sizes["intensity"], "divided": sizes["bent"]}
    if field.inside is not None:
        names = ("cells", "distances", "reach_curves")
        own = {name: sizes[f"inside.{name}"] for name in names}
        own["entries"] = sizes["inside.intensity"]
        own["divided"] = sizes["inside.bent"]
        _set_member(draft, "light", lambda light: light | {"inside": light["inside"] | own})
    _set_member(draft, "light", lambda light: light | counts)


def _resize_geometry(draft, rng):
    text = json.loads(_geometry_text(draft))
    sizes = _resize(draft, rng, "geometry.stream", geometry_layouts(text["arrays"]))
    _set_geometry_text(draft, json.dumps(text | {"arrays": sizes}).encode())


def _change_stream(draft, rng):
    """The zlib stream itself, cut, longer, or with changed bits."""
    name = pick(rng, [each for each in draft.full if draft.tensors[each].dtype == np.uint8])
    changed = words.flipped(draft.tensors[name].tobytes(), rng)
    draft.tensors[name] = np.frombuffer(changed, np.uint8)


# Changes, and the assets that they are for.
_OWN = (
    (_change_description, lambda _: True),
    (_change_stream, lambda asset: asset.geometry is None),
    *((_change_field, lambda asset: asset.num_leaves > 0),) * 2,
    (_resize_field, lambda asset: asset.num_leaves > 0),
    *((_change_light, lambda asset: asset.light_field is not None),) * 2,
    (_resize_light, lambda asset: asset.light_field is not None),
    *((_change_geometry_text, lambda asset: asset.geometry is not None),) * 3,
    (_change_geometry, lambda asset: asset.geometry is not None),
    (_resize_geometry, lambda asset: asset.geometry is not None),
)


def _one_array(rng):
    def change(arrays):
        name = pick(rng, [name for name, each in arrays.items() if each.size] or list(arrays))
        arrays[name] = words.changed_array(arrays[name], rng)

    return change


def _resize(draft, rng, name, layouts):
    """Change the numbers of rows of arrays of a stream; returns them by name.

    Arrays of one length that belong together often stay of one length.
    """
    arrays = decompressed(draft.tensors[name], layouts, name)
    chosen = pick(rng, [each.name for each in layouts])
    length = len(arrays[chosen])
    new = words.resized(arrays[chosen], rng)
    for key in [key for key, each in arrays.items() if len(each) == length and chance(rng, 0.8)]:
        shape = (len(new), *arrays[key].shape[1:])
        if arrays[key].size:
            arrays[key] = np.resize(arrays[key], shape)
    arrays[chosen] = new
    resized = [each._replace(shape=arrays[each.name].shape) for each in layouts]
    draft.tensors[name] = compressed(arrays, resized)
    return {each.name: each.shape[0] for each in resized}


def _set_member(draft, key, change):
    for index, (name, text) in enumerate(draft.members):
        if name == key:
            draft.members[index] = (key, json.dumps(change(json.loads(text))))


def _geometry_text(draft):
    return draft.tensors["geometry.shapes"].tobytes()


def _set_geometry_text(draft, text):
    draft.tensors["geometry.shapes"] = np.frombuffer(text, np.uint8)


def read(folder):
    """The asset of an input."""
    return load(folder / _FILE)


def use_in_full(asset):
    """Render an asset."""
    # Mitsuba is loaded only for this.
    from fuzz.rendering import assert_renders

    assert_renders(asset)


READERS = (
    Reader(
        "asset",
        make,
        read,
        assert_sound,
        use_in_full,
        memory=3072 * MEBIBYTE,
        in_suite=200,
        full_share=1 / 500,
    ),
)
