"""Point lights with IES profiles in UsdLux.

A light of UsdLux has a luminance, cd/m²: intensity · colour · profile, over the area of its surface
if `normalize` is set. A sphere of the radius r sends its luminance times π r² in each direction,
and its area is 4 π r²; so with the intensity 4 I its luminous intensity is I · colour · profile.
"""

from pathlib import Path
from typing import Any

import numpy as np

from lumitree.core.photometry import LUMENS_PER_WATT
from lumitree.formats.ies import ies_content
from lumitree.output.ies_profiles import ProfiledLight
from lumitree.output.spots import Spot

# From a luminous intensity, cd, to the intensity of a normalised sphere of UsdLux.
INTENSITY_PER_CANDELA = 4.0
# Radius of a light, as a part of half the lamp's longest side.
_RADIUS = 1e-3
# Degrees about x from the frame of a light to the frame of the stage, with y up.
_TURN = -90.0
# UsdLux cuts off light at 90 degrees unless it is told otherwise.
_ALL_DIRECTIONS = 180.0


class LightWriter:
    """Defines the lights of a lamp in a stage with y up and lengths in metres, below a parent.

    `hidden` is the path of what casts no shadow in their light, `radius` half the lamp's longest
    side, m.
    """

    def __init__(self, pxr: Any, stage: Any, parent: str, hidden: str, radius: float) -> None:
        self._pxr, self._stage, self._parent, self._hidden = pxr, stage, parent, hidden
        self._radius = radius * _RADIUS

    def add(self, index: int, light: ProfiledLight | Spot, profile: Path | None) -> None:
        """Define a light.

        Args:
            index: number of the light.
            light: Blender's importer makes W of the candela of UsdLux, so a spot has W/sr.
            profile: file that is written, with the name that it has beside the stage; None for a
                light that emits the same in all directions, and for spots.
        """
        lux = self._pxr.UsdLux
        prim = lux.SphereLight.Define(self._stage, f"{self._parent}/light{index}")
        prim.AddTranslateOp().Set(self._pxr.Gf.Vec3d(*light.position.tolist()))
        prim.CreateRadiusAttr(self._radius)
        prim.CreateTreatAsPointAttr(True)
        prim.CreateNormalizeAttr(True)
        intensity = INTENSITY_PER_CANDELA * light.candela
        prim.CreateColorAttr(self._pxr.Gf.Vec3f(*light.colour))
        corners = np.array([[-self._radius] * 3, [self._radius] * 3], np.float32)
        prim.CreateExtentAttr(self._pxr.Vt.Vec3fArray.FromNumpy(corners))
        if isinstance(light, Spot):
            x, y, z, w = light.rotation
            prim.AddOrientOp().Set(self._pxr.Gf.Quatf(w, x, y, z))
            prim.CreateIntensityAttr(intensity / LUMENS_PER_WATT)
            shaping = lux.ShapingAPI.Apply(prim.GetPrim())
            shaping.CreateShapingConeAngleAttr(light.half_angle)
            shaping.CreateShapingConeSoftnessAttr(1.0)
            return
        prim.AddRotateXOp().Set(_TURN)
        prim.CreateIntensityAttr(intensity)
        if profile is not None:
            profile.write_bytes(ies_content(light.profile))
            shaping = lux.ShapingAPI.Apply(prim.GetPrim())
            shaping.CreateShapingIesFileAttr(self._pxr.Sdf.AssetPath(f"./{profile.name}"))
            shaping.CreateShapingIesNormalizeAttr(False)
            shaping.CreateShapingIesAngleScaleAttr(0.0)
            shaping.CreateShapingConeAngleAttr(_ALL_DIRECTIONS)
        # All that the lamp hides is in its profiles.
        linked = lux.LightAPI(prim.GetPrim()).GetShadowLinkCollectionAPI()
        linked.CreateExcludesRel().AddTarget(self._hidden)
