"""The methods of LuxCore: the explicit lamp, by a Python that has the module `pyluxcore`.

The scene is written as properties of LuxCore's scene description, and meshes as arrays.
"""

import dataclasses
import json
import shutil
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.rival_methods.method import PATH_DEPTH, Method, TimedImage
from benchmarks.rival_methods.room import Room, lamp_from_file
from lumitree.asset.geometry import AssetGeometry, Shape
from lumitree.asset.materials import (
    Blend,
    Diffuse,
    Glass,
    Mask,
    Material,
    Metal,
    Microfacets,
    Parameter,
    Plastic,
    Principled,
    RoughConductor,
    RoughDielectric,
    RoughPlastic,
    Texture,
    ThinDielectric,
    TwoSided,
    VertexColours,
)
from lumitree.core.frames import similarity_scale
from lumitree.errors import LumitreeError, shown

_SCRIPT = Path(__file__).with_name("luxcore_script.py")
# Seconds after which the program is ended.
_LIMIT = 1800.0
# Depth from which on paths end by Russian roulette, by default; and one at which they carry so
# little that its bias in bidirectional path tracing does not count.
_ROULETTE, _LATE_ROULETTE = 3, 12
# Parameters of principled materials that are plastics.
_PLAIN = {"base_color", "roughness", "specular", "eta"}
Properties = dict[str, Any]


def find_luxcore(program: str) -> str:
    """Path of a Python that has the module `pyluxcore`.

    Raises:
        LumitreeError: it is no program, or has not the module.
    """
    found = shutil.which(program)
    if found is None:
        raise LumitreeError(f"{shown(program, 200)} is not a program")
    check = [found, "-P", "-c", "import numpy, pyluxcore"]
    if subprocess.run(check, capture_output=True).returncode:
        raise LumitreeError(f"{shown(program, 200)} has no module pyluxcore; pip install pyluxcore")
    return found


@dataclasses.dataclass(frozen=True)
class LuxCoreScene:
    """A scene of LuxCore.

    Attributes:
        properties: of the scene, by name; numbers, text or lists of numbers.
        meshes: arrays `NAME.vertices` float32 [V, 3], `NAME.faces` uint32 [F, 3] and, where a mesh
            has them, `NAME.normals` float32 [V, 3].
    """

    properties: Properties
    meshes: dict[str, NDArray[Any]]


def luxcore_scene(
    parts: Sequence[tuple[str, AssetGeometry, NDArray[np.float64]]], view: dict[str, Any]
) -> LuxCoreScene:
    """A scene of geometries and a camera.

    Args:
        parts: name, geometry, and the similarity [4, 4] from its file to the scene.
        view: as `Room.camera` returns it.

    Raises:
        LumitreeError: a material has no equal in LuxCore.
    """
    from lumitree.exports.surfaces import geometry_meshes

    height = view["height"] / view["width"]
    # LuxCore counts rows from the bottom, and shows each a pixel too low.
    pixel = 2 / view["width"]
    properties: Properties = {
        "scene.camera.type": "perspective",
        "scene.camera.lookat.orig": view["origin"],
        "scene.camera.lookat.target": view["target"],
        "scene.camera.up": [0, 1, 0],
        "scene.camera.fieldofview": view["fov"],
        "scene.camera.screenwindow": [-1, 1, -height - pixel, height - pixel],
        "scene.camera.autofocus.enable": 0,
        "scene.camera.cliphither": 1e-3,
    }
    meshes: dict[str, NDArray[Any]] = {}
    for part, geometry, matrix in parts:
        scale = similarity_scale(matrix, "placement")
        for index, mesh in enumerate(geometry_meshes(geometry, matrix)):
            shape, name = geometry.shapes[index], f"{part}{index}"
            for kind in ("vertices", "faces", "normals"):
                if kind in mesh:
                    meshes[f"{name}.{kind}"] = mesh[kind]
            properties |= shape_properties(name, shape, geometry.materials, scale)
    return LuxCoreScene(properties, meshes)


def shape_properties(
    name: str, shape: Shape, materials: Sequence[Material], scale: float
) -> Properties:
    """Properties of a shape: its material, what it emits, and the medium inside.

    Args:
        name: of the object, its mesh and its material.
        shape: of an `AssetGeometry`.
        materials: of the geometry.
        scale: units of the scene in one of the luminaire's file.

    Raises:
        LumitreeError: LuxCore has no equal.
    """
    if shape.exterior is not None:
        raise LumitreeError("LuxCore: media outside of a shape are not written")
    if shape.scatters:
        # With its homogeneous media, `star` does not light the room.
        raise LumitreeError("LuxCore: media that scatter are not written")
    found = material_properties(name, materials[shape.material])
    if shape.radiance is not None:
        found[f"scene.materials.{name}.emission"] = _colour(shape.radiance)
    if shape.interior is not None:
        # Volumes and materials share their names.
        volume = f"scene.volumes.{name}_medium"
        found[f"{volume}.type"] = "clear"
        found[f"{volume}.absorption"] = [each / scale for each in shape.interior.absorption]
        found[f"{volume}.ior"] = found.get(f"scene.materials.{name}.interiorior", 1.0)
        found[f"scene.materials.{name}.volume.interior"] = f"{name}_medium"
    found[f"scene.objects.{name}.shape"] = name
    found[f"scene.objects.{name}.material"] = name
    return found


