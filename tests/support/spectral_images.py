"""Mean colours of images of lamps in a grey room, in any variant of Mitsuba.

`python spectral_images.py VARIANT FOLDER SAMPLES LAMP...` prints the colours of a variant, in a
process of its own, because a process has one variant.
"""

import json
import sys
from pathlib import Path

import numpy as np
from PIL import Image

SIZE = (24, 18)
COLOURED = '<emitter type="area"><rgb name="radiance" value="9,3,1"/></emitter>'
BLACKBODY = (
    '<emitter type="area"><spectrum type="blackbody" name="radiance">'
    '<float name="temperature" value="2000"/></spectrum></emitter>'
)


def room(mi):
    """A box, a ball of fog and a camera in it."""
    to_world = mi.ScalarTransform4f
    film = {"type": "hdrfilm", "width": SIZE[0], "height": SIZE[1], "rfilter": {"type": "box"}}
    look = to_world().look_at([0, 0, 3.5], [0, 0, 0], [0, 1, 0])
    grey = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.5}}
    extinction = {"type": "rgb", "value": [0.2, 0.5, 0.9]}
    fog = {"type": "homogeneous", "albedo": 0.8, "sigma_t": extinction}
    walls = to_world().scale([2.5, 2, 4]).rotate([0, 1, 0], 1)
    return {
        "type": "scene",
        "integrator": {"type": "lumitree_path", "max_depth": 4},
        "sensor": {"type": "perspective", "fov": 70, "to_world": look, "film": film},
        "fog": {
            "type": "sphere",
            "radius": 0.6,
            "center": [1.2, -0.5, 1.2],
            "bsdf": {"type": "null"},
            "interior": fog,
        },
        "room": {"type": "cube", "flip_normals": True, "to_world": walls, "bsdf": grey},
    }


def write_lamps(folder, baked):
    """Write assets and scenes into a folder, with an RGB variant; bake the lamps that are named.

    "baked": a coloured ball in glass, with its geometry; "textured": a square that emits an image,
    likewise; "spectrum": a light field of all colours, and a spectrum; "field": a field alone;
    "blackbody": an explicit lamp.
    """
    from dataclasses import replace

    import lumitree
    from lumitree.asset.asset import EmittedSpectrum, light_field_asset
    from lumitree.core.photometry import sampled_spectrum
    from support.fields import random_asset
    from support.lamps import GLASS, scene, sphere
    from support.light_fields import random_light_field
    from support.tiny_bakes import LIGHT_FIELD

    # Two broad peaks.
    spectrum = EmittedSpectrum.of(sampled_spectrum([400, 450, 500, 600, 700], [0, 3, 1, 3, 0.0]))
    field = random_asset(0, tree_depth=3)
    light = light_field_asset(random_light_field(0), field.frame, "light")
    lumitree.save(replace(light, spectrum=spectrum), folder / "spectrum.lumitree")
    lumitree.save(field, folder / "field.lumitree")
    emitters = {"baked": COLOURED, "blackbody": BLACKBODY}
    for name, emitter in emitters.items():
        shapes = (sphere("ball", 0.3, inside=emitter), sphere("glass", 0.5, inside=GLASS))
        (folder / f"{name}.xml").write_text(scene(*shapes[: 1 + (name == "baked")]))
    pixels = np.random.default_rng(0).integers(0, 256, (8, 8, 3), np.uint8)
    Image.fromarray(pixels).save(folder / "pattern.png")
    pattern = '<texture type="bitmap" name="radiance"><string name="filename" value="pattern.png"/>'
    emitter = f'<emitter type="area">{pattern}</texture></emitter>'
    (folder / "textured.xml").write_text(scene(f'<shape type="rectangle">{emitter}</shape>'))
    config = lumitree.BakeConfig(irradiance_paths=0, light=LIGHT_FIELD)
    for name in baked:
        lumitree.bake(folder / f"{name}.xml", folder / f"{name}.lumitree", config)


def mean_colours(folder, variant, samples, lamps):
    """Mean R, G and B [2, 3] of the upper and the lower half of the image of each lamp."""
    import lumitree
    from lumitree.core.backend import load_mitsuba

    mi = load_mitsuba(variant)
    lumitree.register()
    found = {}
    for name in lamps:
        path = folder / f"{name}.lumitree"
        lamp = path if path.exists() else folder / f"{name}.xml"
        placement = lumitree.Placement(lamp, at=(0, 0, 0), size=1.0)
        image = lumitree.render(room(mi), [placement], spp=samples, progress=None)
        found[name] = image.pixels.reshape(2, -1, 3).mean(axis=1, dtype=np.float64).tolist()
    return found


if __name__ == "__main__":
    variant, folder, samples, *names = sys.argv[1:]
    print(json.dumps(mean_colours(Path(folder), variant, int(samples), names)))
