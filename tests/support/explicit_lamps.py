"""Images of baked lamps beside images of the explicit ones."""

import dataclasses
import functools

import numpy as np

from support import tiny_bakes
from support.lamps import scene

BLACK = '<bsdf type="diffuse"><rgb name="reflectance" value="0,0,0"/></bsdf>'


def baked(folder, *shapes, paths=1 << 20):
    """The luminaire of some shapes, and its asset with geometry."""
    return baked_scene(folder, scene(*shapes), paths, depth=5)


def baked_once(folder, paths):
    """A function: the luminaire of a scene's text, and its asset with geometry; made once."""

    @functools.cache
    def made(text):
        return baked_scene(folder / f"lamp{len(list(folder.iterdir()))}", text, paths, depth=3)

    return made


def baked_scene(folder, text, paths, depth):
    """As `baked`, of the text of a scene, with a light field of this depth."""
    from lumitree.asset.asset import light_field_asset
    from lumitree.fit.light_field.bake import bake_light_field
    from lumitree.lamp.luminaire import load_luminaire
    from lumitree.lamp.stored_geometry import stored_geometry

    folder.mkdir(exist_ok=True)
    (folder / "lamp.xml").write_text(text)
    lamp = load_luminaire(folder / "lamp.xml")
    config = dataclasses.replace(
        tiny_bakes.LIGHT_FIELD, paths=paths, batch=min(paths, 1 << 20), depth=depth
    )
    asset = light_field_asset(
        bake_light_field(lamp, config, folder / "state"), lamp.frame, lamp.name
    )
    return lamp, dataclasses.replace(asset, geometry=stored_geometry(lamp))


def camera(mi, origin, target, fov):
    film = {"type": "hdrfilm", "width": 24, "height": 24, "rfilter": {"type": "box"}}
    look = mi.ScalarTransform4f().look_at(origin, target, [0, 1, 0])
    return {"type": "perspective", "fov": fov, "to_world": look, "film": film, "near_clip": 1e-4}


def blocks(mi, things, sensor, *, spp, passes=16, path_depth=6, integrator="lumitree_path"):
    """Mean radiance of blocks of 6 by 6 pixels, and its standard error."""
    scene = mi.load_dict({"type": "scene", "sensor": sensor, **things})
    method = mi.load_dict({"type": integrator, "max_depth": path_depth})
    images = [
        np.array(mi.render(scene, integrator=method, spp=spp, seed=i))[..., :3].mean(axis=-1)
        for i in range(passes)
    ]
    means = np.reshape(images, (passes, 4, 6, 4, 6)).mean(axis=(2, 4))
    return means.mean(axis=0), means.std(axis=0, ddof=1) / passes**0.5


def assert_alike(first, second, rel):
    """Blocks agree within a part of their brightness, which the errors allow to tell."""
    (a, error_a), (b, error_b) = first, second
    error = np.hypot(error_a, error_b)
    scale = np.maximum(b, 0.1 * b.max())
    assert np.median(error / scale) < rel / 2
    assert (np.abs(a - b) < rel * scale + 4 * error).all()
