"""The BSDF plugins of Mitsuba that the materials of an asset may be, and what each takes.

Ranges, and which parameters go together, are those with which Mitsuba makes the BSDF and its values
are finite and not negative. docs/format.md has the same rules in words.
"""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

from lumitree.asset.measured import CONDUCTORS, INDICES
from lumitree.asset.textures import ImageFacts, Range, TextureKind

_MAX_COLOUR, _MAX_RADIANCE = 1e4, 1e15


@dataclasses.dataclass(frozen=True)
class Kind:
    """Values that a parameter may have.

    Attributes:
        range: of a number.
        names: texts that are accepted in place of a number.
        colour: largest channel of a colour; None if it may not be a colour.
        texture: which textures it may be; None for none.
    """

    range: Range | None = None
    names: frozenset[str] = frozenset()
    colour: float | None = None
    texture: TextureKind | None = None
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
        if self.texture is not None:
            forms.append(str(self.texture))
        return " or ".join(forms)

    def accepts(self, value: Any, images: Sequence[ImageFacts]) -> bool:
        """Whether a value, as `json.loads` returns it, is one of these; a wrong texture raises."""
        if isinstance(value, bool):
            return self.boolean
        if isinstance(value, str):
            return value in self.names
        if isinstance(value, int | float):
            return self.range is not None and self.range[0] <= value <= self.range[1]
        if isinstance(value, list):
            return self.colour is not None and _is_colour(value, self.colour)
        if isinstance(value, dict) and self.texture is not None:
            self.texture.check(value, images)
            return True
        return False


@dataclasses.dataclass(frozen=True)
class Plugin:
    """Parameters that Mitsuba accepts together.

    Attributes:
        parameters: by name.
        nested: how many materials it may hold.
        required: parameters without which Mitsuba does not make it.
        exclusive: pairs of parameters of which only one may be given.
        together: pairs of parameters of which both or none must be given.
        indices: relation of `int_ior` and `ext_ior`, and the name of the default of `int_ior`.
        densest: largest ratio of `int_ior` and `ext_ior`, where there is a relation.
        not_both_black: two parameters with their defaults, of which one must be above 0; and
            whether in each channel and pixel, rather than in the brightest one.
        transmits: whether light crosses its surface; None if what it holds decides.
    """

    parameters: dict[str, Kind]
    nested: tuple[int, ...] = (0,)
    required: tuple[str, ...] = ()
    exclusive: tuple[tuple[str, str], ...] = ()
    together: tuple[tuple[str, str], ...] = ()
    indices: tuple[str, str] | None = None
    densest: float = math.inf
    not_both_black: tuple[tuple[str, float], tuple[str, float], bool] | None = None
    transmits: bool | None = False


_VALUE = Kind(range=(0, 1), texture=TextureKind((0, 1)))
# Mitsuba needs the mean of what a plastic reflects, which it does not know of colours of vertices.
_PRINTED = Kind(colour=1, range=(0, 1), texture=TextureKind((0, 1)))
_COLOUR = Kind(colour=1, range=(0, 1), texture=TextureKind((0, 1), vertex_colours=True))
_INDEX = Kind(range=(0.1, 10), names=frozenset(INDICES))
_ROUGH = Kind(range=(1e-4, 2), texture=TextureKind((0, 2)))
_FLAG = Kind(boolean=True)
_METAL = Kind(
    colour=_MAX_COLOUR,
    range=(0, _MAX_COLOUR),
    texture=TextureKind((0, _MAX_COLOUR), vertex_colours=True),
)
_MICROFACETS = Kind(names=frozenset(("ggx", "beckmann")))
# Mitsuba cannot sample an emitter whose radiance is given at its vertices.
RADIANCE = Kind(
    colour=_MAX_RADIANCE, range=(0, _MAX_RADIANCE), texture=TextureKind((0, _MAX_RADIANCE))
)
_HEIGHTS = Kind(texture=TextureKind((-_MAX_COLOUR, _MAX_COLOUR)))
_NORMALS = Kind(texture=TextureKind((-_MAX_COLOUR, _MAX_COLOUR), channels=(3, 4)))

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
    "material": Kind(names=CONDUCTORS),
    "eta": _METAL,
    "k": _METAL,
    "specular_reflectance": _COLOUR,
}
_PLASTIC = {
    "int_ior": _INDEX,
    "ext_ior": _INDEX,
    "diffuse_reflectance": _PRINTED,
    "specular_reflectance": _PRINTED,
    "nonlinear": _FLAG,
}
_PRINCIPLED = {
    "base_color": _COLOUR,
    "eta": Kind(range=(1.001, 10)),
    "diffuse_reflectance_sampling_rate": Kind(range=(0, 100)),
    **dict.fromkeys(
        ("roughness", "anisotropic", "spec_trans", "sheen", "sheen_tint", "spec_tint", "flatness"),
        _VALUE,
    ),
}
_ALPHAS: dict[str, Any] = {
    "exclusive": (("alpha", "alpha_u"), ("alpha", "alpha_v")),
    "together": (("alpha_u", "alpha_v"),),
}
_OF_METAL = (("eta", 0.0), ("k", 1.0), True)
_OF_PLASTIC = (("diffuse_reflectance", 0.5), ("specular_reflectance", 1.0), False)

