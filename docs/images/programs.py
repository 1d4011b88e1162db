"""Draw docs/images/programs.jpg: python docs/images/programs.py ASSET FOLDER

One lamp, exported by `lumitree.export`, in several programs from one camera. FOLDER keeps the image
of each program; those that are there are not rendered again. Needs pyradiance, chromium, npm (or
LUMITREE_NODE_MODULES), and a Python with bpy in LUMITREE_BLENDER_PYTHON. Run it in the root of the
project.
"""

import base64
import json
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

from benchmarks.cycles.room import CyclesJob, mitsuba_walls, render_cycles  # noqa: E402
from benchmarks.other_programs import ies_text  # noqa: E402
from benchmarks.radiance_rooms.program import LUMA, LUMENS_PER_WATT, Radiance  # noqa: E402
from lumitree.core.backend import load_mitsuba  # noqa: E402
from lumitree.core.photometry import LUMENS_PER_WATT as LUMENS  # noqa: E402
from lumitree.core.photometry import luminance  # noqa: E402
from support.browser import evaluate  # noqa: E402
from support.node_packages import node_modules  # noqa: E402

PICTURE = Path(__file__).parent / "programs.jpg"
WIDTH, HEIGHT = 480, 360
BOUNCES = 3


class Scene:
    """A table with a book in front of a wall, and the camera; in sizes of the lamp.

    Args:
        asset: whose box is above the table.
    """

    def __init__(self, asset: Any) -> None:
        self._centre, self._size = asset.frame.centre, float(asset.frame.size.max())
        turned = np.radians(25)
        along = np.array([np.cos(turned), 0, -np.sin(turned)])
        across, up = np.array([np.sin(turned), 0, np.cos(turned)]), np.array([0.0, 1, 0])
        table, red = [0.5, 0.42, 0.34], [0.5, 0.12, 0.08]
        self.walls = {
            "table": self._quad([0, -1.3, 0.2], [3, 0, 0], [0, 0, -1.8], table),
            "wall": self._quad([0, 0.7, -1.6], [3, 0, 0], [0, 2, 0], [0.62, 0.64, 0.62]),
        }
        middle, (long, high, wide) = np.array([0.55, -1.2, -0.1]), (0.42, 0.1, 0.28)
        self.walls["top"] = self._quad(middle + high * up, long * along, -wide * across, red)
        for name, normal, reach, half in (
            ("front", across, wide, long), ("back", -across, wide, long),
            ("right", along, long, wide), ("left", -along, long, wide),
        ):  # fmt: skip
            side = half * np.cross(up, normal)
            self.walls[name] = self._quad(middle + reach * normal, side, high * up, red)
        self.camera = {
            "origin": self._place([0.75, 0.3, 3.4]),
            "target": self._place([0.15, -0.5, 0]),
            "fov": 46.0,
        }

    def _place(self, relative: Any) -> list[float]:
        return (self._centre + self._size * np.asarray(relative)).tolist()

    def _quad(self, centre: Any, first: Any, second: Any, reflectance: Any) -> dict[str, Any]:
        edges = {"first": first, "second": second}
        sides = {name: (self._size * np.asarray(edge)).tolist() for name, edge in edges.items()}
        return {"centre": self._place(centre), **sides, "reflectance": reflectance}

    def corners(self, name: str) -> np.ndarray:
        """[4, 3] of a quadrilateral, counterclockwise from in front."""
        quad = {key: np.array(each) for key, each in self.walls[name].items()}
        signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        return quad["centre"] + signs @ np.stack([quad["first"], quad["second"]])


def by_mitsuba(asset: Any, scene: Scene, folder: Path) -> np.ndarray:
    import lumitree

    mi = load_mitsuba()
    camera = scene.camera
    film = {"type": "hdrfilm", "width": WIDTH, "height": HEIGHT, "rfilter": {"type": "box"}}
    look = mi.ScalarTransform4f().look_at(camera["origin"], camera["target"], [0, 1, 0])
    things: dict[str, Any] = {
        "type": "scene",
        # The glass takes more of a path than the surfaces around it.
        "integrator": {"type": "path", "max_depth": 24},
        "sensor": {"type": "perspective", "fov": camera["fov"], "to_world": look, "film": film},
        **mitsuba_walls(scene.walls),
    }
    found = lumitree.render(things, [lumitree.Placement(asset)], spp=64)
    return found.pixels


