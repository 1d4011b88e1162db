"""The script that makes a lamp in Blender: a template with the lamp's data in it."""

import base64
import dataclasses
import io
from importlib import resources
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.asset import Asset
from lumitree.asset.geometry import AssetGeometry
from lumitree.core.files import json_text
from lumitree.core.frames import similarity
from lumitree.core.photometry import colour_temperature
from lumitree.errors import shown
from lumitree.output.blender.surfaces import Surfaces, absorption_inside
from lumitree.output.direction_tables import direction_tables
from lumitree.output.geometry_meshes import geometry_meshes
from lumitree.output.orientation import Up, turn_up
from lumitree.output.point_lights import PlacedLights, place_lights

_LINE = 120
# Longest name of a thing in Blender, 63, less what the script appends; bytes of UTF-8.
_NAME_BYTES = 48


@dataclasses.dataclass(frozen=True)
class LampScript:
    """Text of a lamp's script, its number of point lights, and one line for each property lost."""

    text: str
    lights: int
    lost: list[str]


def make_script(asset: Asset, lights: int, up: Up, seed: int = 0) -> LampScript:
    """The script of an asset, with at most `lights` point lights; `up` is the axis of its file.

    Raises:
        LumitreeError: the asset has no light field.
    """
    z_up = turn_up(up, "z")
    points = place_lights(asset, z_up, lights, seed)
    description, arrays = _light_data(asset, points)
    lost = ["point lights illuminate the lamp's own surfaces without its shadows"]
    if asset.geometry is None:
        lost = ["the asset has no geometry: the lamp itself is not shown"]
        description |= {"surfaces": [], "absorption": []}
    else:
        surfaces = Surfaces(asset.geometry, asset.gain)
        more, meshes = _surface_data(asset.geometry, surfaces, z_up)
        description, arrays = description | more, arrays | meshes
        lost += sorted(surfaces.lost)
    return LampScript(_filled(description, arrays), len(points.position), lost)


def geometry_script(geometry: AssetGeometry, name: str, up: Up) -> LampScript:
    """The script of surfaces alone, without point lights; `name` is the collection's."""
    surfaces = Surfaces(geometry)
    description, arrays = _surface_data(geometry, surfaces, turn_up(up, "z"))
    description |= {"name": _short(name), "radius": 1.0, "lights": []}
    return LampScript(_filled(description, arrays), 0, sorted(surfaces.lost))


def _short(name: str) -> str:
    """A name that Blender does not cut."""
    return shown(name, _NAME_BYTES).encode()[:_NAME_BYTES].decode(errors="ignore")


def _surface_data(
    geometry: AssetGeometry, surfaces: Surfaces, z_up: NDArray[np.float64]
) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    meshes = geometry_meshes(geometry, similarity(z_up))
    description = {
        "surfaces": list(map(surfaces.tree, geometry.shapes, meshes)),
        "absorption": [absorption_inside(shape) for shape in geometry.shapes],
    }
    arrays: dict[str, NDArray[Any]] = {}
    for index, mesh in enumerate(meshes):
        arrays |= {f"{index}.{name}": values for name, values in mesh.items()}
    arrays |= {f"image {i}": image for i, image in enumerate(geometry.images)}
    return description, arrays


def _filled(description: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> str:
    template = (resources.files("lumitree.output.blender") / "lamp_script.py").read_text("utf-8")
    head, tail = template.split("@@DATA@@")
    return head + _block(description, arrays) + tail


def _light_data(
    asset: Asset, points: PlacedLights
) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
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


def _block(description: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> str:
    """An archive of NumPy in base64, in lines."""
    text = json_text(description).encode()
    content = io.BytesIO()
    np.savez_compressed(content, description=np.frombuffer(text, np.uint8), **arrays)  # type: ignore[arg-type]
    coded = base64.b64encode(content.getvalue()).decode("ascii")
    lines = [coded[start : start + _LINE] for start in range(0, len(coded), _LINE)]
    return "\n" + "\n".join(lines) + "\n"
