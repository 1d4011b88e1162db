"""Makes `docs/_static/dimmers.html`, a page of `lumitree mix`, and `dimmers.jpg`, two views of it.

    python docs/images/dimmers.py --rooms FOLDER --data FOLDER [--work FOLDER] [--spp N]

A living room with three lamps at night; its daylight is a fourth layer. The views need Chromium.
"""

import argparse
import re
import shutil
import subprocess
from pathlib import Path

from PIL import Image

import lumitree

DOCS = Path(__file__).parents[1]
PAGE, PICTURE = DOCS / "_static" / "dimmers.html", Path(__file__).parent / "dimmers.jpg"
OVERRIDES = DOCS.parent / "examples" / "overrides" / "stained_glass_lamp.toml"
SENSOR = """<sensor type="perspective"><float name="fov" value="75"/>
<transform name="to_world"><lookat origin="4.6, 1.6, -0.6" target="1.2, 1.35, -2.1" up="0, 1, 0"/>
</transform><film type="hdrfilm"><integer name="width" value="800"/>
<integer name="height" value="450"/><rfilter type="box"/></film></sensor>"""
LIGHTS = """[lamps.chandelier]
asset = "chandelier.lumitree"
at = [1.0, 2.35, -1.75]
size = 1.05
lumens = 2000
temperature = 2700

[lamps.table_lamp]
asset = "table_lamp.lumitree"
at = [2.72, 0.84, -1.6]
size = 0.42
lumens = 450
temperature = 2400

[lamps.floor_lamp]
asset = "floor_lamp.lumitree"
at = [0.45, 0.98, -2.95]
size = 1.95
lumens = 900
temperature = 3000
"""
# The evening with which the page begins; and width and height of the views.
EVENING = {"gain": {"room": 0.003}, "exposure": 3.5, "white_balance": 3800}
VIEWS = ((1280, 640), (390, 760))


def layers(options: argparse.Namespace) -> Path:
    """The image with layers, which is rendered if it is not there."""
    image = options.work / "living_room.exr"
    if image.exists():
        return image
    glass = lumitree.LuminaireSource(
        str(options.data / "stained_glass_lamp/StainedGlassLamp.gltf"), str(OVERRIDES)
    )
    sources = {
        "chandelier": str(options.data / "scopia_chandelier/luminaire.xml"),
        "table_lamp": glass,
        "floor_lamp": "arc",
    }
    for name, source in sources.items():
        if not (asset := options.work / f"{name}.lumitree").exists():
            lumitree.bake(source, asset, parts=("light", "geometry"))
    for folder in ("meshes", "textures"):
        shutil.copytree(
            options.rooms / "living_room" / folder, options.work / folder, dirs_exist_ok=True
        )
    text = (options.rooms / "living_room" / "room.xml").read_text("utf-8")
    scene, lights = options.work / "room.xml", options.work / "lights.toml"
    scene.write_text(re.sub(r"<sensor.*?</sensor>", SENSOR, text, count=1, flags=re.S), "utf-8")
    lights.write_text(LIGHTS, "utf-8")
    placements = lumitree.read_placements(lights)
    rendered = lumitree.render(scene, placements, spp=options.spp, denoise=True, layers=True)
    rendered.save_layers(image)
    return image


def picture(options: argparse.Namespace) -> None:
    """The page as a desktop and as a phone show it, side by side."""
    flags = ["--headless", "--no-sandbox", "--use-angle=swiftshader", "--hide-scrollbars"]
    flags += ["--enable-unsafe-swiftshader", "--virtual-time-budget=60000"]
    images = []
    for width, height in VIEWS:
        shot = options.work / f"{width}.png"
        # Chromium has no narrower windows than 500 pixels, but pages in frames are.
        frame = options.work.resolve() / "frame.html"
        style = f"border:0;width:{width}px;height:{height}px"
        page = f'<iframe src="{PAGE.resolve().as_uri()}" style="{style}"></iframe>'
        frame.write_text(f'<body style="margin:0">{page}', "utf-8")
        size = f"--window-size={max(width, 500)},{height + 100}"
        subprocess.run(
            ["chromium", *flags, size, f"--screenshot={shot}", frame.as_uri()], check=True
        )
        images.append(Image.open(shot).convert("RGB").crop((0, 0, width, height)))
    height = min(image.height for image in images)
    images = [image.resize((image.width * height // image.height, height)) for image in images]
    sheet = Image.new("RGB", (sum(image.width for image in images) + 10, height), "white")
    sheet.paste(images[0], (0, 0))
    sheet.paste(images[1], (images[0].width + 10, 0))
    sheet.save(PICTURE, "JPEG", quality=85)


def main(options: argparse.Namespace) -> None:
    options.work.mkdir(parents=True, exist_ok=True)
    lumitree.mix(layers(options), **EVENING).save(PAGE)
    picture(options)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Make dimmers.html and dimmers.jpg.")
    parser.add_argument("--rooms", type=Path, required=True)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--work", type=Path, default=Path("dimmers-work"))
    parser.add_argument("--spp", type=int, default=64)
    main(parser.parse_args())
