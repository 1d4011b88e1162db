"""Small geometries of assets that several tests share."""

import dataclasses

import numpy as np

from lumitree.asset.asset import Asset, light_field_asset
from lumitree.asset.geometry import AssetGeometry, MeshShape, UnitShape
from lumitree.asset.materials import (
    Dielectric,
    Diffuse,
    Mask,
    RoughConductor,
    Texture,
    TwoSided,
)
from lumitree.core.frames import LocalFrame, rows_of
from support.light_fields import random_light_field

IDENTITY = rows_of(np.eye(4))
TEXTURE = Texture(image=1, raw=False, filter_type="bilinear", wrap_mode="repeat", to_uv=IDENTITY)
# Members of a geometry without meshes and images.
NOTHING = {
    "vertices": np.zeros((0, 3), np.float32),
    "faces": np.zeros((0, 3), np.uint32),
    "normals": np.zeros((0, 3), np.float32),
    "texcoords": np.zeros((0, 2), np.float32),
    "colours": np.zeros((0, 3), np.float32),
    "images": (),
}


def small_geometry(**changes) -> AssetGeometry:
    """A textured tetrahedron with colours of vertices, an emissive one and an emissive sphere."""
    random = np.random.default_rng(2)
    opacity = dataclasses.replace(TEXTURE, image=0, raw=True)
    members = {
        "vertices": random.uniform(-0.5, 0.5, (8, 3)).astype(np.float32),
        "normals": random.normal(size=(4, 3)).astype(np.float32),
        "texcoords": random.random((4, 2)).astype(np.float32),
        "colours": random.random((4, 3)).astype(np.float32),
        "faces": np.array([[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]] * 2, np.uint32),
        "images": (
            random.random((2, 3, 1)).astype(np.float32),
            random.integers(0, 256, (3, 2, 3), np.uint8),
        ),
        "shapes": (
            MeshShape(material=0, vertices=4, faces=4, normals=True, texcoords=True, colours=True),
            MeshShape(material=1, radiance=(3.0, 2.0, 1.0), vertices=4, faces=4),
            UnitShape(
                type="sphere",
                to_world=rows_of(np.diag([0.2, 0.2, 0.2, 1])),
                material=2,
                radiance=2.5,
                flipped=True,
            ),
        ),
        "materials": (
            Mask(opacity=opacity, nested=(TwoSided(nested=(Diffuse(reflectance=TEXTURE),)),)),
            RoughConductor(material="Cr", alpha=0.2, distribution="ggx"),
            Dielectric(int_ior=1.5, ext_ior="air"),
        ),
        **changes,
    }
    return AssetGeometry(**members)


def with_geometry(geometry: AssetGeometry, frame: LocalFrame | None = None) -> Asset:
    """An asset of geometry and a random light field."""
    frame = LocalFrame(np.ones(3), np.eye(4)) if frame is None else frame
    asset = light_field_asset(random_light_field(0), frame, "test")
    return Asset(**{**vars(asset), "geometry": geometry})
