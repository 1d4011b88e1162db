"""Draws pictures of what `render` and `photometry` make; all, or the ones that are named.

    python docs/images/photographs.py [NAME ...] --rooms FOLDER --data FOLDER [--work FOLDER]

`photographs` shows six scenes as clipped sRGB by hand, and as photographs of lumitree. Rooms are as
in the benchmark `finished`, with a night sky; there is a desk and an office, too. "Before" is the
log-average of all light at 15 % of white, clipped, without white balance. `photometric-reports`
needs Chromium.
"""

import argparse
import re
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT)]

import lumitree  # noqa: E402
from benchmarks.finished import EYES, Eye  # noqa: E402
from lumitree.core.backend import load_rgb  # noqa: E402
from lumitree.core.images import block_means  # noqa: E402
from lumitree.rendering.drawing import Tile, image_grid  # noqa: E402
from lumitree.rendering.photograph import Highlights, PhotoSettings, ev_of_white  # noqa: E402

FOLDER = Path(__file__).parent
WIDTH, HEIGHT, SHOWN = 560, 315, 400
PENDANT = Eye((3.9, 4.4, 2.9), (-1.2, 4.85, -1.4), 85.0)
CHANDELIER = Eye((2.6, 1.75, -0.9), (1.0, 2.3, -1.75), 45.0)
Placed = tuple[str, list[lumitree.Placement]]

DESK = """<scene version="3.0.0">
<integrator type="path"><integer name="max_depth" value="24"/></integrator>
<sensor type="perspective"></sensor>
<bsdf type="roughplastic" id="wood">
  <float name="alpha" value="0.2"/><rgb name="diffuse_reflectance" value="0.35, 0.2, 0.1"/>
</bsdf>
<bsdf type="twosided" id="paint">
  <bsdf type="diffuse"><rgb name="reflectance" value="0.6, 0.6, 0.6"/></bsdf>
</bsdf>
<bsdf type="diffuse" id="cloth"><rgb name="reflectance" value="0.08, 0.16, 0.4"/></bsdf>
<bsdf type="diffuse" id="paper"><rgb name="reflectance" value="0.8, 0.8, 0.75"/></bsdf>
<bsdf type="plastic" id="juice"><rgb name="diffuse_reflectance" value="0.7, 0.25, 0.03"/></bsdf>
<shape type="rectangle"><ref id="wood"/><transform name="to_world">
  <rotate x="1" angle="-90"/><scale value="16"/><translate y="-0.15" z="3"/>
</transform></shape>
<shape type="rectangle"><ref id="paint"/><transform name="to_world">
  <scale value="20"/><rotate y="1" angle="180"/><translate y="6" z="11"/>
</transform></shape>
<shape type="cube"><ref id="cloth"/><transform name="to_world">
  <scale x="1.5" y="0.03" z="1.1"/><rotate y="1" angle="25"/><translate x="4.6" y="0.33" z="0.2"/>
</transform></shape>
<shape type="cube"><ref id="cloth"/><transform name="to_world">
  <scale x="1.5" y="0.03" z="1.1"/><rotate y="1" angle="25"/><translate x="4.6" y="-0.11" z="0.2"/>
</transform></shape>
<shape type="cube"><ref id="paper"/><transform name="to_world">
  <scale x="1.4" y="0.2" z="1.02"/><rotate y="1" angle="25"/><translate x="4.6" y="0.11" z="0.2"/>
</transform></shape>
<shape type="cylinder"><bsdf type="thindielectric"/><point name="p0" x="1.9" y="-0.14" z="1.0"/>
  <point name="p1" x="1.9" y="1.5" z="1.0"/><float name="radius" value="0.5"/></shape>
<shape type="cylinder"><ref id="juice"/><point name="p0" x="1.9" y="-0.14" z="1.0"/>
  <point name="p1" x="1.9" y="0.9" z="1.0"/><float name="radius" value="0.46"/></shape>
<shape type="disk"><ref id="juice"/><transform name="to_world">
  <rotate x="1" angle="-90"/><scale value="0.46"/><translate x="1.9" y="0.9" z="1.0"/>
</transform></shape>
</scene>"""
# A panel of 0.6 m x 0.6 m and 3,600 lm, which emits like a diffuse surface.
PANEL = "IESNA:LM-63-2002\n[TEST] a panel\n[MANUFAC] none\nTILT=NONE\n1 -1 1 10 1 1 2 0.6 0.6 0\n"
PANEL += "1 1 36\n0 10 20 30 40 50 60 70 80 90\n0\n"
PANEL += " ".join(f"{3600 / np.pi * np.cos(np.radians(angle)):.2f}" for angle in range(0, 91, 10))
# Dusk behind windows, W/(m² sr), where rooms of the data set have nothing.
SKY = '<emitter type="constant"><rgb name="radiance" value="0.0001, 0.00025, 0.0006"/></emitter>'
# CPU time of each image of `denoised`.
CPU_SECONDS = 30


