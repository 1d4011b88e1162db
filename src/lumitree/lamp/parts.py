"""A lamp as parts and materials, independent of the file format that it was read from.

Frame: right-handed, y up unless the file says otherwise; lengths in the lamp's own unit. Emitted
radiance is in W/(m² sr) for each of R, G and B (linear sRGB primaries). Names of parts and
materials are unique, and patterns choose by them.
"""

import dataclasses
import fnmatch
import functools
import re
from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.geometry import Medium
from lumitree.asset.materials import VertexColours
from lumitree.core.images import linear_from_srgb
from lumitree.core.photometry import RGB
from lumitree.errors import LumitreeError, shown, shown_names
from lumitree.lamp.meshes import Floats, Mesh

# Loading a shape takes milliseconds, however few triangles it has.
MAX_SHAPES = 5000

WHITE: RGB = (1.0, 1.0, 1.0)
Microfacets = Literal["ggx", "beckmann"]
# A pattern of digits alone; a name of this form is matched by "[#]3".
_NUMBER = re.compile(r"#[0-9]{1,9}")


@dataclasses.dataclass(frozen=True, eq=False)
class Texture:
    """An image over a mesh's texture coordinates.

    Attributes:
        pixels: [H, W, C] with C = 1 or 3; uint8 in [0, 255] for [0, 1], or float32 for values
            beyond 1. Row 0 is at v = 0.
        encoded: whether the values are sRGB-encoded colours, rather than linear data.
        wrap: what lies outside [0, 1].
        nearest: no interpolation between pixels.
        uv_transform: [3, 3] affine map from the mesh's (u, v, 1) to the image's.
    """

    pixels: NDArray[np.uint8] | NDArray[np.float32]
    encoded: bool
    wrap: Literal["repeat", "mirror", "clamp"] = "repeat"
    nearest: bool = False
    uv_transform: Floats = dataclasses.field(default_factory=lambda: np.eye(3))

    def linear(self) -> NDArray[np.float32]:
        """Linear values [H, W, C]."""
        if self.pixels.dtype != np.uint8:
            return self.pixels.astype(np.float32, copy=False)
        pixels = self.pixels / np.float32(255)
        return linear_from_srgb(pixels) if self.encoded else pixels


Colour = RGB | Texture | VertexColours
Value = float | Texture


@dataclasses.dataclass(frozen=True)
class Glass:
    """A clear or frosted dielectric.

    Attributes:
        ior: index of refraction, above 1.
        roughness: square root of the alpha of microfacets; below 0.01 it is smooth. A thin sheet is
            always smooth.
        tint: factor of the transmitted light at each crossing of the surface.
        thin: the mesh is a single sheet; otherwise it is a closed surface of a solid.
        medium: what fills a solid; None for nothing.
        microfacets: their distribution; GGX, as models have it, with the light that is scattered
            more than once, or Beckmann's without.
    """

    ior: float = 1.5
    roughness: float = 0.0
    tint: RGB = WHITE
    thin: bool = False
    medium: Medium | None = None
    microfacets: Microfacets = "ggx"


@dataclasses.dataclass(frozen=True)
class Metal:
    """A conductor.

    Attributes:
        tint: factor of the reflected light.
        roughness: square root of the alpha of microfacets; below 0.01 it is a mirror.
        conductor: measured index of refraction by Mitsuba's name ("Au", "Cr", ...); "none"
            reflects everything.
        microfacets: as of `Glass`.
    """

    tint: RGB = WHITE
    roughness: float = 0.0
    conductor: str = "none"
    microfacets: Microfacets = "ggx"


@dataclasses.dataclass(frozen=True)
class Diffuse:
    """A Lambertian reflector."""

    reflectance: Colour = (0.5, 0.5, 0.5)


