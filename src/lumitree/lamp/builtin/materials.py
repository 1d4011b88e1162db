"""Materials that the built-in lamps share."""

import dataclasses

from lumitree.lamp.parts import RGB, Diffuse, Glass, Material, Metal, Microfacets, Principled

# Rough surfaces of the built-in lamps keep the microfacets with which the lamps were measured.
BECKMANN: Microfacets = "beckmann"
GLASS = Material("glass", Glass(ior=1.5))
CRYSTAL = Material("crystal", Glass(ior=1.56))
WAX = Material("wax", Diffuse((0.82, 0.76, 0.64)))
OPAL_SHEET = Material(
    "opal_sheet",
    Principled((0.93, 0.88, 0.78), roughness=0.6, diffuse_transmission=1.1, thin=True),
)
# Gold with a darker tint: Mitsuba has no data for brass.
BRASS = Material("brass", Metal((0.95, 0.86, 0.86), 0.45, "Au", BECKMANN))
BRONZE = Material("bronze", Metal((0.3, 0.27, 0.25), 0.5, "Cu", BECKMANN))
BLACK_STEEL = Material("black", Metal((0.15, 0.14, 0.13), 0.55, "Cr", BECKMANN))
STEEL = Material("steel", Metal((1.0, 1.0, 1.0), 0.5, "Cr", BECKMANN))
TUNGSTEN = Material("tungsten", Metal((1.0, 1.0, 1.0), 0.55, "W", BECKMANN))


def emitting(material: Material, name: str, radiance: RGB) -> Material:
    """The material under another name, emitting `radiance`, W/(m² sr)."""
    return dataclasses.replace(material, name=name, radiance=radiance)