def material_properties(name: str, material: Material) -> Properties:
    """Properties of a material and of its nested materials.

    Metals have their reflectance at normal incidence, which rises to 1 at grazing angles. Plastics
    have a coat over a diffuse base; their index gives its reflectance at normal incidence.
    LuxCore's microfacets have the distribution of Trowbridge and Reitz.

    Raises:
        LumitreeError: LuxCore has no equal of the material.
    """
    from lumitree.exports.pbr import principled_index, relative_index
    from lumitree.lamp.materials import normal_reflectance

    own: Properties
    inner: Properties = {}
    for index, nested in enumerate(material.nested):
        inner |= material_properties(f"{name}_{index}", nested)
    match material:
        case TwoSided(nested=(both,)):
            # Opaque surfaces of LuxCore have two sides, alike.
            return material_properties(name, both)
        case TwoSided():
            own = {"type": "twosided", "frontmaterial": f"{name}_0", "backmaterial": f"{name}_1"}
        case Blend():
            own = {"type": "mix", "material1": f"{name}_0", "material2": f"{name}_1"}
            own["amount"] = _number(material.weight)
        case Mask():
            own = {"type": "mix", "material1": f"{name}_clear", "material2": f"{name}_0"}
            own["amount"] = _number(material.opacity, 0.5)
            inner[f"scene.materials.{name}_clear.type"] = "null"
        case Diffuse():
            own = {"type": "matte", "kd": _colour(material.reflectance, 0.5)}
        case Glass():
            own = {
                "type": "archglass" if isinstance(material, ThinDielectric) else "glass",
                "kr": _colour(material.specular_reflectance),
                "kt": _colour(material.specular_transmittance),
                "interiorior": relative_index(material),
                "exteriorior": 1.0,
            }
            if isinstance(material, RoughDielectric):
                own |= {"type": "roughglass", **_roughness(material)}
        case Metal():
            tint = np.array(_colour(material.specular_reflectance))
            reflectance = (tint * normal_reflectance(material)).tolist()
            own = {"type": "mirror", "kr": reflectance}
            if isinstance(material, RoughConductor):
                own = {"type": "metal2", "fresnel": f"{name}_fresnel", **_roughness(material)}
                inner[f"scene.textures.{name}_fresnel.type"] = "fresnelcolor"
                inner[f"scene.textures.{name}_fresnel.kr"] = reflectance
        case Plastic():
            own = _coated(_colour(material.diffuse_reflectance, 0.5), relative_index(material))
            alpha = _number(material.alpha, 0.1) if isinstance(material, RoughPlastic) else 0.0
            own |= {"uroughness": alpha, "vroughness": alpha}
        case Principled() if material.parameters.keys() <= _PLAIN:
            own = _coated(_colour(material.base_color, 0.5), principled_index(material))
            alpha = _number(material.roughness, 0.5) ** 2
            own |= {"uroughness": alpha, "vroughness": alpha}
        case _:
            raise LumitreeError(f"LuxCore: a material {material.plugin!r} is not written")
    return inner | {f"scene.materials.{name}.{key}": value for key, value in own.items()}


def _coated(colour: list[float], index: float) -> Properties:
    """A diffuse base of a colour under a coat with an index of refraction."""
    return {"type": "glossy2", "kd": colour, "ks": [1.0] * 3, "index": index}


def _roughness(material: Microfacets) -> Properties:
    first, second = (
        _number(material.alpha if each is None else each, 0.1)
        for each in (material.alpha_u, material.alpha_v)
    )
    return {"uroughness": first, "vroughness": second}


def _colour(value: Parameter | None, default: float = 1.0) -> list[float]:
    if isinstance(value, Texture | VertexColours):
        raise LumitreeError("LuxCore: textures are not written")
    given = default if value is None else value
    return np.broadcast_to(np.asarray(given, np.float64), 3).tolist()


def _number(value: Parameter | None, default: float = 1.0) -> float:
    return float(np.mean(_colour(value, default)))


