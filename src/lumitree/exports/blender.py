"""Blender: a script with the lamp's data in it, and the file that the script makes.

The script is `blender_files/lamp_script.py`, a template. Its point lights have equirectangular
tables of intensities, as Cycles reads them. It runs in Blender, or in a Python that has the module
`bpy`.

Symbols
    R, S        bins of direction a side, point lights, as in `exports.point_lights`
    H           rows of a table
"""

import base64
import dataclasses
import glob
import importlib.util
import io
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from importlib import resources
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lumitree.asset.array_stream import Arrays
from lumitree.asset.asset import Asset
from lumitree.asset.geometry import AssetGeometry
from lumitree.core.files import json_text, scratch_folder
from lumitree.core.frames import similarity
from lumitree.core.octahedral import bilinear_bins
from lumitree.core.photometry import colour_temperature
from lumitree.core.results import Json
from lumitree.errors import LumitreeError, shown
from lumitree.exports.blender_nodes import BlenderMaterials
from lumitree.exports.point_lights import PlacedLights, PointLights, Up, turn_up
from lumitree.exports.surfaces import LOST_GEOMETRY, LOST_SHADOWS, geometry_meshes
from lumitree.exports.target import ExportRequest, Target, Written

_FILES = resources.files("lumitree.exports") / "blender_files"
# Characters of a line of the script's data.
_LINE = 120
# Longest name of a thing in Blender, 63, less what the script appends; bytes of UTF-8.
_NAME_BYTES = 48
# Directions in a texel of a table, a side, that its value is the mean of.
_SUPERSAMPLED = 4
# Directions whose bins are found at once, which bounds memory.
_DIRECTIONS = 1 << 19
# Seconds that a script may take.
_LIMIT = 600
# Where Blender is installed, on macOS and on Windows.
_PLACES = (
    "/Applications/Blender.app/Contents/MacOS/Blender",
    r"%ProgramFiles%\Blender Foundation\*\blender.exe",
)
# Runs a script by Python without its folder on the path of imports; exits with 3 without bpy.
_PYTHON = """
import runpy, sys
try:
    import bpy
except ImportError:
    sys.exit(3)
sys.argv = sys.argv[1:]
runpy.run_path(sys.argv[0], run_name="__main__")
"""
_UNITS = "metres; one watt of a light is one watt of each of R, G and B"


@dataclasses.dataclass(frozen=True)
class LampScript:
    """Text of a lamp's script, its number of point lights, and one line for each property lost."""

    text: str
    lights: int
    lost: list[str]


def make_script(request: ExportRequest) -> LampScript:
    """The script of an asset.

    Raises:
        LumitreeError: the asset has no light field.
    """
    asset, points = request.asset, request.place("z")
    description, arrays = _light_data(asset, points)
    lost = [LOST_SHADOWS]
    if asset.geometry is None:
        lost = [LOST_GEOMETRY]
        description |= {"surfaces": [], "absorption": []}
    else:
        materials = BlenderMaterials(asset.geometry, asset.light_factors)
        more, meshes = _surface_data(asset.geometry, materials, request.up)
        description, arrays = description | more, arrays | meshes
        lost += sorted(materials.lost)
    return LampScript(_filled(description, arrays), len(points.position), lost)


def geometry_script(geometry: AssetGeometry, name: str, up: Up) -> LampScript:
    """The script of surfaces without point lights; `name` is the collection's."""
    materials = BlenderMaterials(geometry)
    description, arrays = _surface_data(geometry, materials, up)
    description |= {"name": _short(name), "radius": 1.0, "lights": []}
    return LampScript(_filled(description, arrays), 0, sorted(materials.lost))


def _short(name: str) -> str:
    """A name that Blender does not cut."""
    return shown(name, _NAME_BYTES).encode()[:_NAME_BYTES].decode(errors="ignore")


def _surface_data(
    geometry: AssetGeometry, materials: BlenderMaterials, up: Up
) -> tuple[Json, Arrays]:
    meshes = geometry_meshes(geometry, similarity(turn_up(up, "z")))
    description = {
        "surfaces": list(map(materials.tree, geometry.shapes, meshes)),
        "absorption": [
            shape.interior and list(shape.interior.absorption) for shape in geometry.shapes
        ],
    }
    arrays: Arrays = {}
    for index, mesh in enumerate(meshes):
        arrays |= {f"{index}.{name}": values for name, values in mesh.items()}
    arrays |= {f"image {i}": image for i, image in enumerate(geometry.images)}
    return description, arrays


