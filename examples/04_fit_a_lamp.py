"""Find the place, the tilt and the dim level of a desk lamp from an image of the lit desk."""

from pathlib import Path

import lumitree  # before mitsuba: it names a working libLLVM

# isort: split
import drjit as dr
import matplotlib.pyplot as plt
import mitsuba as mi

LAMP = """<scene version="3.0.0">
  <shape type="cylinder"> <float name="radius" value="0.08"/>
    <point name="p0" value="0, -0.05, 0"/> <point name="p1" value="0, 0.1, 0"/>
    <bsdf type="twosided"><bsdf type="diffuse"/></bsdf> </shape>
  <shape type="sphere"> <float name="radius" value="0.035"/>
    <emitter type="area"><rgb name="radiance" value="400, 340, 260"/></emitter> </shape>
</scene>"""
Path("desk_lamp.xml").write_text(LAMP)
lumitree.bake("desk_lamp.xml", "desk_lamp.lumitree", quality="preview")

mi.set_variant("llvm_ad_rgb")
place = mi.ScalarTransform4f
camera = place().look_at([0, 1.1, 1.1], [0, 0, 0], [0, 1, 0])
film = {"type": "hdrfilm", "width": 96, "height": 64, "rfilter": {"type": "box"}}
book = place().translate([0.35, 0, 0.2]).scale([0.1, 0.03, 0.14])
scene = mi.load_dict(
    {
        "type": "scene",
        "integrator": {"type": "lumitree_path", "max_depth": 4},
        "sensor": {"type": "perspective", "fov": 45, "to_world": camera, "film": film},
        "desk": {"type": "rectangle", "to_world": place().rotate([1, 0, 0], -90)},
        "book": {"type": "cube", "to_world": book},
        "lamp": lumitree.shape("desk_lamp.lumitree"),
    }
)
parameters = mi.traverse(scene)


def render(x, z, tilt, level, **options):
    pose = mi.Transform4f().translate(mi.Vector3f(x, 0.6, z)).rotate([0, 0, 1], 60 * tilt)
    parameters["lamp.emitter.to_world"], parameters["lamp.emitter.gain"] = pose, mi.Color3f(level)
    parameters.update()
    return mi.render(scene, parameters, **options)


truth = {"x": 0.2, "z": -0.15, "tilt": 0.3, "level": 1.5}
target = render(**truth, spp=512)
start = {"x": -0.1, "z": 0.1, "tilt": 0.0, "level": 1.0}
found = mi.ad.Adam(lr=0.03, params={name: mi.Float(value) for name, value in start.items()})
differences = []
for step in range(80):
    image = render(**dict(found), spp=16, seed=step)
    dr.backward(dr.mean(dr.square(image - target), axis=None))
    found.step()
    differences.append([float(found[name][0] - truth[name]) for name in truth])
plt.figure(figsize=(5, 3), layout="constrained")
plt.plot(differences, label=list(truth))
plt.xlabel("step"), plt.ylabel("found - true"), plt.grid(), plt.legend()
plt.savefig("desk_lamp_fit.png")
mi.util.write_bitmap("desk.png", target, write_async=False)
print({name: round(float(found[name][0]), 3) for name in truth})
