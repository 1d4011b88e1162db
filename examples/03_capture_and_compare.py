"""Capture views of a Mitsuba luminaire and compare an asset with them."""

from pathlib import Path

import lumitree

LUMINAIRE = """
<scene version="3.0.0">
  <shape type="sphere">
    <float name="radius" value="0.4"/>
    <emitter type="area"><rgb name="radiance" value="7.9, 6.7, 4"/></emitter>
  </shape>
  <shape type="sphere"><bsdf type="thindielectric"/></shape>
</scene>
"""

if not Path("ball.lumitree").exists():
    raise SystemExit("run 01_build_an_asset.py first")

Path("lamp.xml").write_text(LUMINAIRE)
lumitree.capture("lamp.xml", "views", views=3, resolution=64, spp=64, split="test")
result = lumitree.evaluate("ball.lumitree", "views", "comparison.png")
for name, value in result.metrics.items():
    print(f"{name:>20}  {value:.3f}")
