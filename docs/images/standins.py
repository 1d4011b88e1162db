"""Draw docs/images/standins.jpg: python docs/images/standins.py

The five stand-ins from the front, between two softboxes, and by their own light alone.
"""

from pathlib import Path

import numpy as np
from PIL import Image

from lumitree.core.backend import load_mitsuba
from lumitree.core.images import auto_exposure, tonemap

PICTURE = Path(__file__).parent / "standins.jpg"
STANDINS = ("dallas", "portica", "cluster", "neoclassical", "star")
WIDTH, HEIGHT, GAP = 256, 320, 4
LIT_SAMPLES, OWN_SAMPLES = 96, 256
FIELD = 24  # degrees, of the picture's height


def photograph(name: str, lit: bool) -> np.ndarray:
    """Bytes [H, W, 3] of a lamp: with lights around it, or by its own."""
    mi = load_mitsuba()
    from lumitree.lamp.luminaire import load_luminaire
    from lumitree.rendering.scene import place_shapes

    luminaire = load_luminaire(name)
    size = luminaire.size
    # The wider side of the lamp fills the picture but for a tenth.
    height = 1.1 * max(size[1], size[0] * HEIGHT / WIDTH)
    distance = height / 2 / np.tan(np.radians(FIELD / 2)) + size[2] / 2
    centre = luminaire.frame.centre
    look = mi.ScalarTransform4f().look_at
    eye = centre + distance * np.array([0.0, -0.12, 0.993])
    scene = {
        "type": "scene",
        "integrator": {"type": "volpathmis" if luminaire.has_media else "path", "max_depth": 32},
        "sensor": {
            "type": "perspective",
            "fov": FIELD,
            "fov_axis": "y",
            "to_world": look(origin=eye.tolist(), target=centre.tolist(), up=[0, 1, 0]),
            "film": {"type": "hdrfilm", "width": WIDTH, "height": HEIGHT, "pixel_format": "rgb"},
            "sampler": {"type": "independent"},
        },
        **place_shapes(name, np.eye(4)),
    }
    if lit:
        scene["around"] = {"type": "constant", "radiance": 0.25}
        for side in (-1, 1):
            place = centre + height * np.array([1.4 * side, 0.7, 1.2])
            scene[f"softbox{side}"] = {
                "type": "rectangle",
                "to_world": look(origin=place.tolist(), target=centre.tolist(), up=[0, 1, 0])
                @ mi.ScalarTransform4f().scale([0.7 * float(height)] * 3),
                "emitter": {"type": "area", "radiance": 3.0},
            }
    image = np.array(mi.render(mi.load_dict(scene), spp=LIT_SAMPLES if lit else OWN_SAMPLES))
    if lit:
        return tonemap(np.minimum(image, 1.0))
    return tonemap(image, 2 * auto_exposure(image))


def main() -> None:
    columns = []
    for name in STANDINS:
        columns.append([photograph(name, lit) for lit in (True, False)])
        print(f"drawn {name}")
    sheet = Image.new("RGB", (len(columns) * (WIDTH + GAP) - GAP, 2 * HEIGHT + GAP), "white")
    for column, pictures in enumerate(columns):
        for row, picture in enumerate(pictures):
            sheet.paste(Image.fromarray(picture), (column * (WIDTH + GAP), row * (HEIGHT + GAP)))
    sheet.save(PICTURE, quality=86, optimize=True)


if __name__ == "__main__":
    main()