class Scenes:
    """The scenes, by name; files that they need are in the folder `work`."""

    def __init__(self, rooms: Path, data: Path, work: Path) -> None:
        self._rooms, self._data, self._work = rooms, data, work

    def living(self) -> Placed:
        """A lantern under the ceiling of a living room"""
        lamp = lumitree.Placement(self.lamp("portica"), at=(1, 2.45, -1.75), size=0.85, lumens=1500)
        return self._room("living_room", EYES["living_room"]), [lamp]

    def hall(self) -> Placed:
        """A chandelier and a standing globe in a hall"""
        chandelier = self.lamp("megeon_chandelier/luminaire_bulb.xml")
        return self._room("modern_hall", EYES["modern_hall"]), [
            lumitree.Placement(chandelier, at=(-2.4, 4.85, 1.5), size=1.5, lumens=4000),
            lumitree.Placement(self.lamp("arc"), at=(-0.5, 0.8, 1.6), size=1.6, lumens=800),
        ]

    def veach(self) -> Placed:
        """A pendant lamp over a table"""
        lamp = lumitree.Placement(self.lamp("dallas"), at=(0, 6.78, -1), size=2.4)
        return self._room("veach_bidir", PENDANT), [lamp]

    def desk(self) -> Placed:
        """A desk lamp, a book and a glass"""
        lamp = self.lamp("little_lamp/luminaire.xml")
        eye = Eye((10.5, 8, -13), (3.2, 1.7, 1.8), 43.0)
        return self._seen(DESK, self._work / "desk.xml", eye), [lumitree.Placement(lamp)]

    def chandelier(self) -> Placed:
        """A chandelier of glass, close up"""
        chandelier = self.lamp("scopia_chandelier/luminaire.xml")
        lamp = lumitree.Placement(chandelier, at=(1, 2.35, -1.75), size=1.05, lumens=3000)
        return self._room("living_room", CHANDELIER), [lamp]

    def office(self) -> Placed:
        """An office with two panels, of a photometric file"""
        file = self._work / "panel.ies"
        file.write_text(PANEL)
        text = (ROOT / "examples/office.xml").read_text()
        eye = Eye((1.9, 1.4, 1.4), (-0.6, 1.6, -0.7), 88.0)
        panels = [lumitree.Placement(str(file), at=(x, 2.69, -0.2)) for x in (-1.3, -0.1)]
        return self._seen(text, self._work / "office.xml", eye), panels

    def lamp(self, source: str) -> str:
        asset = self._work / f"{source.partition('/')[0]}.lumitree"
        if not asset.exists():
            lamp = self._data / source if "/" in source else source
            lumitree.bake(lamp, asset, parts=("light", "geometry"))
        return str(asset)

    def _room(self, name: str, eye: Eye) -> str:
        folder = self._work / name
        folder.mkdir(exist_ok=True)
        for each in (self._rooms / name).iterdir():
            if not (folder / each.name).exists():
                (folder / each.name).symlink_to(each.resolve())
        text = (self._rooms / name / "room_night.xml").read_text()
        text = text.replace("</scene>", f"{SKY}</scene>")
        return self._seen(text, folder / f"seen-{eye.fov:.0f}.xml", eye)

    def _seen(self, text: str, path: Path, eye: Eye) -> str:
        """A scene of another camera, as a file."""
        origin, target = (", ".join(map(str, each)) for each in (eye.eye, eye.target))
        sensor = (
            f'<sensor type="perspective"><float name="fov" value="{eye.fov}"/><transform '
            f'name="to_world"><lookat origin="{origin}" target="{target}" up="0,1,0"/></transform>'
            f'<film type="hdrfilm"><integer name="width" value="{WIDTH}"/><integer name="height" '
            f'value="{HEIGHT}"/><rfilter type="box"/></film></sensor>'
        )
        path.write_text(re.sub(r"<sensor.*?</sensor>", sensor, text, count=1, flags=re.S))
        return str(path)


