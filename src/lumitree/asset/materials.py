"""The materials that the model of an asset may have: BSDF plugins of Mitsuba by an allow-list.

A material is a JSON object: `type` names a plugin, `nested` holds the materials that it modifies,
and all other members are parameters of the plugin. A parameter is a number, true or false, a name
from a list, an RGB colour, or a texture:

    {"image": 0, "raw": true, "filter_type": "bilinear", "wrap_mode": "repeat", "to_uv": [[...]]}
    {"attribute": "vertex_color"}

No parameter names a file. Lists and ranges are those with which the plugins are known to work.
"""

import dataclasses
from typing import Any

import numpy as np

from lumitree.core.reading import Record
from lumitree.errors import LumitreeError, shown

Json = dict[str, Any]

# A two-sided material is built from two copies of the one that it holds.
MAX_NESTING = 8
# The mesh attribute of vertex colours.
VERTEX_COLOUR = "vertex_color"
_MAX_COLOUR, _MAX_RADIANCE = 1e4, 1e15
# Names of Mitsuba's measured conductors; those of the first group come from two sources.
_MEASURED_TWICE = (
    *("AlAs", "AlSb", "Be", "CsI", "Cu", "Cu2O", "CuO", "d-C", "Hg", "HgTe", "Ir", "K", "Li"),
    *("MgO", "Mo", "Nb", "Rh", "Se", "Se-e", "SiC", "SnTe", "Ta", "Te", "Te-e", "ThF4", "TiC"),
    *("TiN", "TiO2", "TiO2-e", "VC", "VN"),
)
CONDUCTORS = frozenset(
    (
        *("none", "a-C", "Ag", "Al", "Au", "Cr", "W", "Na_palik", "Ni_palik", "V_palik"),
        *(f"{name}{source}" for name in _MEASURED_TWICE for source in ("", "_palik")),
    )
)
# Names of its indices of refraction.
_TRANSPARENT = frozenset(
    (
        *("vacuum", "helium", "hydrogen", "air", "carbon dioxide", "water", "acetone", "ethanol"),
        *("carbon tetrachloride", "glycerol", "benzene", "silicone oil", "bromine", "water ice"),
        *("fused quartz", "pyrex", "acrylic glass", "polypropylene", "bk7", "sodium chloride"),
        *("amber", "pet", "diamond"),
    )
)


@dataclasses.dataclass(frozen=True)
class _Kind:
    """What a parameter may be.

    Attributes:
        range: of a number.
        names: texts that are accepted in place of a number.
        colour: largest channel of a colour; None if it may not be a colour.
        texture: whether it may be a texture.
    """

    range: tuple[float, float] | None = None
    names: frozenset[str] = frozenset()
    colour: float | None = None
    texture: bool = False
    boolean: bool = False

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
        if self.texture:
            forms.append("a texture")
        return " or ".join(forms)

    def accepts(self, value: Any, num_images: int) -> bool:
        """Whether a value, as `json.loads` returns it, is one of these."""
        if isinstance(value, bool):
            return self.boolean
        if isinstance(value, str):
            return value in self.names
        if isinstance(value, int | float):
            return self.range is not None and self.range[0] <= value <= self.range[1]
        if isinstance(value, list):
            return self.colour is not None and _is_colour(value, self.colour)
        if isinstance(value, dict) and self.texture:
            check_texture(value, num_images)
            return True
        return False


_VALUE = _Kind(range=(0, 1), texture=True)
_COLOUR = _Kind(colour=1, texture=True, range=(0, 1))
_INDEX = _Kind(range=(0.1, 10), names=_TRANSPARENT)
_ROUGH = _Kind(range=(1e-4, 2), texture=True)
_FLAG = _Kind(boolean=True)
_METAL = _Kind(colour=_MAX_COLOUR, range=(0, _MAX_COLOUR), texture=True)
_MICROFACETS = _Kind(names=frozenset(("ggx", "beckmann")))
_RADIANCE = _Kind(colour=_MAX_RADIANCE, range=(0, _MAX_RADIANCE), texture=True)
_IMAGE = _Kind(texture=True)

_GLASS = {
    "int_ior": _INDEX,
    "ext_ior": _INDEX,
    "specular_reflectance": _COLOUR,
    "specular_transmittance": _COLOUR,
}
_ROUGHNESS = {
    "distribution": _MICROFACETS,
    "sample_visible": _FLAG,
    "alpha": _ROUGH,
    "alpha_u": _ROUGH,
    "alpha_v": _ROUGH,
}
_CONDUCTOR = {
    "material": _Kind(names=CONDUCTORS),
    "eta": _METAL,
    "k": _METAL,
    "specular_reflectance": _COLOUR,
}
_PLASTIC = {
    "int_ior": _INDEX,
    "ext_ior": _INDEX,
    "diffuse_reflectance": _COLOUR,
    "specular_reflectance": _COLOUR,
    "nonlinear": _FLAG,
}
_PRINCIPLED = {
    "base_color": _COLOUR,
    "eta": _Kind(range=(1.001, 10)),
    "diffuse_reflectance_sampling_rate": _Kind(range=(0, 100)),
    **dict.fromkeys(
        ("roughness", "anisotropic", "spec_trans", "sheen", "sheen_tint", "spec_tint", "flatness"),
        _VALUE,
    ),
}