def _filled(description: Json, arrays: Arrays) -> str:
    """The script with an archive of NumPy in base64, in lines."""
    text = json_text(description).encode()
    content = io.BytesIO()
    np.savez_compressed(content, description=np.frombuffer(text, np.uint8), **arrays)  # type: ignore[arg-type]
    coded = base64.b64encode(content.getvalue()).decode("ascii")
    lines = [coded[start : start + _LINE] for start in range(0, len(coded), _LINE)]
    head, tail = (_FILES / "lamp_script.py").read_text("utf-8").split("@@DATA@@")
    return "\n".join([head, *lines, tail])


def _light_data(asset: Asset, points: PlacedLights) -> tuple[Json, Arrays]:
    """Positions, powers and tables of the lights, in Blender's frame and units."""
    frame, local = asset.frame, points.local
    tables = direction_tables(local, points.rotation.T, 2 * local.resolution)
    # A point light of P watts has the intensity P / 4π, times its texture. Cycles chooses lights by
    # their watts, whatever the texture, so these are the flux: the mean of R, G and B.
    relative = tables * (4 * np.pi / local.flux.mean(axis=1))[:, None, None, None]
    watts, total = points.watts.mean(axis=1), points.watts.sum(axis=0)
    description = {
        "name": _short(asset.luminaire),
        "radius": float(frame.scale * np.linalg.norm(frame.half_extents)),
        "lights": [
            {"position": place, "watts": power}
            for place, power in zip(points.position.tolist(), watts.tolist(), strict=True)
        ],
        "watts": total.tolist(),
    }
    if asset.is_photometric:
        description["absolute"] = True
    temperature = colour_temperature(total)[0]
    if np.isfinite(temperature):
        description["temperature"] = temperature
    return description, {"tables": relative.astype(np.float16)}


def table_directions(height: int) -> NDArray[np.float64]:
    """Unit directions [H, 2H, 3] of the texels of an equirectangular table, as Cycles has it.

    Column 0 is at azimuth π and they turn towards 0 at the middle; row 0 is at -z, the last at +z.
    """
    azimuth = (0.5 - (np.arange(2 * height) + 0.5) / (2 * height)) * 2 * np.pi
    latitude = ((np.arange(height) + 0.5) / height - 0.5) * np.pi
    flat = np.cos(latitude)[:, None]
    upward = np.broadcast_to(np.sin(latitude)[:, None], (height, 2 * height))
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), upward], axis=-1)


def table_angles(height: int) -> NDArray[np.float64]:
    """Weight [H] of the texels of a row in the integral over the sphere, sr.

    Values between the centres of texels are interpolated linearly. They are constant beyond the
    centres of the first and the last row.
    """
    fine = 64
    rows = (np.arange(height * fine) + 0.5) / fine - 0.5
    area = np.cos(((rows + 0.5) / height - 0.5) * np.pi) * (np.pi / (height * fine))
    rows = rows.clip(0, height - 1)
    first = np.minimum(rows.astype(np.int64), height - 2) if height > 1 else rows.astype(np.int64)
    weight = np.bincount(first, area * (1 - (rows - first)), height)
    weight += np.bincount(np.minimum(first + 1, height - 1), area * (rows - first), height)
    weight *= 2 / weight.sum()
    return weight * (np.pi / height)


