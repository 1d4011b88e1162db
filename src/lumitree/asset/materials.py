"""The materials that the geometry of an asset may have: BSDF plugins of Mitsuba, one class each.

They are the materials of lamps, from importers and scenes to exporters and the viewer. A parameter
that is None has Mitsuba's default. No parameter names a file. Mitsuba makes the BSDF of every
material that `check_material` accepts, and its values are finite and not negative.
docs/format.md has the same rules in words, and `asset.geometry_file` reads and writes materials.
"""

import dataclasses
import functools
import math
import typing
from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from lumitree.core.frames import Matrix, rows_of
from lumitree.core.images import linear_from_srgb
from lumitree.core.mitsuba_meshes import VERTEX_COLOUR
from lumitree.core.photometry import RGB
from lumitree.core.tables import object_of, shown_value
from lumitree.errors import LumitreeError, shown

Range = tuple[float, float]
# Pixels of an image of an asset.
Image = NDArray[np.uint8] | NDArray[np.float32]
_IDENTITY = rows_of(np.eye(4))

_MAX_COLOUR, _MAX_RADIANCE, _MAX_TRANSFORM = 1e4, 1e15, 1e4
# Colours of vertices, and numbers that are parts of a whole.
_UNIT: Range = (0.0, 1.0)
# Largest texture coordinate in pixels. Mitsuba rounds it to an integer of 32 bits, and weights
# pixels by the rest: with a larger one the weights are wrong.
_MAX_PIXEL_COORDINATE = 2**30
# Values of images may exceed their range by rounding to 16 bits.
_ROUNDING = 1e-3
# A two-sided material is built from two copies of the material inside.
MAX_NESTING = 8
# Where both of two colours are darker than this, Mitsuba divides 0 by 0.
_BLACK = 1e-6

# Mitsuba's names of measured conductors; the first group comes from two sources. "AlSb" and
# "AlSb_palik" are missing: Mitsuba's tables of them give NaN in RGB variants.
_MEASURED_TWICE = (
    *("AlAs", "Be", "CsI", "Cu", "Cu2O", "CuO", "d-C", "Hg", "HgTe", "Ir", "K", "Li", "MgO"),
    *("Mo", "Nb", "Rh", "Se", "Se-e", "SiC", "SnTe", "Ta", "Te", "Te-e", "ThF4", "TiC", "TiN"),
    *("TiO2", "TiO2-e", "VC", "VN"),
)
CONDUCTORS = frozenset(
    (
        *("none", "a-C", "Ag", "Al", "Au", "Cr", "W", "Na_palik", "Ni_palik", "V_palik"),
        *(f"{name}{source}" for name in _MEASURED_TWICE for source in ("", "_palik")),
    )
)
# Mitsuba's indices of refraction by name.
INDICES = {
    **{"vacuum": 1.0, "helium": 1.000036, "hydrogen": 1.000132, "air": 1.000277},
    **{"carbon dioxide": 1.00045, "water": 1.333, "acetone": 1.36, "ethanol": 1.361},
    **{"carbon tetrachloride": 1.461, "glycerol": 1.4729, "benzene": 1.501},
    **{"silicone oil": 1.52045, "bromine": 1.661, "water ice": 1.31, "fused quartz": 1.458},
    **{"pyrex": 1.47, "acrylic glass": 1.49, "polypropylene": 1.49, "bk7": 1.5046},
    **{"sodium chloride": 1.544, "amber": 1.55, "pet": 1.575, "diamond": 2.419},
}


@dataclasses.dataclass(frozen=True, kw_only=True)
class Texture:
    """An image over texture coordinates.

    Attributes:
        image: index of the image in the geometry.
        raw: whether its numbers are linear; else 8 bits are encoded by sRGB.
        filter_type: how values between pixels are found.
        wrap_mode: what lies beyond the sides of the image.
        to_uv: [4][4] affine map from the mesh's texture coordinates to the image's.
    """

    image: int
    raw: bool
    filter_type: Literal["bilinear", "nearest"] = "bilinear"
    wrap_mode: Literal["repeat", "mirror", "clamp"] = "repeat"
    to_uv: Matrix = _IDENTITY

    def linear(self, images: Sequence[Image]) -> NDArray[np.float32]:
        """Linear values [H, W, C] of its image, of the images of the geometry."""
        image = images[self.image]
        if image.dtype != np.uint8:
            return image.astype(np.float32, copy=False)
        values = image / np.float32(255)
        return values if self.raw else linear_from_srgb(values)


