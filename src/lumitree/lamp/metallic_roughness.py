"""The BSDF `lumitree_metallic_roughness`: surfaces of glTF and OBJ models.

It follows the metallic-roughness material of appendix B of the glTF 2.0 specification: a Lambertian
base under a dielectric layer of GGX microfacets, or a metal of such microfacets, both with
Schlick's Fresnel factor. Where the appendix leaves a choice it takes the models that conserve
energy and are reciprocal, which the appendix recommends (Kulla and Conty, 2017): the base gets the
light that the layer does not reflect, and light that microfacets scatter more than once is not
lost. A base colour of 1 therefore reflects everything, at any roughness.

Parameters are in [0, 1] unless stated, with their defaults; all but `eta` and `thin` may be
textures:

    base_color          colour of the base, of the metal, and of transmitted light (0.5)
    metallic            part of the surface that is metal (0)
    roughness           square root of the alpha of microfacets (0.5)
    anisotropic         stretches highlights as `principled` does (0). Scattering more than once is
                        compensated as for round highlights: up to a fifth of the light is lost
    eta                 index of refraction inside over the one outside, 1.001 to 10 (1.5)
    specular            factor on the reflection of the dielectric layer (1)
    spec_trans          part of the light below the layer that is transmitted (0). A solid refracts
                        it, and is tinted by the square root of `base_color` at each crossing
    thin                the surface is a sheet, which light crosses without refraction (false)
    diff_trans          twice the part of the base's light that leaves a sheet behind, in [0, 2] (0)
    clearcoat, clearcoat_roughness    a second dielectric layer, of index 1.5 (0)
    sheen               reflectance that the base gains at grazing angles, up to 1 (0)
"""

import importlib

from lumitree.core.backend import load_mitsuba

METALLIC_ROUGHNESS = "lumitree_metallic_roughness"
_registered: set[str] = set()


def register_metallic_roughness() -> None:
    """Register the BSDF with the variant of Mitsuba that is set; harmless when repeated."""
    mi = load_mitsuba()
    if mi.variant() in _registered:
        return
    # It imports Mitsuba, which a variant has to be set for.
    module = importlib.import_module("lumitree.lamp.metallic_roughness_bsdf")
    mi.register_bsdf(METALLIC_ROUGHNESS, module.metallic_roughness_class())
    _registered.add(mi.variant())
