"""A geometry with a shape of each material that an asset may have."""

import numpy as np

from support.geometry_assets import IDENTITY, small_geometry

TEXTURE = {
    "image": 1,
    "raw": False,
    "filter_type": "bilinear",
    "wrap_mode": "repeat",
    "to_uv": IDENTITY,
}
DIFFUSE = {"type": "diffuse", "reflectance": [0.1, 0.2, 0.3]}
MATERIALS = (
    DIFFUSE,
    {"type": "diffuse", "reflectance": TEXTURE},
    {"type": "dielectric", "int_ior": "bk7"},
    {"type": "thindielectric", "int_ior": 1.4, "ext_ior": "air"},
    {"type": "roughdielectric", "alpha": 0.04},
    {"type": "conductor", "material": "Au"},
    {"type": "roughconductor", "alpha_u": 0.1, "alpha_v": 0.2, "eta": 0.2, "k": [3.0, 2, 1]},
    {"type": "roughconductor", "alpha": TEXTURE, "specular_reflectance": TEXTURE},
    {"type": "plastic", "diffuse_reflectance": TEXTURE},
    {"type": "roughplastic", "alpha": 0.3, "int_ior": 1.6},
    {"type": "principled", "base_color": [1.0, 0, 0], "roughness": TEXTURE, "specular": 0.3},
    {"type": "principled", "metallic": 1.0, "clearcoat": 0.5, "sheen": 0.2, "flatness": 0.1},
    {"type": "lumitree_metallic_roughness", "base_color": TEXTURE, "metallic": 0.4},
    {"type": "lumitree_metallic_roughness", "thin": True, "diff_trans": 1.1, "spec_trans": 0.2},
    {"type": "principledthin", "diff_trans": 1.1, "spec_trans": 0.2},
    {"type": "mask", "opacity": TEXTURE, "nested": [DIFFUSE]},
    {"type": "twosided", "nested": [DIFFUSE, {"type": "conductor"}]},
    {"type": "normalmap", "normalmap": TEXTURE, "nested": [DIFFUSE]},
    {"type": "bumpmap", "bumpmap": TEXTURE, "nested": [{"type": "roughplastic"}]},
    {"type": "blendbsdf", "weight": 0.2, "nested": [DIFFUSE, {"type": "dielectric"}]},
    {"type": "diffuse", "reflectance": {"attribute": "vertex_color"}},
)


def every_material():
    """Geometry with a shape of each material, the first mesh of `small_geometry` each time."""
    geometry = small_geometry()
    mesh = {**geometry.shapes[0], "radiance": TEXTURE}
    count = len(MATERIALS)
    return small_geometry(
        vertices=np.tile(geometry.vertices[:4], (count, 1)),
        normals=np.tile(geometry.normals, (count, 1)),
        texcoords=np.tile(geometry.texcoords, (count, 1)),
        colours=np.tile(geometry.colours, (count, 1)),
        faces=np.tile(geometry.faces[:4], (count, 1)),
        materials=MATERIALS,
        shapes=tuple({**mesh, "material": i, "exterior": [1.0, 0, 0]} for i in range(count)),
    )