@dataclasses.dataclass(frozen=True)
class VertexColours:
    """The linear colours of a mesh's vertices, which have this name."""

    attribute: Literal["vertex_color"] = VERTEX_COLOUR


@dataclasses.dataclass(frozen=True)
class ImageFacts:
    """Properties of an image that textures depend on.

    Attributes:
        sides: height and width.
        channels: 1, 3 or 4.
        values: least and largest value, without the fourth channel; 8 bits are 0 to 1.
    """

    sides: tuple[int, int]
    channels: int
    values: Range

    @classmethod
    def of(cls, image: Image) -> "ImageFacts":
        """Facts of an image [H, W, C] that is not empty."""
        colours, unit = image[..., :3], 255 if image.dtype == np.uint8 else 1
        values = (float(colours.min()) / unit, float(colours.max()) / unit)
        return cls((image.shape[0], image.shape[1]), image.shape[2], values)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Kind:
    """Values that a parameter may have.

    Attributes:
        range: of a number.
        names: texts that are accepted in place of a number.
        colour: largest channel of a colour; None if it may not be a colour.
        boolean: whether it is true or false.
        image: range of the values of an image; None if it may not be a texture.
        channels: that an image may have.
        vertex_colours: whether colours of vertices may be used.
    """

    range: Range | None = None
    names: frozenset[str] = frozenset()
    colour: float | None = None
    boolean: bool = False
    image: Range | None = None
    channels: tuple[int, ...] = (1, 3, 4)
    vertex_colours: bool = False

    def __str__(self) -> str:
        forms = []
        if self.range is not None:
            forms.append(f"a number from {self.range[0]:g} to {self.range[1]:g}")
        if self.colour is not None:
            forms.append(f"three numbers from 0 to {self.colour:g}")
        if self.names:
            forms.append(f"a name such as {min(self.names)!r}")
        if self.boolean:
            forms.append("true or false")
        if self.image is not None:
            low, high = self.image
            channels = "" if 1 in self.channels else " of three or four channels"
            forms.append(f"an image{channels} of values from {low:g} to {high:g}")
        if self.vertex_colours:
            forms.append("the colours of the vertices")
        return " or ".join(forms)

    def check(self, what: str, value: object, images: Sequence[ImageFacts]) -> None:
        """Refuse a value that is none of these; `what` names it in the message."""
        found = shown(value, 60)
        match value:
            case bool():
                accepted = self.boolean
            case str():
                accepted = value in self.names
            case int() | float():
                accepted = self.range is not None and self.range[0] <= value <= self.range[1]
            case (_, _, _):
                accepted = self.colour is not None and all(
                    type(each) in (int, float) and 0 <= each <= self.colour for each in value
                )
            case VertexColours():
                accepted, found = self.vertex_colours, "the colours of the vertices"
            case Texture(image=index) if not 0 <= index < len(images):
                accepted, found = False, f"a texture of image {index} of {len(images)}"
            case Texture() if not np.abs(np.array(value.to_uv)).max() <= _MAX_TRANSFORM:
                accepted, found = False, f"a texture whose to_uv exceeds {_MAX_TRANSFORM:g}"
            case Texture():
                image = images[value.image]
                accepted = (
                    self.image is not None
                    and image.channels in self.channels
                    and _within(image.values, self.image)
                )
                least, largest = image.values
                found = f"an image of {image.channels} channels, {least:.4g} to {largest:.4g}"
            case _:
                accepted = False
        if not accepted:
            raise LumitreeError(f"{what} is {found}; expected {self}")