@dataclasses.dataclass(frozen=True)
class MetallicRoughness:
    """The material of glTF 2.0, which `lamp.metallic_roughness` renders; all in [0, 1] but `ior`.

    Attributes:
        roughness: square root of the GGX alpha.
        specular: factor of the reflection of a dielectric.
        transmission: share of the light that is refracted instead of diffusely reflected.
        diffuse_transmission: twice the share of the diffuse light that leaves on the other side, in
            [0, 2]; only of a thin sheet.
        thin: the mesh is a single sheet.
    """

    base_color: Colour = (0.5, 0.5, 0.5)
    metallic: Value = 0.0
    roughness: Value = 0.5
    anisotropy: Value = 0.0
    ior: float = 1.5
    specular: Value = 1.0
    sheen: Value = 0.0
    clearcoat: Value = 0.0
    clearcoat_roughness: float = 0.0
    transmission: Value = 0.0
    diffuse_transmission: float = 0.0
    thin: bool = False


Surface = Glass | Metal | Diffuse | MetallicRoughness


@dataclasses.dataclass(frozen=True)
class Material:
    """A surface with its emission, opacity and normal map.

    Attributes:
        name: unique in the lamp.
        title: its name in the model's file, which several may share: one material of the file may
            become one for each kind of mesh. Default: `name`.
        radiance: emitted by the front of the surface where it is present; None where it does not
            emit.
        opacity: in [0, 1]; light crosses the rest of the surface unchanged.
        normal_map: tangent-space normals, linear data.
        two_sided: the back reflects as the front does. Without effect on glass and thin
            sheets, which define both sides.
    """

    name: str
    surface: Surface
    radiance: Colour | None = None
    opacity: Value = 1.0
    normal_map: Texture | None = None
    two_sided: bool = False
    title: str = ""

    def __post_init__(self) -> None:
        if not self.title:
            object.__setattr__(self, "title", self.name)


def painted(surface: Surface) -> Surface | None:
    """The surface with the colours of its mesh's vertices; None for one that has no such colour."""
    match surface:
        case Diffuse():
            return Diffuse(VertexColours())
        case MetallicRoughness():
            return dataclasses.replace(surface, base_color=VertexColours())
        case _:
            return None


def transmits(surface: Surface) -> bool:
    """Whether light crosses a surface, so that its BSDF defines both sides."""
    if isinstance(surface, MetallicRoughness):
        diffuse = surface.thin and surface.diffuse_transmission > 0
        return diffuse or isinstance(surface.transmission, Texture) or surface.transmission > 0
    return isinstance(surface, Glass)


@dataclasses.dataclass(frozen=True)
class Part:
    """A mesh with its material, in one or more places.

    Attributes:
        name: unique in the lamp; also the name of the mesh file.
        mesh: in the part's own frame.
        material: name of a material.
        places: `world_from_part` [4, 4] of every copy.
        objects: of every copy, the name of the object in the model's file; () where objects have
            the name of the part.
        in_metres: whether the mesh is in metres, whatever the unit of the model is.
    """

    name: str
    mesh: Mesh
    material: str
    places: tuple[Floats, ...] = (np.eye(4),)
    objects: tuple[str, ...] = ()
    in_metres: bool = False

    def copies(self, index: Sequence[int]) -> "Part":
        """The part with some of its copies."""
        places, objects = (tuple(v[i] for i in index if v) for v in (self.places, self.objects))
        return dataclasses.replace(self, places=places, objects=objects)

    def placed(self, copy: int) -> Floats:
        """Vertices [V, 3] of a copy, in the model's frame."""
        place = self.places[copy]
        return self.mesh.vertices @ place[:3, :3].T + place[:3, 3]


def check_shapes(count: int, where: str) -> None:
    """Refuse more than `MAX_SHAPES` shapes, one for each place of each part, in `where`."""
    if count > MAX_SHAPES:
        raise LumitreeError(
            f"{where} brings the model to {count} shapes; at most {MAX_SHAPES} are read: join "
            "meshes of one material"
        )


@dataclasses.dataclass(frozen=True)
class Geometry:
    """A lamp: its parts, and the materials they name."""

    parts: tuple[Part, ...]
    materials: tuple[Material, ...]

    def material(self, part: Part) -> Material:
        """The material of a part."""
        return self._materials[part.material]

    @functools.cached_property
    def _materials(self) -> dict[str, Material]:
        return {material.name: material for material in self.materials}


