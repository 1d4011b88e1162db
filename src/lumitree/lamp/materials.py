"""A lamp's materials: a surface of `asset.materials`, with emission, opacity and normals.

Emitted radiance is in W/(m² sr) for each of R, G and B (linear sRGB primaries).
"""

import dataclasses
import warnings

import numpy as np
from numpy.typing import NDArray

from lumitree.asset import materials as surfaces
from lumitree.asset.geometry import Medium
from lumitree.asset.materials import Image, Texture, VertexColours, transmits
from lumitree.core.backend import load_mitsuba
from lumitree.core.images import resized
from lumitree.core.photometry import RGB
from lumitree.errors import LumitreeError, LumitreeWarning, shown

WHITE: RGB = (1.0, 1.0, 1.0)
Radiance = RGB | Texture
Value = float | Texture
# Roughness below which a surface is smooth: the geometry of an asset has no smaller alpha than its
# square.
_SMOOTH = 0.01
# For all products of `MaskedEmission` of one model.
_MAX_BYTES = 5 * 2**28


@dataclasses.dataclass(frozen=True)
class Material:
    """A surface with its emission, opacity and normal map.

    Attributes:
        name: unique in the lamp.
        title: its name in the model's file, which several may share: one material of the file may
            become one for each kind of mesh. Default: `name`.
        radiance: emitted by the front of the surface where it is present; None where it does not
            emit.
        opacity: in [0, 1]; light crosses the rest of the surface unchanged.
        normal_map: tangent-space normals, linear data.
        two_sided: the back reflects as the front does. Without effect on glass and thin
            sheets, which define both sides.
        medium: what fills a solid; None for nothing.
    """

    name: str
    surface: surfaces.Material
    radiance: Radiance | None = None
    opacity: Value = 1.0
    normal_map: Texture | None = None
    two_sided: bool = False
    title: str = ""
    medium: Medium | None = None

    def __post_init__(self) -> None:
        if not self.title:
            object.__setattr__(self, "title", self.name)

    @property
    def bsdf(self) -> surfaces.Material:
        """Its surface with the layers around it, outermost first: mask, both sides, normals."""
        found = self.surface
        if self.normal_map is not None:
            found = surfaces.NormalMap(normalmap=self.normal_map, nested=(found,))
        if self.two_sided and not transmits(self.surface):
            found = surfaces.TwoSided(nested=(found,))
        if self.opacity != 1:
            found = surfaces.Mask(opacity=self.opacity, nested=(found,))
        return found


def glass(
    ior: float = 1.5, roughness: float = 0.0, tint: RGB = WHITE, *, thin: bool = False
) -> surfaces.Material:
    """A clear or frosted dielectric.

    Args:
        ior: index of refraction, above 1.
        roughness: square root of the alpha of GGX microfacets; below 0.01 it is smooth. A thin
            sheet is always smooth.
        tint: factor of the transmitted light at each crossing of the surface.
        thin: the mesh is a single sheet; otherwise it is a closed surface of a solid.
    """
    if roughness >= _SMOOTH and not thin:
        red, green, blue = (channel**2 for channel in tint)
        return surfaces.MetallicRoughness(
            base_color=(red, green, blue), roughness=roughness, eta=ior, spec_trans=1.0
        )
    kind = surfaces.ThinDielectric if thin else surfaces.Dielectric
    tinted = None if tint == WHITE else tint
    return kind(int_ior=ior, ext_ior=1.0, specular_transmittance=tinted)


def metal(tint: RGB = WHITE, roughness: float = 0.0, conductor: str = "none") -> surfaces.Material:
    """A conductor.

    Args:
        tint: factor of the reflected light.
        roughness: square root of the alpha of GGX microfacets; below 0.01 it is a mirror.
        conductor: measured index of refraction by Mitsuba's name ("Au", "Cr", ...); "none"
            reflects everything.
    """
    mirror = surfaces.Conductor(material=conductor, specular_reflectance=tint)
    if roughness < _SMOOTH:
        return mirror
    red, green, blue = (np.array(tint) * normal_reflectance(mirror)).tolist()
    return surfaces.MetallicRoughness(
        base_color=(red, green, blue), metallic=1.0, roughness=roughness
    )