_FULL: Range = (0.0, _MAX_COLOUR)
_SIGNED: Range = (-_MAX_COLOUR, _MAX_COLOUR)
Flag = Annotated[bool, Kind(boolean=True)]
Number = Annotated[float | Texture, Kind(range=_UNIT, image=_UNIT)]
Colour = Annotated[
    float | RGB | Texture | VertexColours,
    Kind(colour=1, range=_UNIT, image=_UNIT, vertex_colours=True),
]
# Mitsuba needs the mean reflectance of a plastic, which it does not have of colours of vertices.
PlasticColour = Annotated[float | RGB | Texture, Kind(colour=1, range=_UNIT, image=_UNIT)]
MetalColour = Annotated[
    float | RGB | Texture | VertexColours,
    Kind(colour=_MAX_COLOUR, range=_FULL, image=_FULL, vertex_colours=True),
]
Index = Annotated[float | str, Kind(range=(0.1, 10), names=frozenset(INDICES))]
Eta = Annotated[float, Kind(range=(1.001, 10))]
Alpha = Annotated[float | Texture, Kind(range=(1e-4, 2), image=(0, 2))]
Distribution = Annotated[str, Kind(names=frozenset(("ggx", "beckmann")))]
DiffuseTransmission = Annotated[float | Texture, Kind(range=(0, 2), image=(0, 2))]
# Radiance of a shape, W/(m² sr). Mitsuba cannot sample an emitter by colours of vertices.
Radiance = float | RGB | Texture
_RADIANCE = Kind(colour=_MAX_RADIANCE, range=(0, _MAX_RADIANCE), image=(0, _MAX_RADIANCE))
# A parameter of any material.
Parameter = bool | float | str | RGB | Texture | VertexColours


PLUGINS: "dict[str, type[Material]]" = {}


@typing.dataclass_transform(frozen_default=True, kw_only_default=True)
@dataclasses.dataclass(frozen=True, kw_only=True)
class Material:
    """A BSDF of Mitsuba: `plugin` is its name, and other attributes are its parameters.

    Its subclasses are frozen dataclasses; those with a plugin are in `PLUGINS`.

    Attributes:
        nested: the materials that it modifies, `num_nested` of them.
    """

    plugin: ClassVar[str]
    num_nested: ClassVar[tuple[int, ...]]
    nested: tuple["Material", ...] = ()

    def __init_subclass__(cls, plugin: str = "", num_nested: tuple[int, ...] = (0,)) -> None:
        dataclasses.dataclass(frozen=True, kw_only=True)(cls)
        if plugin:
            cls.plugin, cls.num_nested, PLUGINS[plugin] = plugin, num_nested, cls

    @classmethod
    def of_table(cls, values: object, name: str) -> "Material":
        """The material of a table of a file, which has the plugin as "type"; checked later."""
        plugin = values.get("type") if isinstance(values, dict) else None
        if not isinstance(values, dict) or not isinstance(plugin, str) or plugin not in PLUGINS:
            raise LumitreeError(f"{name} has the type {shown_value(plugin)}, which is not stored")
        parameters = {key: value for key, value in values.items() if key != "type"}
        return object_of(parameters, PLUGINS[plugin], name)

    @property
    def parameters(self) -> dict[str, Parameter]:
        """The parameters that are given, by name."""
        found = {name: getattr(self, name) for name in parameter_kinds(type(self))}
        return {name: value for name, value in found.items() if value is not None}


class Diffuse(Material, plugin="diffuse"):
    """A Lambertian reflector."""

    reflectance: Colour | None = None


class Glass(Material):
    """Parameters that all glass has; its normals point to the side of `ext_ior`."""

    int_ior: Index | None = None
    ext_ior: Index | None = None
    specular_reflectance: Colour | None = None
    specular_transmittance: Colour | None = None


class Microfacets(Material):
    """Parameters of rough glass and metal: `alpha`, or one along u and one along v."""

    distribution: Distribution | None = None
    sample_visible: Flag | None = None
    alpha: Alpha | None = None
    alpha_u: Alpha | None = None
    alpha_v: Alpha | None = None


class Dielectric(Glass, plugin="dielectric"):
    """Clear glass."""


class ThinDielectric(Glass, plugin="thindielectric"):
    """A clear sheet, with the reflections between its two sides."""


class RoughDielectric(Microfacets, Glass, plugin="roughdielectric"):
    """Frosted glass."""


class Metal(Material):
    """Parameters that all metals have: a measured `material`, or `eta` and `k`."""

    material: Annotated[str, Kind(names=CONDUCTORS)] | None = None
    eta: MetalColour | None = None
    k: MetalColour | None = None
    specular_reflectance: Colour | None = None