@dataclasses.dataclass(frozen=True)
class Engine:
    """How LuxCore renders.

    Attributes:
        kind: of the render engine.
        sampler: random numbers.
        roulette: depth from which on Russian roulette ends paths.
        hybrid: whether caustics come from light paths.
    """

    kind: str
    sampler: str = "SOBOL"
    roulette: int = _ROULETTE
    hybrid: bool = False

    def properties(self, view: dict[str, Any], samples: int, seed: int) -> Properties:
        """Configuration of an image in linear radiance: no clamping, no filter.

        Args:
            view: as `Room.camera` returns it.
            samples: per pixel.
            seed: of all random numbers.
        """
        found: Properties = {
            "renderengine.type": self.kind,
            "renderengine.seed": seed,
            "sampler.type": self.sampler,
            # Samples go to all pixels alike.
            "sampler.sobol.adaptive.strength": 0,
            "sampler.random.adaptive.strength": 0,
            "film.width": view["width"],
            "film.height": view["height"],
            "film.filter.type": "NONE",
            "film.imagepipelines.0.0.type": "NOP",
            "film.outputs.0.type": "RGB",
            "film.outputs.0.filename": "image.exr",
            # Samples from the camera and from lights.
            "batch.haltspp": [0, samples] if self.kind == "LIGHTCPU" else [samples, 0],
            "path.clamping.variance.maxvalue": 0,
            "path.hybridbackforward.enable": int(self.hybrid),
        }
        for path in ("path", "light"):
            found[f"{path}.maxdepth"] = PATH_DEPTH
            found[f"{path}.russianroulette.depth"] = self.roulette
        for kind in ("total", "diffuse", "glossy", "specular"):
            found[f"path.pathdepth.{kind}"] = PATH_DEPTH
        return found


ENGINES = {
    "luxcore-path": ("LuxCore PATHCPU", Engine("PATHCPU")),
    "luxcore-hybrid": ("LuxCore PATHCPU, hybrid", Engine("PATHCPU", hybrid=True)),
    "luxcore-bidir": ("LuxCore BIDIRCPU, Sobol", Engine("BIDIRCPU")),
    "luxcore-bidir-late": (
        "LuxCore BIDIRCPU, Sobol, late roulette",
        Engine("BIDIRCPU", roulette=_LATE_ROULETTE),
    ),
    "luxcore-metropolis": (
        "LuxCore BIDIRCPU, Metropolis, late roulette",
        Engine("BIDIRCPU", "METROPOLIS", roulette=_LATE_ROULETTE),
    ),
    "luxcore-light": ("LuxCore LIGHTCPU", Engine("LIGHTCPU")),
    "luxcore-light-random": ("LuxCore LIGHTCPU, random", Engine("LIGHTCPU", "RANDOM")),
}


class LuxCoreRenderer:
    """Renders one scene by one engine.

    Args:
        program: from `find_luxcore`.
        scene: what is rendered.
        view: as `Room.camera` returns it.
        engine: how.
    """

    def __init__(
        self, program: str, scene: LuxCoreScene, view: dict[str, Any], engine: Engine
    ) -> None:
        self._program, self._scene, self._view, self._engine = program, scene, view, engine

    def images(self, samples: int, seeds: Sequence[int]) -> Iterator[TimedImage]:
        """As `Renderer.images`."""
        with tempfile.TemporaryDirectory() as scratch:
            folder = Path(scratch)
            np.savez(folder / "meshes.npz", **self._scene.meshes)  # type: ignore[arg-type]
            configs = [self._engine.properties(self._view, samples, seed) for seed in seeds]
            job = {
                "scene": lines(self._scene.properties),
                "images": [lines(config) for config in configs],
                "width": self._view["width"],
                "height": self._view["height"],
            }
            (folder / "job.json").write_text(json.dumps(job), encoding="utf-8")
            command = [self._program, "-P", str(_SCRIPT), str(folder)]
            run = subprocess.run(
                command, capture_output=True, text=True, errors="replace", timeout=_LIMIT
            )
            if run.returncode:
                last = (run.stderr.strip() or run.stdout.strip() or "no message").splitlines()[-1]
                raise LumitreeError(f"LuxCore: status {run.returncode}: {shown(last, 300)}")
            with np.load(folder / "result.npz") as found:
                images, wall, cpu = (found[name] for name in ("images", "wall", "cpu"))
        for image, *seconds in zip(images, wall.tolist(), cpu.tolist(), strict=True):
            yield TimedImage(image, {"wall": seconds[0], "cpu": seconds[1]})


def lines(properties: Properties) -> str:
    """Properties as LuxCore reads them, a line each."""
    return "".join(
        f"{name} = {' '.join(map(str, value)) if isinstance(value, list) else value}\n"
        for name, value in properties.items()
    )


def luxcore_methods(luminaire: Any, room: Room, program: str) -> list[Method]:
    """The methods for a lamp.

    Args:
        luminaire: `Luminaire`.
        room: where it hangs.
        program: from `find_luxcore`.

    Raises:
        LumitreeError: the lamp has a material that LuxCore has no equal for.
    """
    from lumitree.lamp.stored_geometry import stored_geometry

    view = room.camera()
    parts = [
        ("room", room.geometry(), np.eye(4)),
        ("lamp", stored_geometry(luminaire), lamp_from_file(luminaire.frame)),
    ]
    scene = luxcore_scene(parts, view)
    return [
        Method(
            name,
            label,
            LuxCoreRenderer(program, scene, view, engine),
            whole_image=engine.kind != "LIGHTCPU",
            key={"scene": lines(scene.properties), "engine": lines(engine.properties(view, 1, 0))},
        )
        for name, (label, engine) in ENGINES.items()
    ]
