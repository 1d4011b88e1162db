"""Views of an asset that has geometry and no field."""

import pytest

import lumitree
from lumitree.lamp.luminaire import load_luminaire
from lumitree.measure.evaluate import evaluate_views
from lumitree.trace.cameras import capture
from support.lamps import AREA, scene, sphere
from support.tiny_bakes import bake_config


@pytest.mark.slow
def test_geometry_is_compared_where_there_is_no_field(mi, tmp_path):
    path = tmp_path / "lamp.xml"
    path.write_text(scene(sphere("ball", 0.5, inside=AREA), sphere("other", 0.2, (0.9, 0, 0))))
    lamp = load_luminaire(path)
    views = capture(lamp, tmp_path / "views", views=2, resolution=32, spp=64)
    parts = {"both": ("light", "geometry"), "light": ("light",)}
    assets = {
        name: lumitree.bake(lamp, config=bake_config(parts=each)).asset
        for name, each in parts.items()
    }
    found = {name: evaluate_views(asset, views).metrics for name, asset in assets.items()}
    # Silhouettes are anti-aliased by random samples.
    assert found["both"]["opacity_rmse"] < 0.03 < found["light"]["opacity_rmse"]
    assert found["both"]["psnr_linear"] > 30
    assert found["both"]["psnr_linear"] > found["light"]["psnr_linear"] + 5
