"""The materials that the geometry of an asset may have: BSDF plugins of Mitsuba by an allow-list.

A material is a JSON object: `type` names a plugin, `nested` holds the materials that it modifies,
and all other members are parameters of the plugin. A parameter is a number, true or false, a name
from a list, an RGB colour, or a texture:

    {"image": 0, "raw": true, "filter_type": "bilinear", "wrap_mode": "repeat", "to_uv": [[...]]}
    {"attribute": "vertex_color"}

No parameter names a file. What is accepted can be rendered: Mitsuba makes the BSDF, and its values
are finite and not negative. docs/format.md has the same rules in words.
"""

import math
import operator
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.measured import INDICES
from lumitree.asset.plugins import PLUGINS, RADIANCE, Kind, Plugin
from lumitree.asset.textures import VERTEX_RANGE, ImageFacts, Json
from lumitree.core.reading import Record
from lumitree.errors import LumitreeError, shown

# A two-sided material is built from two copies of the one that it holds.
MAX_NESTING = 8
# Where both of two colours are darker than this, Mitsuba divides 0 by 0.
_BLACK = 1e-6
_RELATIONS: dict[str, Callable[[Any, Any], bool]] = {
    "!=": operator.ne,
    ">": operator.gt,
}


def check_material(material: Any, images: Sequence[ImageFacts], nesting: int = 1) -> None:
    """Refuse a material that is not as the module describes.

    Args:
        material: as `json.loads` returns it.
        images: that textures may refer to.
        nesting: 1, or more for a material within others.

    Raises:
        LumitreeError: says what was found, and what is expected.
    """
    record = Record(material, "a material")
    name = record.choice("type", tuple(PLUGINS))
    plugin = PLUGINS[name]
    if nesting > MAX_NESTING:
        raise LumitreeError(f"materials are nested more than {MAX_NESTING} deep")
    inner = record.items("nested") if record.has("nested") else []
    if len(inner) not in plugin.nested:
        raise LumitreeError(f"{name} holds {len(inner)} materials, expected {plugin.nested[0]}")
    for each in inner:
        check_material(each, images, nesting + 1)
    if name == "twosided" and any(map(transmits, inner)):
        raise LumitreeError(
            "twosided holds a material that light crosses, such as glass or a mask; put the mask "
            "around it, and leave it out around glass"
        )
    parameters = {name: material[name] for name in material if name not in ("type", "nested")}
    for key, value in parameters.items():
        if key not in plugin.parameters:
            raise LumitreeError(f"{name} has a parameter {shown(key, 60)!r} that is not stored")
        _check_value(f"{key} of {name}", plugin.parameters[key], value, images)
    _check_together(name, plugin, parameters)
    _check_values(name, plugin, parameters, images)


def check_radiance(value: Any, images: Sequence[ImageFacts]) -> None:
    """Refuse what is not the radiance of an emitter, W/(m² sr): a colour or a texture."""
    _check_value("radiance", RADIANCE, value, images)


def is_specular(material: Json) -> bool:
    """Whether it reflects and transmits without scattering, so that an image is seen through it."""
    if material["type"] in ("dielectric", "thindielectric", "conductor"):
        return True
    inner = material.get("nested", [])
    return bool(inner) and material["type"] != "bumpmap" and all(map(is_specular, inner))


def transmits(material: Json) -> bool:
    """Whether Mitsuba says that light crosses a surface of a material."""
    stated = PLUGINS[material["type"]].transmits
    if stated is not None:
        return stated
    inner = material.get("nested", [])
    diffuse = material.get("thin", False) and material.get("diff_trans", 0) != 0
    return diffuse or material.get("spec_trans", 0) != 0 or any(map(transmits, inner))


def _check_value(what: str, kind: Kind, value: Any, images: Sequence[ImageFacts]) -> None:
    try:
        accepted = kind.accepts(value, images)
    except LumitreeError as error:
        raise LumitreeError(f"{what}: {error}") from None
    if not accepted:
        raise LumitreeError(f"{what} is {shown(value, 60)}; expected {kind}")


def _check_together(name: str, plugin: Plugin, parameters: Json) -> None:
    """Refuse parameters that Mitsuba does not take together, or not without others."""
    for key in plugin.required:
        if key not in parameters:
            raise LumitreeError(f"{name} has no {key}; expected {plugin.parameters[key]}")
    for first, second in plugin.exclusive:
        if first in parameters and second in parameters:
            raise LumitreeError(f"{name} has {first} and {second}; expected one of them")
    for first, second in plugin.together:
        if (first in parameters) != (second in parameters):
            raise LumitreeError(f"{name} has one of {first} and {second}; expected both or none")
    if parameters.get("material", "none") != "none" and parameters.keys() & {"eta", "k"}:
        raise LumitreeError(f"{name} has a material and eta or k; expected one of them")


def _check_values(
    name: str, plugin: Plugin, parameters: Json, images: Sequence[ImageFacts]
) -> None:
    """Refuse values with which Mitsuba does not make the BSDF, or gives NaN."""
    if plugin.indices is not None:
        relation, default = plugin.indices
        inside = parameters.get("int_ior", default)
        outside = parameters.get("ext_ior", "air")
        # As Mitsuba compares them, in single precision.
        first, second = (np.float32(INDICES.get(each, each)) for each in (inside, outside))
        if not (_RELATIONS[relation](first, second) and first <= plugin.densest * second):
            most = "" if plugin.densest == math.inf else f", at most {plugin.densest:g} times it"
            raise LumitreeError(
                f"{name} has int_ior {inside} and ext_ior {outside}; expected int_ior {relation} "
                f"ext_ior{most}"
            )
    if plugin.not_both_black is not None and parameters.get("material", "none") == "none":
        *colours, everywhere = plugin.not_both_black
        bounds = [_bounds(parameters.get(key, default), images) for key, default in colours]
        if everywhere:
            lit = np.maximum(bounds[0][0], bounds[1][0]).min()
        else:
            lit = max(bounds[0][1].max(), bounds[1][1].max())
        if lit < _BLACK:
            (first, _), (second, _) = colours
            raise LumitreeError(
                f"{name} has {first} and {second} of 0; expected one of them above {_BLACK:g}"
            )


def _bounds(
    value: Any, images: Sequence[ImageFacts]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Least and largest value of each channel [3] of a parameter."""
    if isinstance(value, dict):
        least, largest = VERTEX_RANGE if "attribute" in value else images[value["image"]].values
        return np.full(3, least), np.full(3, largest)
    channels = np.broadcast_to(np.asarray(value, np.float64), 3)
    return channels, channels
