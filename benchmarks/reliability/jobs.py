"""The commands that are killed, each of some seconds, and what they need."""

import dataclasses
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

LAMP = (
    '<scene version="3.0.0"><shape type="sphere"><emitter type="area">'
    '<rgb name="radiance" value="3,2,1"/></emitter></shape></scene>\n'
)
ROOM = """<scene version="3.0.0"><integrator type="path"/><sensor type="perspective">
<transform name="to_world"><lookat origin="0,1,5" target="0,1,0" up="0,1,0"/></transform>
<film type="hdrfilm"><integer name="width" value="64"/><integer name="height" value="64"/></film>
</sensor><shape type="rectangle"><transform name="to_world"><rotate x="1" angle="-90"/>
<scale value="4"/></transform></shape></scene>
"""
# A model, which is written to a temporary folder.
MODEL = "mtllib model.mtl\nusemtl light\nv 0 0 0\nv 0 0 1\nv 1 0 0\nv 0 1 0\nf 1 2 3\nf 1 3 4\n"
MATERIAL = "newmtl light\nKd 0.5 0.5 0.5\nKe 3 2 1\n"
_SAMPLES = 256
_LIGHT = "irradiance_paths = 16384\n"
_LIGHT_FIELD = "[light_field]\npaths = 524288\nbatch = 65536\ndepth = 3\nresolution = 32\n"
# States are saved after each step.
_FIELD = f"""parts = ["light", "field", "geometry"]
rays = 524288
tree_depth = 5
l_max = 1
{_LIGHT}{_LIGHT_FIELD}[octree.max_radiance]
rays = 262144
[octree.estimate]
rays = 1048576
growth_rays = 524288
batch_rays = 524288
[octree.calibration]
rays = 16384
[octree.flux]
draws = 2
rays = 262144
[octree.held_out]
rays = 32768
[octree.refine]
rays = 16384
[octree.split]
indicator_rays = 32768
[octree.schedule]
save_seconds = 0.0
save_time_factor = 0.0
"""
INPUTS = {
    "lamp.xml": LAMP,
    "lamp2.xml": LAMP.replace("3,2,1", "1,2,3"),
    "room.xml": ROOM,
    "model.obj": MODEL,
    "model.mtl": MATERIAL,
    "light.toml": _LIGHT + _LIGHT_FIELD,
    "field.toml": _FIELD,
}
PROGRAM = (sys.executable, "-m", "lumitree")
TRAINING = (sys.executable, str(Path(__file__).with_name("tiny_training.py").resolve()))
RENDERING = (sys.executable, str(Path(__file__).with_name("tiny_render.py").resolve()))
# Commands that make further inputs; run in this order.
PREPARATIONS = (
    ("bake", "lamp.xml", "-o", "first.lumitree", "--config", "light.toml"),
    ("bake", "lamp.xml", "-o", "second.lumitree", "--config", "light.toml", "--seed", "1"),
    ("capture", "lamp.xml", "-o", "views", "--views", "8", "--resolution", "32", "--spp", "16"),
)
_PLACED = ("--place", "first.lumitree", "--at", "-1,1,0", "--size", "1",
           "--place", "second.lumitree", "--at", "1,1,0", "--size", "1")  # fmt: skip


def _views(out: Path) -> int:
    return len(list(out.glob("views/view_*.exr")))


def _rays(out: Path) -> int:
    """Rays of the saved state of a bake."""
    path = out / "lamp.work" / "state.npz"
    if not path.exists():
        return 0
    with zipfile.ZipFile(path) as archive, archive.open("rays.npy") as file:
        return int(np.lib.format.read_array(file))


def _lamps(out: Path) -> int:
    return len(list(out.glob("index-files/*.json")))


def _steps(out: Path) -> int:
    """Steps of the newest checkpoint."""
    steps = [int(path.name) for path in out.glob("run/checkpoints/*") if path.name.isdigit()]
    return max(steps, default=0)