PLUGINS: dict[str, Plugin] = {
    "diffuse": Plugin({"reflectance": _COLOUR}),
    "dielectric": Plugin(_GLASS, transmits=True),
    "thindielectric": Plugin(_GLASS, transmits=True),
    "roughdielectric": Plugin(
        {**_GLASS, **_ROUGHNESS}, **_ALPHAS, indices=("!=", "bk7"), transmits=True
    ),
    "conductor": Plugin(_CONDUCTOR, not_both_black=_OF_METAL),
    "roughconductor": Plugin({**_CONDUCTOR, **_ROUGHNESS}, **_ALPHAS, not_both_black=_OF_METAL),
    # Mitsuba's fit of the diffuse reflectance inside is above 1 from a ratio of 3.8.
    "plastic": Plugin(
        _PLASTIC, indices=(">", "polypropylene"), densest=3, not_both_black=_OF_PLASTIC
    ),
    "roughplastic": Plugin(
        {**_PLASTIC, **{n: _ROUGHNESS[n] for n in ("distribution", "sample_visible")}}
        | {"alpha": Kind(range=(1e-4, 2))},
        indices=(">", "polypropylene"),
        not_both_black=_OF_PLASTIC,
    ),
    "principled": Plugin(
        {
            **_PRINCIPLED,
            **dict.fromkeys(("metallic", "clearcoat", "clearcoat_gloss"), _VALUE),
            "specular": Kind(range=(1e-6, 1)),
        },
        exclusive=(("eta", "specular"),),
        transmits=None,
    ),
    "principledthin": Plugin(
        {
            **_PRINCIPLED,
            "diff_trans": Kind(range=(0, 2), texture=TextureKind((0, 2))),
            "diffuse_reflectance_sampling_rate": Kind(range=(1e-3, 100)),
        },
        transmits=True,
    ),
    "lumitree_metallic_roughness": Plugin(
        {
            "base_color": _COLOUR,
            "eta": Kind(range=(1.001, 10)),
            "thin": _FLAG,
            "diff_trans": Kind(range=(0, 2), texture=TextureKind((0, 2))),
            **dict.fromkeys(
                (
                    "metallic",
                    "roughness",
                    "anisotropic",
                    "specular",
                    "spec_trans",
                    "clearcoat",
                    "clearcoat_roughness",
                    "sheen",
                ),
                _VALUE,
            ),
        },
        transmits=None,
    ),
    "mask": Plugin({"opacity": _VALUE}, (1,), transmits=True),
    "twosided": Plugin({}, (1, 2)),
    "normalmap": Plugin({"normalmap": _NORMALS}, (1,), ("normalmap",), transmits=None),
    "bumpmap": Plugin(
        {"bumpmap": _HEIGHTS, "scale": Kind(range=(-1e4, 1e4))}, (1,), ("bumpmap",), transmits=None
    ),
    "blendbsdf": Plugin({"weight": _VALUE}, (2,), ("weight",), transmits=None),
}


def _is_colour(value: list[Any], largest: float) -> bool:
    return len(value) == 3 and all(
        type(channel) in (int, float) and 0 <= channel <= largest for channel in value
    )
