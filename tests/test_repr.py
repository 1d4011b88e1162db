"""What Python prints of large objects is a line, however large they are."""

import numpy as np

from lumitree.asset.asset import Asset
from support.fields import random_asset
from support.geometry_assets import small_geometry, with_geometry
from support.lamps import AREA, cube, lamp_of
from support.light_fields import random_light_field


def test_assets_and_their_parts():
    field = random_asset(0, tree_depth=3, l_max=1)
    whole = Asset(
        **{**vars(field), "geometry": small_geometry(), "light_field": random_light_field(0)}
    )
    for asset in (whole, field, with_geometry(small_geometry())):
        text = repr(asset)
        assert text.startswith(f"Asset('{asset.luminaire}': {' + '.join(asset.parts)}, size ")
        assert f"{asset.num_bytes:,} bytes" in text
        assert len(text) < 300
    light = whole.light_field
    size = f"{whole.geometry.num_bytes:,} bytes"
    assert repr(whole.geometry) == (
        f"AssetGeometry(3 shapes, 8 triangles, 3 materials, 2 images, {size})"
    )
    assert repr(light).startswith(f"LightField({len(light.cells):,} cells of ")
    assert len(repr(light)) < 200


def test_luminaires(mi, tmp_path):
    lamp = lamp_of(tmp_path, *(cube(f"c{i}", 0.1, (i, 0, 0), AREA) for i in range(50)))
    assert repr(lamp).startswith(f"Luminaire({lamp.name!r}: 50 shapes, 600 triangles, 50 emitters")
    assert len(repr(lamp)) < 250
    assert np.isfinite(lamp.size).all()