def before(radiance: NDArray[np.float32]) -> NDArray[np.uint8]:
    """The image, clipped, by the log-average of all light."""
    means = block_means(radiance.mean(axis=-1, dtype=np.float64), 8)
    ev = ev_of_white(float(np.exp(np.log(means[means > 0]).mean())) / 0.15)
    plain = PhotoSettings(exposure=f"ev={ev}", white_balance="off", view="srgb", bloom=0)
    return plain.photograph(radiance).pixels


def photographs(scenes: Scenes, options: argparse.Namespace) -> Image.Image:
    """Six scenes, before and after."""
    makers: list[Callable[[], Placed]] = [
        scenes.living, scenes.hall, scenes.veach, scenes.desk, scenes.chandelier, scenes.office
    ]  # fmt: skip
    tiles = []
    for make in makers:
        kept = options.work / f"{make.__name__}.npz"
        if not kept.exists():
            scene, lamps = make()
            image = lumitree.render(scene, lamps, spp=options.spp, denoise=True)
            assert image.highlights is not None
            found = {"pixels": image.pixels, "albedo": image.albedo, **vars(image.highlights)}
            np.savez(kept, **found)
        found = dict(np.load(kept))
        highlights = Highlights(found["seen"], found["square"])
        shown = PhotoSettings().photograph(
            found["pixels"], albedo=found["albedo"], highlights=highlights
        )
        tiles += [Tile(before(found["pixels"]), make.__doc__ or ""), Tile(shown.pixels)]
    rows = [tiles[at : at + 4] for at in range(0, len(tiles), 4)]
    sheet = options.work / "sheet.png"
    sheet.write_bytes(image_grid(rows, SHOWN, columns=["before", "photograph"] * 2).png())
    return Image.open(sheet)


def denoised(scenes: Scenes, options: argparse.Namespace) -> Image.Image:
    """The demonstration with the explicit and the baked lamp, and both denoised."""
    sheet, settings = Image.new("RGB", (960, 720)), PhotoSettings()
    metered = albedo = None
    asset = scenes.lamp("bulbs")
    load_rgb()
    from lumitree.rendering.demo_room import demo_room
    from lumitree.rendering.demo_room import lamp as demo_lamp

    for column, source in enumerate(("bulbs", asset)):
        room, lamps = demo_room(480), [demo_lamp(source)]
        # Kernels are compiled first.
        lumitree.render(room, lamps, spp=4)
        begin = time.process_time()
        lumitree.render(room, lamps, spp=16)
        spp = max(1, round(16 * CPU_SECONDS / (time.process_time() - begin)))
        image = lumitree.render(room, lamps, spp=spp, denoise=True, aov=True)
        print(f"{source}: {spp} samples per pixel")
        assert image.noisy is not None
        # One exposure and white balance for all four.
        if metered is None:
            metered, albedo = image.pixels, image.albedo
        for row, pixels in enumerate((image.noisy, image.pixels)):
            shown = settings.photograph(
                pixels, metered=metered, albedo=albedo, highlights=image.highlights
            )
            sheet.paste(Image.fromarray(shown.pixels), (480 * column, 360 * row))
    return sheet


def photometric_reports(scenes: Scenes, options: argparse.Namespace) -> Image.Image:
    """Reports of two lamps, as a browser shows them, without the tables of the far field."""
    sheet = Image.new("RGB", (1440, 842), "white")
    for column, lamp in enumerate(("dallas", options.data / "scopia_chandelier/luminaire.xml")):
        report, shot = (options.work / f"report-{column}.{kind}" for kind in ("html", "png"))
        if not report.exists():
            unit = "cm" if column else "m"
            lumitree.photometry(lamp, [report], unit=unit, seed=1)
        flags = ["--headless", "--no-sandbox", "--hide-scrollbars", "--window-size=1000,1170"]
        page = report.resolve().as_uri()
        subprocess.run(["chromium", *flags, f"--screenshot={shot}", page], check=True)
        sheet.paste(Image.open(shot).convert("RGB").resize((720, 842)), (720 * column, 0))
    return sheet


