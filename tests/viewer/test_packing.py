"""The page holds all data of an asset."""

import dataclasses
import json
import re

import numpy as np
import pytest

from lumitree.asset.asset import light_field_asset
from lumitree.asset.light_field import unpack
from lumitree.core.frames import LocalFrame
from lumitree.core.photometry import luminance
from lumitree.octree.build import LEAF
from lumitree.viewer.packing import PackedAsset, pack_asset
from lumitree.viewer.view import make_page, notebook_frame
from support.fields import make_asset, random_asset
from support.geometry_assets import small_geometry
from support.light_fields import random_light_field
from support.packed_assets import unpack_asset
from support.reference_field import leaf_boxes


def leaf_at(packed, nodes, point):
    """Index of the leaf at a point, -1 for none, as the shader finds it."""
    description = packed.description["field"]
    below, node = description["tree_depth"], 0
    cell = np.floor((point + 1) / 2 * (1 << below)).astype(int)
    entry = 0
    for bits, start in zip(description["level_bits"], description["level_starts"], strict=True):
        below -= bits
        x, y, z = (cell >> below) & ((1 << bits) - 1)
        entry = int(nodes[start + (node << 3 * bits) + (z << 2 * bits) + (y << bits) + x])
        if entry < 0:
            return -1
        if entry & int(LEAF):
            return (entry & (int(LEAF) - 1)) >> 4
        node = entry
    raise AssertionError("the last level names a node")


@pytest.mark.parametrize("tree_depth", [1, 4, 6])
@pytest.mark.parametrize("l_max", [0, 4])
def test_field_survives_packing(tree_depth, l_max):
    asset = random_asset(3, tree_depth=tree_depth, l_max=l_max)
    packed = pack_asset(asset)
    arrays = unpack_asset(packed)
    lower, upper = leaf_boxes(asset)
    points = np.random.default_rng(1).uniform(-1, 1, (300, 3))
    for point in points:
        inside = np.flatnonzero(((point >= lower) & (point < upper)).all(axis=1))
        expected = inside[0] if len(inside) else -1
        assert leaf_at(packed, arrays["nodes"], point) == expected
    assert np.array_equal(arrays["density"], asset.density)
    assert np.array_equal(arrays["coefficients"], asset.coefficients)


def test_light_field_survives_packing():
    light_field = random_light_field(2)
    asset = dataclasses.replace(random_asset(3), light_field=light_field)
    arrays = unpack_asset(pack_asset(asset))
    assert np.array_equal(arrays["cells"].reshape(-1, 3), light_field.cells)
    assert np.array_equal(arrays["lit"].reshape(light_field.lit.shape), light_field.lit)
    counts = np.bitwise_count(light_field.lit).sum(axis=1, dtype=np.int64)
    found = arrays["intensity"].astype(np.float64) * np.repeat(arrays["cell_scale"], counts)
    expected = luminance(unpack(light_field.intensity) * light_field.scale)
    # Half precision, relative to the largest intensity of a cell.
    largest = np.repeat(arrays["cell_scale"], counts)
    assert (np.abs(found - expected) <= expected * 2**-11 + largest * 2**-24).all()


def test_page_is_self_contained_and_holds_the_asset():
    asset = random_asset(3, luminaire="</script><b>@@STYLE@@ & co")
    page = make_page(asset, exposure=-1.5)
    assert not re.search(r"""(src|href)\s*=\s*["'(]|@import|https?://|url\(""", page)
    assert page.count("</script>") == 3
    assert "<title>&lt;/script&gt;&lt;b&gt;@@STYLE@@ &amp; co - lumitree</title>" in page
    text = re.search(r'id="content">(.*?)</script>', page, re.DOTALL)
    assert text is not None
    description = json.loads(text[1])
    assert (description["luminaire"], description["exposure"]) == (asset.luminaire, -1.5)
    arrays = unpack_asset(PackedAsset(description, description["block"]))
    assert np.array_equal(arrays["density"], asset.density)
    assert '"' not in notebook_frame(page).split('srcdoc="')[1].split('" style')[0]


@pytest.mark.slow
def test_an_asset_without_a_field_is_shown_by_its_light():
    """And says so; it has the irradiance, and what is beside the light stays as it is."""
    field = random_light_field(1)
    asset = light_field_asset(field, LocalFrame(np.ones(3), np.eye(4)), "lamp")
    packed = pack_asset(asset)
    assert packed.description["shown"] == "light field"
    assert packed.description["bytes"] == asset.num_bytes
    arrays = unpack_asset(packed)
    assert len(arrays["density"]) == len(field.cells)
    assert np.array_equal(arrays["cells"].reshape(-1, 3), field.cells)
    geometry = dataclasses.replace(asset, geometry=small_geometry())
    packed = pack_asset(geometry)
    assert packed.description["shown"] == "model"
    assert packed.description["field"] is None
    assert "nodes" not in unpack_asset(packed)
    field = dataclasses.replace(random_asset(3), light_field=asset.light_field)
    assert pack_asset(field).description["shown"] == "field"
    both = pack_asset(dataclasses.replace(field, geometry=small_geometry()))
    assert both.description["shown"] == "model and field"
    assert {"nodes", "triangles", "cells"} <= set(unpack_asset(both))
    assert "Shown: asset.shown" in make_page(asset)


def test_extreme_densities_are_packed():
    asset = make_asset([(0, 0, 0)], [1], [1e15], np.full((1, 3, 1), 65504.0))
    assert unpack_asset(pack_asset(asset))["density"][0] == pytest.approx(1e15, rel=1 / 16)
