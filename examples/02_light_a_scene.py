"""Light a scene with an asset: two instances share one copy of the data."""

from pathlib import Path

import lumitree  # before mitsuba: it names a working libLLVM

# isort: split
import mitsuba as mi

if not Path("ball.lumitree").exists():
    raise SystemExit("run 01_build_an_asset.py first")

mi.set_variant("llvm_ad_rgb")
lumitree.register()
place = mi.ScalarTransform4f
scene = mi.load_dict(
    {
        "type": "scene",
        "integrator": {"type": "lumitree_path", "max_depth": 6},
        "sensor": {
            "type": "perspective",
            "fov": 40,
            "to_world": place().look_at([0, 2.2, 6], [0, 0.8, 0], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 240, "height": 160},
        },
        "floor": {"type": "rectangle", "to_world": place().rotate([1, 0, 0], -90).scale(5)},
        "left": lumitree.shape("ball.lumitree", place().translate([-1.2, 0.9, 0]).scale(0.7)),
        "right": lumitree.shape("ball.lumitree", place().translate([1.2, 0.6, -1]).scale(0.4)),
    }
)
mi.util.write_bitmap("two_balls.png", mi.render(scene, spp=64), write_async=False)
print("two_balls.png")