class Conductor(Metal, plugin="conductor"):
    """A smooth metal."""


class RoughConductor(Microfacets, Metal, plugin="roughconductor"):
    """A rough metal."""


class Plastic(Material, plugin="plastic"):
    """A diffuse base below a smooth dielectric."""

    int_ior: Index | None = None
    ext_ior: Index | None = None
    diffuse_reflectance: PlasticColour | None = None
    specular_reflectance: PlasticColour | None = None
    nonlinear: Flag | None = None


class RoughPlastic(Plastic, plugin="roughplastic"):
    """A diffuse base below a rough dielectric."""

    distribution: Distribution | None = None
    sample_visible: Flag | None = None
    alpha: Annotated[float, Kind(range=(1e-4, 2))] | None = None


class DisneyMaterial(Material):
    """Parameters that `principled` and `principledthin` share (Burley 2012)."""

    base_color: Colour | None = None
    eta: Eta | None = None
    roughness: Number | None = None
    anisotropic: Number | None = None
    spec_trans: Number | None = None
    sheen: Number | None = None
    sheen_tint: Number | None = None
    spec_tint: Number | None = None
    flatness: Number | None = None


class Principled(DisneyMaterial, plugin="principled"):
    """Disney's BSDF of a solid."""

    diffuse_reflectance_sampling_rate: Annotated[float, Kind(range=(0, 100))] | None = None
    metallic: Number | None = None
    clearcoat: Number | None = None
    clearcoat_gloss: Number | None = None
    specular: Annotated[float, Kind(range=(1e-6, 1))] | None = None


class PrincipledThin(DisneyMaterial, plugin="principledthin"):
    """Disney's BSDF of a sheet."""

    diff_trans: DiffuseTransmission | None = None
    diffuse_reflectance_sampling_rate: Annotated[float, Kind(range=(1e-3, 100))] | None = None


class MetallicRoughness(Material, plugin="lumitree_metallic_roughness"):
    """The material of glTF 2.0, and its defaults; `lamp.metallic_roughness` renders it."""

    base_color: Colour = 0.5
    metallic: Number = 0.0
    roughness: Number = 0.5
    anisotropic: Number = 0.0
    eta: Eta = 1.5
    specular: Number = 1.0
    sheen: Number = 0.0
    clearcoat: Number = 0.0
    clearcoat_roughness: Number = 0.0
    spec_trans: Number = 0.0
    diff_trans: DiffuseTransmission = 0.0
    thin: Flag = False


class Mask(Material, plugin="mask", num_nested=(1,)):
    """A material that is there with a probability of `opacity`; light crosses the rest."""

    opacity: Number | None = None


class TwoSided(Material, plugin="twosided", num_nested=(1, 2)):
    """A material on both sides of a surface, or one on each."""


class NormalMap(Material, plugin="normalmap", num_nested=(1,)):
    """A material with shading normals from an image."""

    normalmap: Annotated[Texture, Kind(image=_SIGNED, channels=(3, 4))]


class BumpMap(Material, plugin="bumpmap", num_nested=(1,)):
    """A material with shading normals from an image of heights."""

    bumpmap: Annotated[Texture, Kind(image=_SIGNED)]
    scale: Annotated[float, Kind(range=(-1e4, 1e4))] | None = None


class Blend(Material, plugin="blendbsdf", num_nested=(2,)):
    """A mixture of two materials; `weight` is the part of the second."""

    weight: Number


@functools.cache
def parameter_kinds(plugin: type[Material]) -> dict[str, Kind]:
    """Values that the parameters of a material may have, by name."""
    found = {}
    for name, hint in typing.get_type_hints(plugin, include_extras=True).items():
        for each in (hint, *typing.get_args(hint)):
            if isinstance(kind := getattr(each, "__metadata__", (None,))[0], Kind):
                found[name] = kind
    return found