def _radiance(lamp: str, radiance: Radiance, scene: Scene) -> np.ndarray:
    """Image with the text of a lamp."""
    mi = load_mitsuba()
    lines = []
    for name, quad in scene.walls.items():
        colour = " ".join(map(str, quad["reflectance"]))
        x, y, z = scene.corners(name).T
        numbers = " ".join(f"{each:.9g}" for each in np.stack([x, -z, y], axis=-1).ravel())
        lines.append(f"void plastic paint_{name} 0 0 5 {colour} 0 0")
        lines.append(f"paint_{name} polygon {name} 0 0 12 {numbers}")
    path = radiance.folder / "image.hdr"
    path.write_bytes(radiance.image("\n".join([*lines, lamp]), scene.camera, WIDTH, HEIGHT))
    pixels = np.array(mi.Bitmap(str(path)), np.float64)[..., :3]
    # Luminance stays, and the ratios of R, G and B.
    theirs = LUMENS_PER_WATT * (pixels @ np.array(LUMA))
    return pixels * (theirs / np.maximum(luminance(pixels), 1e-30))[..., None]


def by_radiance(asset: Any, scene: Scene, folder: Path) -> np.ndarray:
    import lumitree

    lumitree.export(asset, folder / "lamp.rad")
    return _radiance("!xform lamp.rad\n", Radiance(folder), scene)


def by_ies(asset: Any, scene: Scene, folder: Path) -> np.ndarray:
    import lumitree

    lumitree.export(asset, folder / "lamp")
    radiance = Radiance(folder)
    return _radiance(ies_text(radiance, folder / "lamp"), radiance, scene)


def _cycles(script: Path, scene: Scene, samples: int) -> np.ndarray:
    job = CyclesJob(
        str(script),
        explicit=False,
        at=[0.0, 0.0, 0.0],
        width=WIDTH,
        height=HEIGHT,
        samples=samples,
        seeds=[0],
        walls=scene.walls,
        camera=scene.camera,
        diffuse_bounces=BOUNCES,
    )
    return render_cycles(os.environ["LUMITREE_BLENDER_PYTHON"], job).images[0]


def by_cycles(asset: Any, scene: Scene, folder: Path) -> np.ndarray:
    import lumitree

    lumitree.export(asset, folder / "lamp.py")
    return _cycles(folder / "lamp.py", scene, 40)


IMPORT = """
import bpy

def node_tree(owner):
    if owner.node_tree is None:
        owner.use_nodes = True
    return owner.node_tree

def add_lamp(scene):
    bpy.ops.wm.usd_import(filepath=%r)
    for thing in bpy.data.objects:
        if thing.type == "MESH":
            # As the exported script has it.
            thing.visible_shadow = thing.visible_diffuse = False
    collection = bpy.data.collections.new("lamp")
    collection.objects.link(bpy.data.objects.new("lamp", None))
    return collection
"""


def by_usd(asset: Any, scene: Scene, folder: Path) -> np.ndarray:
    """Blender ignores profiles, and makes spots of lights that have one: a package has none."""
    import lumitree

    lumitree.export(asset, folder / "lamp.usdz")
    (folder / "import.py").write_text(IMPORT % str(folder / "lamp.usdz"))
    # An intensity of 1 cd becomes one of 1 W/sr.
    return _cycles(folder / "import.py", scene, 40) / LUMENS


THREE = """(async () => {
  const THREE = await import('three');
  const { GLTFLoader } = await import('loader');
  const bytes = Uint8Array.from(atob('%s'), c => c.charCodeAt(0));
  const model = await new GLTFLoader().parseAsync(bytes.buffer, '');
  const { quads, camera, width, height } = %s;
  const scene = new THREE.Scene();
  scene.add(model.scene);
  for (const { corners, colour } of quads) {
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute('position', new THREE.Float32BufferAttribute(corners.flat(), 3));
    geometry.setIndex([0, 1, 2, 0, 2, 3]);
    geometry.computeVertexNormals();
    const material = new THREE.MeshLambertMaterial();
    material.color.setRGB(...colour, THREE.LinearSRGBColorSpace);
    scene.add(new THREE.Mesh(geometry, material));
  }
  const eye = new THREE.PerspectiveCamera(camera.vertical, width / height, 0.01, 100);
  eye.position.set(...camera.origin);
  eye.lookAt(...camera.target);
  const renderer = new THREE.WebGLRenderer();
  const target = new THREE.WebGLRenderTarget(width, height, {type: THREE.FloatType, samples: 4});
  renderer.setRenderTarget(target);
  renderer.render(scene, eye);
  const pixels = new Float32Array(4 * width * height);
  renderer.readRenderTargetPixels(target, 0, 0, width, height, pixels);
  let text = '';
  for (const each of new Uint8Array(pixels.buffer)) text += String.fromCharCode(each);
  return btoa(text);
})()"""


