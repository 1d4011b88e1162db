"""Numbers of Fresnel's equations for the materials of an asset's geometry."""

import mitsuba as mi
import numpy as np

from lumitree.asset.textures import Json


def relative_index(material: Json, default: float | None = None) -> float:
    """Index of refraction inside over that outside, of numbers or names."""
    inside, outside = material.get("int_ior", default), material.get("ext_ior")
    given = {"int_ior": inside, "ext_ior": outside}
    plugin = {name: value for name, value in given.items() if value is not None}
    return float(mi.traverse(mi.load_dict({"type": "dielectric", **plugin}))["eta"])


# Message of an export that has no such factors.
LOST_REFLECTANCE = "factors of what glass and plastic reflect are left out"


def has_reflectance_factor(material: Json) -> bool:
    """Whether a dielectric or a plastic reflects other than by Fresnel's equations."""
    if not material["type"].endswith(("dielectric", "plastic")):
        return False
    return material.get("specular_reflectance", 1.0) not in (1.0, [1.0, 1.0, 1.0])


def plastic_index(material: Json) -> float:
    """Index of refraction of the coat of a plastic; by default Mitsuba's."""
    return relative_index(material, default=1.49)


def principled_index(material: Json) -> float:
    """Index of refraction of a principled material, at least 1."""
    if "eta" in material:
        return float(material["eta"])
    # As Mitsuba has it: the reflectance at normal incidence is 8 % of `specular`.
    root = np.sqrt(0.08 * material.get("specular", 0.5))
    return max(float((1 + root) / (1 - root)), 1.0)


def clearcoat_roughness(material: Json) -> float:
    """Roughness of the clear coat of a principled material, the root of its alpha.

    A texture of the gloss counts as a gloss of 0.5.
    """
    gloss = material.get("clearcoat_gloss", 0.0)
    # As Mitsuba has it: alpha is 0.1 at gloss 0, and 0.001 at gloss 1.
    alpha = 0.1 - 0.099 * (0.5 if isinstance(gloss, dict) else gloss)
    return float(alpha**0.5)