def _samples(out: Path) -> int:
    """Samples per pixel of the saved passes of an image, all of it once it is finished."""
    path = out / "image.exr.work" / "passes.npz"
    if (out / "image.exr").exists():
        return _SAMPLES
    if not path.exists():
        return 0
    with zipfile.ZipFile(path) as archive, archive.open("samples.npy") as file:
        return int(np.lib.format.read_array(file))


def _nothing(out: Path) -> int:
    return 0


@dataclasses.dataclass(frozen=True)
class Job:
    """A command that writes into the folder `out`.

    Attributes:
        name: of the job.
        command: without the program.
        program: what runs it.
        state: patterns, relative to `out`, of what an unfinished command may leave.
        varying: patterns of files whose content has times or paths, which are only checked to be
            complete.
        kept: patterns of files that are never written again once they are there.
        done: a number of what is done, from `out`, which kills must not lower.
        resume: option for a command that continues, if it takes one.
        after: a command whose output is compared, too.
    """

    name: str
    command: tuple[str, ...]
    program: tuple[str, ...] = PROGRAM
    state: tuple[str, ...] = ()
    varying: tuple[str, ...] = ()
    kept: tuple[str, ...] = ()
    done: Callable[[Path], int] = _nothing
    resume: tuple[str, ...] = ()
    after: tuple[str, ...] = ()


JOBS = (
    Job(
        "bake",
        ("bake", "lamp.xml", "-o", "out/lamp.lumitree", "--config", "light.toml"),
        state=("lamp.work", "lamp.work/*"),
    ),
    Job(
        "bake with field",
        ("bake", "lamp.xml", "-o", "out/lamp.lumitree", "--config", "field.toml"),
        state=("lamp.work", "lamp.work/*"),
        done=_rays,
    ),
    Job(
        "bake of lamps",
        ("bake", "lamp.xml", "lamp2.xml", "model.obj", "-o", "out/", "--config", "light.toml"),
        state=("*.work", "*.work/*", "index-files/*.claim", "index-files/*.lock"),
        # Pages and names have the lamps so far; records get the time of a file once it is old.
        varying=("*.html", "*/names.js", "index-files/*.json"),
        done=_lamps,
    ),
    Job(
        "capture",
        ("capture", "lamp.xml", "-o", "out/views",
         "--views", "24", "--resolution", "48", "--spp", "64"),
        kept=("views/*",),
        done=_views,
    ),
    Job(
        "train",
        ("train", "views", "-o", "out/run"),
        program=TRAINING,
        state=("run/checkpoints/*",),
        varying=("run/run.json", "run/history.json", "run/checkpoints/*"),
        done=_steps,
        resume=("--resume",),
        after=("extract", "out/run", "-o", "out/run.lumitree", "--tree-depth", "4"),
    ),
    Job(
        "render",
        ("render", "room.xml", *_PLACED, "-o", "out/image.exr", "--spp", str(_SAMPLES),
         "--layers", "out/layers.exr", "--aov", "out/aov.exr"),
        program=RENDERING,
        state=("image.exr.work", "image.exr.work/*"),
        done=_samples,
    ),
    Job(
        "photometry",
        ("photometry", "model.obj", "-o", "out/lamp.ies", "-o", "out/lamp.ldt", "-o",
         "out/lamp.ray", "-o", "out/report.html", "--paths", "262144", "--step", "10"),
    ),
    Job(
        "illuminance",
        ("illuminance", "room.xml", *_PLACED, "--plane", "0,0.1,0", "--extent", "4,4",
         "-o", "out/plane.csv", "-o", "out/plane.png", "-o", "out/plane.json"),
        varying=("plane.json",),
    ),
    Job("export", ("export", "first.lumitree", "-o", "out/lamp.rad", "--lights", "4")),
    Job("export to a folder", ("export", "first.lumitree", "-o", "out/lights", "--lights", "4")),
)  # fmt: skip