# Parameters by plugin, and how many materials each may hold.
_PLUGINS: dict[str, dict[str, _Kind]] = {
    "diffuse": {"reflectance": _COLOUR},
    "dielectric": _GLASS,
    "thindielectric": _GLASS,
    "roughdielectric": {**_GLASS, **_ROUGHNESS},
    "conductor": _CONDUCTOR,
    "roughconductor": {**_CONDUCTOR, **_ROUGHNESS},
    "plastic": _PLASTIC,
    "roughplastic": {**_PLASTIC, **{n: _ROUGHNESS[n] for n in ("distribution", "sample_visible")}}
    | {"alpha": _Kind(range=(1e-4, 2))},
    "principled": {
        **_PRINCIPLED,
        **dict.fromkeys(("metallic", "clearcoat", "clearcoat_gloss"), _VALUE),
        "specular": _Kind(range=(0, 1)),
    },
    "principledthin": {**_PRINCIPLED, "diff_trans": _Kind(range=(0, 2), texture=True)},
    "mask": {"opacity": _VALUE},
    "twosided": {},
    "normalmap": {"normalmap": _IMAGE},
    "bumpmap": {"bumpmap": _IMAGE, "scale": _Kind(range=(-1e4, 1e4))},
    "blendbsdf": {"weight": _VALUE},
}
_NESTED = {"mask": (1,), "twosided": (1, 2), "normalmap": (1,), "bumpmap": (1,), "blendbsdf": (2,)}


def check_material(material: Any, num_images: int, nesting: int = 1) -> None:
    """Refuse a material that is not as the module describes.

    Args:
        material: as `json.loads` returns it.
        num_images: number of images that textures may refer to.
        nesting: 1, or more for a material within others.

    Raises:
        LumitreeError: says what was found, and what is expected.
    """
    record = Record(material, "a material")
    plugin = record.choice("type", tuple(_PLUGINS))
    if nesting > MAX_NESTING:
        raise LumitreeError(f"materials are nested more than {MAX_NESTING} deep")
    counts = _NESTED.get(plugin, (0,))
    inner = record.items("nested") if record.has("nested") else []
    if len(inner) not in counts:
        raise LumitreeError(f"{plugin} holds {len(inner)} materials, expected {counts[0]}")
    for each in inner:
        check_material(each, num_images, nesting + 1)
    parameters = {name: material[name] for name in material if name not in ("type", "nested")}
    check_parameters(plugin, parameters, num_images)


def check_parameters(plugin: str, parameters: Json, num_images: int) -> None:
    """Refuse a plugin, or parameters of it, that are not in the lists."""
    if plugin not in _PLUGINS:
        known = ", ".join(_PLUGINS)
        raise LumitreeError(f"the BSDF {shown(plugin, 60)!r} cannot be stored; expected {known}")
    for name, value in parameters.items():
        kind = _PLUGINS[plugin].get(name)
        if kind is None:
            raise LumitreeError(f"{plugin} has a parameter {shown(name, 60)!r} that is not stored")
        if not kind.accepts(value, num_images):
            raise LumitreeError(f"{name} of {plugin} is {shown(value, 60)}; expected {kind}")


def check_radiance(value: Any, num_images: int) -> None:
    """Refuse what is not the radiance of an emitter, W/(m² sr): a colour or a texture."""
    if not _RADIANCE.accepts(value, num_images):
        raise LumitreeError(f"radiance is {shown(value, 60)}; expected {_RADIANCE}")


def check_texture(texture: Any, num_images: int) -> None:
    """Refuse what is not a texture, or refers to an image that does not exist."""
    record = Record(texture, "a texture")
    if record.has("attribute"):
        record.expect_keys("attribute")
        record.choice("attribute", (VERTEX_COLOUR,))
        return
    record.expect_keys("image", "raw", "filter_type", "wrap_mode", "to_uv")
    if not 0 <= record.integer("image") < num_images:
        raise LumitreeError(f"a texture has no image {record.integer('image')}")
    record.choice("filter_type", ("bilinear", "nearest"))
    record.choice("wrap_mode", ("repeat", "mirror", "clamp"))
    if not isinstance(texture["raw"], bool):
        raise LumitreeError(f"raw of a texture is {shown(texture['raw'], 60)}; expected a boolean")
    if np.abs(record.array("to_uv", 4, 4)).max() > _MAX_COLOUR:
        raise LumitreeError(f"to_uv of a texture exceeds {_MAX_COLOUR:g}")


def uses_vertex_colours(value: Any) -> bool:
    """Whether a material, or a parameter of one, refers to colours of a mesh's vertices."""
    if isinstance(value, dict):
        return "attribute" in value or any(map(uses_vertex_colours, value.values()))
    return isinstance(value, list) and any(map(uses_vertex_colours, value))


def is_specular(material: Json) -> bool:
    """Whether it reflects and transmits without scattering, so that an image is seen through it."""
    if material["type"] in ("dielectric", "thindielectric", "conductor"):
        return True
    inner = material.get("nested", [])
    return bool(inner) and material["type"] != "bumpmap" and all(map(is_specular, inner))


def _is_colour(value: list[Any], largest: float) -> bool:
    return len(value) == 3 and all(
        type(channel) in (int, float) and 0 <= channel <= largest for channel in value
    )