def make_material(
    plugin: str, parameters: Mapping[str, Parameter], nested: Sequence[Material] = ()
) -> Material:
    """A material of a plugin, for `check_material`; refuses parameters that it does not have."""
    if (made := PLUGINS.get(plugin)) is None:
        raise LumitreeError(f"a material has the type {shown(plugin, 60)!r}, which is not stored")
    kinds = parameter_kinds(made)
    for name in parameters:
        if name not in kinds:
            raise LumitreeError(f"{plugin} has a parameter {shown(name, 60)!r} that is not stored")
    for field in dataclasses.fields(made):
        if field.default is dataclasses.MISSING and field.name not in parameters:
            raise LumitreeError(f"{plugin} has no {field.name}; expected {kinds[field.name]}")
    return made(**parameters, nested=tuple(nested))


def check_material(material: Material, images: Sequence[ImageFacts], nesting: int = 1) -> None:
    """Refuse a material that could not be rendered.

    Args:
        material: of types that are not checked yet.
        images: that textures may refer to.
        nesting: 1, or more for a material within others.

    Raises:
        LumitreeError: says what was found, and what is expected.
    """
    name, nested = material.plugin, material.nested
    if nesting > MAX_NESTING:
        raise LumitreeError(f"materials are nested more than {MAX_NESTING} deep")
    if len(nested) not in material.num_nested:
        expected = material.num_nested[0]
        raise LumitreeError(f"{name} has {len(nested)} nested materials, expected {expected}")
    for each in nested:
        check_material(each, images, nesting + 1)
    if isinstance(material, TwoSided) and any(map(transmits, nested)):
        raise LumitreeError(
            "twosided has a nested material that light crosses, such as glass or a mask; put the "
            "mask around it, and leave it out around glass"
        )
    kinds = parameter_kinds(type(material))
    for key, value in material.parameters.items():
        kinds[key].check(f"{key} of {name}", value, images)
    _check_combinations(material, images)


def check_radiance(radiance: Radiance, images: Sequence[ImageFacts]) -> None:
    """Refuse what is not the radiance of an emitter, W/(m² sr): a colour or a texture."""
    _RADIANCE.check("radiance", radiance, images)


def is_specular(material: Material) -> bool:
    """Whether it reflects and transmits without scattering, so that an image is seen through it."""
    match material:
        case Dielectric() | ThinDielectric() | Conductor():
            return True
        case BumpMap():
            return False
        case _:
            return bool(material.nested) and all(map(is_specular, material.nested))


def transmits(material: Material) -> bool:
    """Whether Mitsuba says that light crosses a surface of a material."""
    match material:
        case Glass() | PrincipledThin() | Mask():
            return True
        case Principled():
            return _occurs(material.spec_trans)
        case MetallicRoughness():
            diffuse = material.thin and _occurs(material.diff_trans)
            return diffuse or _occurs(material.spec_trans)
        case TwoSided():
            return False
        case _:
            return any(map(transmits, material.nested))


def places_on_image(to_uv: Matrix, texcoords: NDArray[np.floating]) -> NDArray[np.float64]:
    """Places [N, 2] on an image, of texture coordinates [N, 2]; `to_uv` as of `Texture`."""
    matrix = np.array(to_uv, np.float64)
    return texcoords @ matrix[:2, :2].T + matrix[:2, 3]


def textures_of(*values: object) -> Iterator[Texture | VertexColours]:
    """The textures among parameters and materials, also of nested materials."""
    for value in values:
        if isinstance(value, Material):
            yield from textures_of(*value.parameters.values(), *value.nested)
        elif isinstance(value, Texture | VertexColours):
            yield value


def check_surface(
    material: Material,
    radiance: Radiance | None,
    mesh: Mapping[str, NDArray[np.generic]],
    images: Sequence[ImageFacts],
) -> None:
    """Refuse the arrays of a shape if its textures cannot be looked up with them.

    Args:
        material, radiance: of the shape, checked.
        mesh: arrays by name as of `AssetGeometry`, those that it has; {} for no mesh.
        images: of the geometry.
    """
    textures = list(textures_of(material, radiance))
    if VertexColours() in textures:
        colours = mesh.get("colours", np.zeros(0))
        if not len(colours):
            raise LumitreeError("it has no colours of vertices, which its material uses")
        values = float(colours.min()), float(colours.max())
        if not _within(values, _UNIT):
            raise LumitreeError(
                f"its colours of vertices are {values[0]:.4g} to {values[1]:.4g}; expected 0 to 1"
            )
    coordinates = mesh.get("texcoords", np.zeros((0, 2)))
    for texture in textures:
        if isinstance(texture, Texture):
            # A shape without coordinates has Mitsuba's, from 0 to 1.
            largest = np.abs(coordinates).max(axis=0) if len(coordinates) else np.ones(2)
            check_coordinates(texture, images, largest)