def by_three(asset: Any, scene: Scene, folder: Path) -> np.ndarray:
    import lumitree

    lumitree.export(asset, folder / "lamp.glb")
    quads = [
        {"corners": scene.corners(name).tolist(), "colour": quad["reflectance"]}
        for name, quad in scene.walls.items()
    ]
    tangent = np.tan(np.radians(scene.camera["fov"] / 2)) * HEIGHT / WIDTH
    camera = {**scene.camera, "vertical": float(np.degrees(2 * np.arctan(tangent)))}
    facts = json.dumps({"quads": quads, "camera": camera, "width": WIDTH, "height": HEIGHT})
    coded = base64.b64encode((folder / "lamp.glb").read_bytes()).decode()
    page = three_page(node_modules(folder / "npm"))
    found = evaluate(page, THREE % (coded, facts), folder / "profile")
    pixels = np.frombuffer(base64.b64decode(str(found)), np.float32).reshape(HEIGHT, WIDTH, 4)
    # The lowest row is first; values are cd/m².
    return pixels[::-1, :, :3] / LUMENS


def three_page(packages: Path) -> str:
    """A page with three.js and its loader of glTF, as modules without a server."""
    jsm = packages / "three" / "examples" / "jsm"
    files = {
        "three-core": packages / "three" / "build" / "three.core.js",
        "three": packages / "three" / "build" / "three.module.js",
        "buffers": jsm / "utils" / "BufferGeometryUtils.js",
        "skeletons": jsm / "utils" / "SkeletonUtils.js",
        "loader": jsm / "loaders" / "GLTFLoader.js",
    }
    relative = {
        "./three.core.js": "three-core",
        "../utils/BufferGeometryUtils.js": "buffers",
        "../utils/SkeletonUtils.js": "skeletons",
    }
    imports = {}
    for name, path in files.items():
        text = path.read_text(encoding="utf-8")
        for given, wanted in relative.items():
            text = text.replace(f"'{given}'", f"'{wanted}'")
        coded = base64.b64encode(text.encode()).decode()
        imports[name] = f"data:text/javascript;base64,{coded}"
    table = json.dumps({"imports": imports})
    return f'<html><head><script type="importmap">{table}</script></head><body></body></html>'


PROGRAMS = (
    ("Mitsuba 3 with lumitree\nthe baked asset itself", by_mitsuba),
    ("Radiance, .rad\n16 lights; the lamp's surfaces are not shown", by_radiance),
    ("Blender's Cycles, .py\n16 lights", by_cycles),
    ("three.js, .glb\nlights even in all directions; no shadows, no reflections", by_three),
    ("OpenUSD, .usdz, in Blender's Cycles\nlights even in all directions", by_usd),
    (
        "IES files, in Radiance by ies2rad\n16 lights without colour; surfaces are not shown",
        by_ies,
    ),
)


def main(asset_path: str, kept: Path) -> None:
    import lumitree
    from lumitree.rendering.drawing import Panel, write_strip
    from lumitree.rendering.photograph import PhotoSettings, ev_of_white

    load_mitsuba()
    asset = lumitree.load(asset_path)
    scene, panels = Scene(asset), []
    kept.mkdir(parents=True, exist_ok=True)
    for caption, render in PROGRAMS:
        path = kept / f"{render.__name__}.npy"
        if not path.exists():
            with tempfile.TemporaryDirectory() as folder:
                np.save(path, render(asset, scene, Path(folder)))
        panels.append(Panel(caption, np.load(path)))
    ev = ev_of_white(float(np.median(luminance(panels[0][1]))) / (0.25 * LUMENS))
    settings = PhotoSettings(exposure=f"ev={ev}", white_balance="off", view="srgb")
    with tempfile.TemporaryDirectory() as folder:
        strip = Path(folder) / "strip.png"
        write_strip(strip, panels, settings, columns=3)
        Image.open(strip).convert("RGB").save(PICTURE, "JPEG", quality=82)


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