def normal_reflectance(metal: surfaces.Metal) -> list[float]:
    """Reflectance [3] of a conductor at normal incidence, by Fresnel's equations."""
    mi = load_mitsuba()
    given = {"material": metal.material, "eta": metal.eta, "k": metal.k}
    images = Texture | VertexColours
    if any(isinstance(value, images) for value in given.values()):
        return [1.0, 1.0, 1.0]
    colours = {
        name: {"type": "rgb", "value": list(value)} if isinstance(value, tuple) else value
        for name, value in given.items()
        if value is not None
    }
    parameters = mi.traverse(mi.load_dict({"type": "conductor", **colours}))
    eta, k = (
        np.broadcast_to(np.array(parameters[f"{name}.value"], np.float64).ravel(), 3)
        for name in ("eta", "k")
    )
    return (((eta - 1) ** 2 + k**2) / ((eta + 1) ** 2 + k**2)).tolist()


class MaskedEmission:
    """Radiance times opacity of the materials of a model; equal products are made once.

    Mitsuba's emitters also emit where a mask lets light through. `images` are the model's, to which
    the products are added.
    """

    def __init__(self, images: list[Image]) -> None:
        self._images = images
        self._made: dict[tuple[int | RGB, Value], int] = {}

    def of(self, material: Material) -> Radiance | None:
        """Emission of a material; None for nothing.

        If the texture coordinates of the opacity differ from the radiance's, its mean is used,
        after a warning.
        """
        radiance, opacity = material.radiance, material.opacity
        if radiance is None or opacity == 0:
            return None
        if opacity == 1:
            return radiance
        if not isinstance(radiance, Texture):
            if isinstance(opacity, Texture):
                return self._product(radiance, opacity, opacity, material.title)
            red, green, blue = (float(opacity * value) for value in radiance)
            return (red, green, blue)
        if isinstance(opacity, Texture) and not (
            radiance.to_uv == opacity.to_uv and radiance.wrap_mode == opacity.wrap_mode
        ):
            warnings.warn(
                f"material {shown(material.title)!r}: its opacity has other texture coordinates "
                "than its emission, which is multiplied by the mean of the opacity",
                LumitreeWarning,
                stacklevel=2,
            )
            opacity = float(opacity.linear(self._images).mean(dtype=np.float64))
        return self._product(radiance, opacity, radiance, material.title)

    def _product(self, radiance: Radiance, opacity: Value, placed: Texture, title: str) -> Texture:
        """A texture with the coordinates of `placed`."""
        key = (
            radiance.image if isinstance(radiance, Texture) else radiance,
            opacity.image if isinstance(opacity, Texture) else opacity,
        )
        if key not in self._made:
            factors: list[NDArray[np.float32]] = [
                each.linear(self._images)
                if isinstance(each, Texture)
                else np.reshape(each, (1, 1, -1))
                for each in (radiance, opacity)
            ]
            height, width = (max(each.shape[axis] for each in factors) for axis in (0, 1))
            made = sum(self._images[index].nbytes for index in self._made.values())
            size = made + 12 * height * width
            if size > _MAX_BYTES:
                raise LumitreeError(
                    f"material {shown(title)!r}: emission times opacity brings such images to "
                    f"{size >> 20} MiB; at most {_MAX_BYTES >> 20} MiB: make them smaller"
                )
            light, share = (
                each if each.shape[:2] == (1, 1) else resized(each, height, width)
                for each in factors
            )
            self._made[key] = len(self._images)
            self._images.append((light * share).astype(np.float32))
        return dataclasses.replace(placed, image=self._made[key], raw=True)