def check_coordinates(
    texture: Texture, images: Sequence[ImageFacts], coordinates: NDArray[np.floating]
) -> None:
    """Refuse texture coordinates at which Mitsuba cannot look up an image.

    `coordinates` are the largest absolute values of u and of v; `texture` is valid.
    """
    matrix = np.abs(np.array(texture.to_uv, np.float64))
    height, width = images[texture.image].sides
    pixels = (matrix[:2, :2] @ coordinates + matrix[:2, 3]) * [width, height]
    if not (pixels <= _MAX_PIXEL_COORDINATE).all():
        raise LumitreeError(
            f"texture coordinates reach {pixels.max():.3g} pixels of an image; expected at most "
            f"{_MAX_PIXEL_COORDINATE} (2^30)"
        )


def _occurs(value: float | Texture | None) -> bool:
    return value not in (None, 0)


def _within(values: Range, expected: Range) -> bool:
    """Whether least and largest value of an image, or of colours, are in a range."""
    low, high = expected
    return low <= values[0] and values[1] <= high * (1 + _ROUNDING)


def _check_combinations(material: Material, images: Sequence[ImageFacts]) -> None:
    """Refuse parameters with which together Mitsuba does not make the BSDF, or gives NaN."""
    name, given = material.plugin, material.parameters.keys()
    exclusive = [("alpha", "alpha_u"), ("alpha", "alpha_v")]
    if isinstance(material, Principled):
        exclusive.append(("eta", "specular"))
    if isinstance(material, Metal) and material.material != "none":
        exclusive += [("material", "eta"), ("material", "k")]
    for first, second in exclusive:
        if {first, second} <= given:
            raise LumitreeError(f"{name} has {first} and {second}; expected one of them")
    if ("alpha_u" in given) != ("alpha_v" in given):
        raise LumitreeError(f"{name} has one of alpha_u and alpha_v; expected both or none")
    match material:
        case RoughDielectric():
            inside, outside = _indices(material, "bk7")
            if inside == outside:
                raise LumitreeError(f"{name} has an int_ior equal to its ext_ior")
        case Plastic():
            inside, outside = _indices(material, "polypropylene")
            # Mitsuba's fit of the diffuse reflectance inside is above 1 from a ratio of 3.8.
            densest = math.inf if isinstance(material, RoughPlastic) else 3.0
            if not outside < inside <= densest * outside:
                raise LumitreeError(
                    f"{name} has int_ior {inside:g} and ext_ior {outside:g}; expected int_ior "
                    f"above ext_ior, and at most {densest:g} times it"
                )
            _, diffuse = _bounds(material.diffuse_reflectance, 0.5, images)
            _, specular = _bounds(material.specular_reflectance, 1.0, images)
            if max(diffuse.max(), specular.max()) < _BLACK:
                raise LumitreeError(f"{name} reflects nothing; expected a reflectance above 0")
        case Metal() if material.material in (None, "none"):
            eta, _ = _bounds(material.eta, 0.0, images)
            k, _ = _bounds(material.k, 1.0, images)
            if np.maximum(eta, k).min() < _BLACK:
                raise LumitreeError(f"{name} has eta and k of 0; expected one of them above 0")
        case _:
            pass


def _indices(material: RoughDielectric | Plastic, inside: str) -> tuple[np.float32, np.float32]:
    """Both indices of refraction, as Mitsuba compares them, in single precision."""
    given = (material.int_ior or inside, material.ext_ior or "air")
    first, second = (np.float32(INDICES[n] if isinstance(n, str) else n) for n in given)
    return first, second


def _bounds(
    value: Parameter | None, default: float, images: Sequence[ImageFacts]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Least and largest value of each channel [3] of a parameter."""
    match value:
        case Texture():
            bounds = images[value.image].values
        case VertexColours():
            bounds = _UNIT
        case _:
            bounds = (default, default) if value is None else (value, value)
    least, largest = (np.broadcast_to(np.asarray(each, np.float64), 3) for each in bounds)
    return least, largest