def ies_light(scenes: Scenes, options: argparse.Namespace) -> Image.Image:
    """A room lit by an IES file with three lobes."""
    c, gamma = np.radians(np.arange(0, 361, 5)), np.radians(np.arange(0, 181, 2.5))
    flat = np.sin(gamma)
    rays = np.stack(np.broadcast_arrays(
        flat * np.cos(c)[:, None], -np.cos(gamma), -flat * np.sin(c)[:, None]
    ), axis=-1)  # fmt: skip
    lobes = np.array([[0.8, -0.6, 0], [-0.6, -0.8, 0], [0, 0.8, -0.6]])
    candela = 1500 * np.exp(40 * (rays @ lobes.T - 1)).sum(axis=-1)
    rows = (np.degrees(gamma), np.degrees(c), *candela)
    head = f"IESNA:LM-63-2002\n[TEST] lobes\n[MANUFAC] none\nTILT=NONE\n1 -1 1 {len(gamma)} "
    head += f"{len(c)} 1 2 0 0 0\n1 1 36\n"
    file = options.work / "lobes.ies"
    file.write_text(head + "".join(" ".join(f"{x:.4g}" for x in row) + "\n" for row in rows))
    box = load_rgb().cornell_box()
    del box["light"]
    box["sensor"]["film"] |= {"width": 480, "height": 480}
    lamp = lumitree.Placement(str(file), at=(0, 0.3, 0))
    picture = options.work / "lobes.png"
    lumitree.render(box, [lamp], spp=128, denoise=True).save(picture)
    return Image.open(picture)


def lux_plan(scenes: Scenes, options: argparse.Namespace) -> Image.Image:
    """The commands of the page on lux plans."""
    office = ROOT / "examples/office.xml"
    lamp = lumitree.Placement(scenes.lamp("dallas"), at=(0, 2.3, -0.3), size=0.4, lumens=3000)
    planes = [
        lumitree.Plane((0, 0.75, 0), (0, 1, 0), extent=(4, 3), spacing=0.25, name="work plane"),
        lumitree.Plane((0, 0.745, -1.05), (0, 1, 0), extent=(1.6, 0.8), spacing=0.1, name="desk"),
    ]
    files = [options.work / f"{name}.png" for name in ("view", "luminance", "plan")]
    image = lumitree.render(office, [lamp], spp=options.spp, denoise=True)
    image.save(files[0])
    image.save_luminance(files[1])
    lumitree.illuminance(office, [lamp], planes=planes).save(files[2])
    view, luminance, plan = (Image.open(file).convert("RGB") for file in files)
    sheet = Image.new("RGB", (1500, 1059), "white")
    plan = plan.resize((plan.width * 1059 // plan.height, 1059), Image.Resampling.LANCZOS)
    width = 1490 - plan.width
    for top, each in ((0, view), (width * 3 // 4 + 10, luminance)):
        each.thumbnail((width, 1059 - top), Image.Resampling.LANCZOS)
        sheet.paste(each, (0, top))
    sheet.paste(plan, (width + 10, 0))
    return sheet


PICTURES = {
    "photographs": 85,
    "denoised": 80,
    "photometric-reports": 85,
    "ies-light": 88,
    "lux-plan": 85,
}


def main(options: argparse.Namespace) -> None:
    options.work.mkdir(parents=True, exist_ok=True)
    scenes = Scenes(options.rooms, options.data, options.work)
    for name in options.names or PICTURES:
        image = globals()[name.replace("-", "_")](scenes, options)
        quality, path = PICTURES[name], FOLDER / f"{name}.jpg"
        image.convert("RGB").save(path, "JPEG", quality=quality, optimize=True)
        print(f"{path.name}: {path.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Draw pictures of the documentation.")
    parser.add_argument("names", nargs="*", choices=[[], *PICTURES])
    parser.add_argument("--rooms", type=Path, required=True)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--work", type=Path, default=Path("photographs-work"))
    parser.add_argument("--spp", type=int, default=64)
    main(parser.parse_args())
