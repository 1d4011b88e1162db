"""A geometry with a shape of each material that an asset may have."""

import dataclasses

import numpy as np

from lumitree.asset.geometry import Medium
from lumitree.asset.materials import (
    Blend,
    BumpMap,
    Conductor,
    Dielectric,
    Diffuse,
    Mask,
    MetallicRoughness,
    NormalMap,
    Plastic,
    Principled,
    PrincipledThin,
    RoughConductor,
    RoughDielectric,
    RoughPlastic,
    ThinDielectric,
    TwoSided,
    VertexColours,
)
from support.geometry_assets import TEXTURE, small_geometry

DIFFUSE = Diffuse(reflectance=(0.1, 0.2, 0.3))
MATERIALS = (
    DIFFUSE,
    Diffuse(reflectance=TEXTURE),
    Dielectric(int_ior="bk7"),
    ThinDielectric(int_ior=1.4, ext_ior="air"),
    RoughDielectric(alpha=0.04),
    Conductor(material="Au"),
    RoughConductor(alpha_u=0.1, alpha_v=0.2, eta=0.2, k=(3.0, 2, 1)),
    RoughConductor(alpha=TEXTURE, specular_reflectance=TEXTURE),
    Plastic(diffuse_reflectance=TEXTURE),
    RoughPlastic(alpha=0.3, int_ior=1.6),
    Principled(base_color=(1.0, 0, 0), roughness=TEXTURE, specular=0.3),
    Principled(metallic=1.0, clearcoat=0.5, sheen=0.2, flatness=0.1),
    MetallicRoughness(base_color=TEXTURE, metallic=0.4),
    MetallicRoughness(thin=True, diff_trans=1.1, spec_trans=0.2),
    PrincipledThin(diff_trans=1.1, spec_trans=0.2),
    Mask(opacity=TEXTURE, nested=(DIFFUSE,)),
    TwoSided(nested=(DIFFUSE, Conductor())),
    NormalMap(normalmap=TEXTURE, nested=(DIFFUSE,)),
    BumpMap(bumpmap=TEXTURE, nested=(RoughPlastic(),)),
    Blend(weight=0.2, nested=(DIFFUSE, Dielectric())),
    Diffuse(reflectance=VertexColours()),
)


def every_material():
    """Geometry with a shape of each material, the first mesh of `small_geometry` each time."""
    geometry = small_geometry()
    mesh = dataclasses.replace(
        geometry.shapes[0], radiance=TEXTURE, exterior=Medium((1.0, 0.0, 0.0))
    )
    count = len(MATERIALS)
    return small_geometry(
        vertices=np.tile(geometry.vertices[:4], (count, 1)),
        normals=np.tile(geometry.normals, (count, 1)),
        texcoords=np.tile(geometry.texcoords, (count, 1)),
        colours=np.tile(geometry.colours, (count, 1)),
        faces=np.tile(geometry.faces[:4], (count, 1)),
        materials=MATERIALS,
        shapes=tuple(dataclasses.replace(mesh, material=i) for i in range(count)),
    )