def direction_tables(
    lights: PointLights, local_from_table: NDArray[np.float64], height: int
) -> NDArray[np.float64]:
    """Intensities [S, H, 2H, 3] of lights by direction, between which Cycles is linear.

    Each table has the flux of its light, channel by channel. `local_from_table` [3, 3] is the
    rotation from the frame of the table.
    """
    fine = table_directions(height * _SUPERSAMPLED)
    rows = max(1, _DIRECTIONS // (fine.shape[1] * _SUPERSAMPLED))
    intensity = lights.intensity.transpose(1, 0, 2).reshape(lights.resolution**2, -1)
    texels = [
        _texel_weights(part @ local_from_table.T, lights.resolution) @ intensity
        for part in np.split(fine, np.arange(rows, height, rows) * _SUPERSAMPLED)
    ]
    tables = np.concatenate(texels).reshape(height, 2 * height, len(lights.position), 3)
    tables = np.moveaxis(tables, 2, 0)
    have = np.einsum("shwc,h->sc", tables, table_angles(height))
    want = lights.flux
    factor = np.divide(want, have, out=np.zeros_like(want), where=have > 0)
    return tables * factor[:, None, None, :]


def _texel_weights(fine: NDArray[np.float64], resolution: int) -> csr_array:
    """Matrix [texels, R²] of mean intensities, from the directions [h, w, 3] in them."""
    height, width = (length // _SUPERSAMPLED for length in fine.shape[:2])
    share = np.hypot(fine[..., 0], fine[..., 1])
    blocks = share.reshape(height, _SUPERSAMPLED, width, _SUPERSAMPLED)
    share = (blocks / blocks.sum(axis=(1, 3), keepdims=True)).reshape(-1, 1)
    bins, parts = bilinear_bins(fine.reshape(-1, 3), resolution)
    row, column = np.divmod(np.arange(len(bins)), fine.shape[1])
    texel = row // _SUPERSAMPLED * width + column // _SUPERSAMPLED
    entries = (share * parts).ravel(), (np.repeat(texel, bins.shape[1]), bins.ravel())
    return csr_array(entries, shape=(height * width, resolution**2))


def find_blender(program: str | os.PathLike[str] | None) -> str:
    """Path of the program that runs scripts: Blender, or a Python with `bpy`.

    Without a name, `blender` on the search path, one that an installer put elsewhere, or this
    Python if it has `bpy`.

    Raises:
        LumitreeError: there is none.
    """
    if program is not None:
        # An application of macOS is a folder.
        inside = os.path.join(program, "Contents", "MacOS", "Blender")
        found = shutil.which(inside) or shutil.which(program)
        if found is None:
            raise LumitreeError(
                f"{shown(program, 200)} is not a program; expected Blender, or a Python with bpy"
            )
        return found
    installed = [name for pattern in _PLACES for name in glob.glob(os.path.expandvars(pattern))]
    # The newest by the numbers in its path: 4.10 is newer than 4.2.
    installed.sort(key=lambda name: [int(each) for each in re.findall(r"\d+", name)])
    if found := shutil.which("blender") or next(reversed(installed), None):
        return found
    if importlib.util.find_spec("bpy") is not None:
        return sys.executable
    raise LumitreeError(
        "no Blender was found to write the file; name it with --blender, put it on PATH, or "
        "write a .py file, which runs in any Blender"
    )


def run_script(
    program: str,
    script: Path,
    arguments: Sequence[str],
    output: Path,
    limit: float = _LIMIT,
) -> None:
    """Run a script that writes `output`, for at most `limit` seconds.

    Raises:
        LumitreeError: it failed, with the last line that it printed; or it wrote nothing.
    """
    if Path(program).name.lower().startswith("python"):
        command = [program, "-P", "-c", _PYTHON, str(script), *arguments]
    else:
        options = ["--background", "--factory-startup", "--python-exit-code", "1"]
        command = [program, *options, "--python", str(script), "--", *arguments]
    try:
        run = subprocess.run(
            command, capture_output=True, text=True, errors="replace", timeout=limit
        )
    except subprocess.TimeoutExpired:
        raise LumitreeError(f"{shown(program, 200)} took more than {limit:g} s") from None
    if run.returncode == 3:
        raise LumitreeError(f"{shown(program, 200)} has no module bpy; pip install bpy, or Blender")
    if run.returncode:
        lines = (run.stderr.strip() or run.stdout.strip() or "no message").splitlines()
        raise LumitreeError(
            f"{shown(program, 200)} ended with status {run.returncode}: {shown(lines[-1], 300)}"
        )
    if not output.exists():
        raise LumitreeError(
            f"{shown(program, 200)} ended without an error, and wrote nothing; expected Blender, "
            "or a Python with bpy"
        )


def _write_script(request: ExportRequest, folder: Path) -> Written:
    made, geometry = make_script(request), request.asset.geometry
    (folder / request.name).write_bytes(made.text.encode())
    triangles = 0 if geometry is None else geometry.num_triangles
    return Written(not_carried_over=made.lost, lights=made.lights, triangles=triangles)


def _write_blend(request: ExportRequest, folder: Path) -> Written:
    program = find_blender(request.blender)
    with scratch_folder() as scratch:
        written = _write_script(request, scratch)
        output = (folder / request.name).resolve()
        run_script(program, scratch / request.name, [str(output)], output)
    return written


SCRIPT = Target(name="Blender", write=_write_script, up="z", units=_UNITS)
BLEND = dataclasses.replace(SCRIPT, write=_write_blend, check=find_blender)