@dataclasses.dataclass(frozen=True)
class Figures:
    """A lamp in numbers, of all copies of all parts.

    `emitted_radiance` is the largest channel that any surface emits, W/(m² sr); `size` the sides of
    the bounding box, in the lamp's unit.
    """

    triangles: int
    emitters: int
    emitted_radiance: float
    size: tuple[float, float, float]
    has_media: bool


def figures(model: Geometry) -> Figures:
    """The figures of a lamp."""
    emitting = [part for part in model.parts if model.material(part).radiance is not None]
    points = [part.placed(copy) for part in model.parts for copy in range(len(part.places))]
    sides = np.max([p.max(axis=0) for p in points], axis=0)
    sides -= np.min([p.min(axis=0) for p in points], axis=0)
    surfaces = [model.material(part).surface for part in model.parts]
    return Figures(
        triangles=sum(len(part.mesh.faces) * len(part.places) for part in model.parts),
        emitters=sum(len(part.places) for part in emitting),
        emitted_radiance=max(
            (_largest(model.material(part).radiance, part.mesh) for part in emitting), default=0.0
        ),
        size=(float(sides[0]), float(sides[1]), float(sides[2])),
        has_media=any(isinstance(each, Glass) and each.medium is not None for each in surfaces),
    )


def _largest(radiance: Colour | None, mesh: Mesh) -> float:
    """The largest channel of a radiance on a mesh."""
    if isinstance(radiance, Texture):
        return float(radiance.linear().max())
    if isinstance(radiance, VertexColours):
        return 0.0 if mesh.colours is None else float(mesh.colours.max())
    return max(radiance or (0.0,))


class Names:
    """Makes names that are unique, also where upper and lower case are not distinguished."""

    def __init__(self, separator: str) -> None:
        self._separator = separator
        self._taken: set[str] = set()
        self._numbers: dict[str, int] = {}

    def unique(self, wanted: str) -> str:
        """`wanted`, with a number where it is taken."""
        key = wanted.lower()
        name, number = wanted, self._numbers.get(key, 1)
        while name.lower() in self._taken:
            number += 1
            name = f"{wanted}{self._separator}{number}"
        # The next search starts here: from 1, many equal names would take quadratic time.
        self._numbers[key] = number
        self._taken.add(name.lower())
        return name


def select_names(
    names: Sequence[Sequence[str]],
    keep: Sequence[str],
    drop: Sequence[str],
    file: str,
    kind: str,
    listed: Sequence[str] | None = None,
) -> list[bool]:
    """Which things are kept, each known by one or more names; patterns must match something."""
    how = "" if listed is None else f"; 'lumitree preview {file} --keep \"*\"' lists them all"
    kept, dropped = (
        [matching(each, option, names, file, kind, listed, how) for each in patterns]
        for option, patterns in (("--keep", keep), ("--drop", drop))
    )
    chosen = [
        (not keep or any(each[at] for each in kept)) and not any(each[at] for each in dropped)
        for at in range(len(names))
    ]
    if not any(chosen):
        raise LumitreeError(f"{file}: --keep and --drop leave nothing; keep more or drop less")
    return chosen


def matching(
    pattern: str,
    option: str,
    names: Sequence[Sequence[str]],
    file: str,
    kind: str,
    listed: Sequence[str] | None = None,
    how: str = "",
) -> list[bool]:
    """Which of the things a pattern with * and ? matches, by one of their names.

    Args:
        option, file, kind: the pattern's option, the name of the file, and what the things are, for
            messages.
        listed: descriptions of the things, for messages. They may then be chosen by number, too, as
            "#3". None: by names alone.
        how: end of the message.

    Raises:
        LumitreeError: it matches nothing.
    """
    if listed is not None and _NUMBER.fullmatch(pattern):
        found = [at == int(pattern[1:]) for at in range(len(names))]
    else:
        found = [any(fnmatch.fnmatchcase(name, pattern) for name in each) for each in names]
    if not any(found):
        every = dict.fromkeys(name for each in names for name in each if name)
        raise LumitreeError(
            f"{file}: {option} {shown(pattern)!r} matches no {kind}; there are "
            f"{shown_names(every if listed is None else listed)}{how}"
        )
    return found
