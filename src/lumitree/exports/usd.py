"""OpenUSD: a layer with lights, surfaces and photometric files in a folder, or one package.

A light of UsdLux has a luminance, cd/m²: intensity · colour · profile, over the area of its surface
if `normalize` is set. A sphere of the radius r sends its luminance times π r² in each direction,
and its area is 4 π r²; so with the intensity 4 I its luminous intensity is I · colour · profile.
"""

import importlib
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lumitree.core.files import scratch_folder
from lumitree.core.photometry import LUMENS_PER_WATT
from lumitree.errors import LumitreeError, shown
from lumitree.exports.light_profiles import LOST_COLOUR, ProfiledLight, Spot, profiled_lights
from lumitree.exports.point_lights import turn_up
from lumitree.exports.surfaces import LOST_GLOW, LOST_SHADOWS, PbrImages, Surface, surfaces_of
from lumitree.exports.target import (
    LOST_IN_BLENDER,
    ExportRequest,
    Target,
    Written,
    blender_spots,
)
from lumitree.exports.usd_materials import MaterialWriter, primvar_name
from lumitree.formats.ies import ies_content

_MODULES = ("Gf", "Kind", "Sdf", "Tf", "Usd", "UsdGeom", "UsdLux", "UsdShade", "UsdUtils", "Vt")
_UNITS = (
    "metres; luminance in cd/m² (683 times W/(m² sr)), so a light of the intensity 4 has a mean "
    "of 1 cd"
)
_LOST_PROFILES = (
    "lights emit the same in all directions: a package may not contain photometric files; write "
    ".usda for them"
)
# Variants: whether the surfaces emit, which in path tracers illuminates.
GLOW, SHOWN, HIDDEN = "glow", "on", "off"
_COMMENT = (
    "The lamp's shadows are in its lights, so their shadow links exclude its surfaces. In the "
    "variant off of glow surfaces do not emit."
)
_NAME_CHARACTERS = 60
# From a luminous intensity, cd, to the intensity of a normalised sphere of UsdLux.
INTENSITY_PER_CANDELA = 4.0
# Radius of a light, as a part of half the lamp's longest side.
_RADIUS = 1e-3
# Degrees about x from the frame of a light to the frame of the stage, with y up.
_TURN = -90.0
# UsdLux cuts off light at 90 degrees without this angle of the cone.
_ALL_DIRECTIONS = 180.0


def load_usd() -> ModuleType:
    """The package `pxr`, whose modules state no types; refuses to go on without it."""
    try:
        library = importlib.import_module("pxr")
        for name in _MODULES:
            importlib.import_module(f"pxr.{name}")
    except ImportError as error:
        raise LumitreeError(
            f"USD files need the package usd-core ({error}); install it with "
            "`pip install 'lumitree[usd]'`"
        ) from None
    return library


class LampStage:
    """Writes the files of a lamp's stage, with y up, into a folder.

    `name` is the layer to open, such as "lamp.usda", and `units` one line about its units. `lost`
    has one line for each property of the surfaces that is not carried over.
    """

    def __init__(
        self, request: ExportRequest, folder: Path, name: str, units: str = _UNITS
    ) -> None:
        self._pxr, self._folder, self._name = load_usd(), folder, name
        self._side = folder / request.side_folder
        self._asset, self._luminaire = (
            request.asset,
            shown(request.asset.luminaire, _NAME_CHARACTERS),
        )
        self._comment = f"A lamp, written by lumitree. y is up; {units}. {_COMMENT}"
        self._root = "/" + self._pxr.Tf.MakeValidIdentifier(self._luminaire)
        self.lost: set[str] = set()

    def write(
        self,
        surfaces: Sequence[Surface],
        lights: Sequence[ProfiledLight | Spot],
        *,
        one_layer: bool,
    ) -> None:
        """Write one layer with UsdPreviewSurface only and lights without profiles; or a layer of
        the surfaces, and one of the lights, with profiles, that refers to it.
        """
        if not one_layer:
            self._side.mkdir()
        stage = self._new_stage(self._name)
        if surfaces and one_layer:
            self._add_surfaces(stage, surfaces, materialx=False)
        elif surfaces:
            file = f"{self._side.name}/surfaces.usdc"
            layer = self._new_stage(file)
            self._add_surfaces(layer, surfaces, materialx=True)
            layer.GetRootLayer().Save()
            stage.GetDefaultPrim().GetReferences().AddReference(f"./{file}")
        self._pxr.UsdGeom.Xform.Define(stage, f"{self._root}/lights")
        for index, light in enumerate(lights):
            profile = None if one_layer else self._side / f"light{index}.ies"
            self._add_light(stage, index, light, profile)
        self._describe(stage)
        stage.GetRootLayer().Save()

    def _new_stage(self, name: str) -> Any:
        stage = self._pxr.Usd.Stage.CreateNew(str(self._folder / name))
        stage.GetRootLayer().comment = self._comment
        self._pxr.UsdGeom.SetStageUpAxis(stage, self._pxr.UsdGeom.Tokens.y)
        self._pxr.UsdGeom.SetStageMetersPerUnit(stage, 1.0)
        root = self._pxr.UsdGeom.Xform.Define(stage, self._root)
        stage.SetDefaultPrim(root.GetPrim())
        return stage

    def _describe(self, stage: Any) -> None:
        """Kind, name and extents of the root."""
        usd, geometry, root = self._pxr.Usd, self._pxr.UsdGeom, stage.GetDefaultPrim()
        usd.ModelAPI(root).SetKind(self._pxr.Kind.Tokens.component)
        usd.ModelAPI(root).SetAssetName(self._luminaire)
        bounds = geometry.BBoxCache(usd.TimeCode.Default(), [geometry.Tokens.default_])
        box = bounds.ComputeWorldBound(root).ComputeAlignedRange()
        corners = np.array([[*box.GetMin()], [*box.GetMax()]], np.float32)
        geometry.ModelAPI.Apply(root).SetExtentsHint(self._vectors(corners))

    def _add_surfaces(self, stage: Any, surfaces: Sequence[Surface], *, materialx: bool) -> None:
        """Define meshes and materials, and write images."""
        assert self._asset.geometry is not None
        images = PbrImages(self._asset.geometry.images)
        parent = f"{self._root}/materials"
        materials = MaterialWriter(self._pxr, stage, parent, images, materialx=materialx)
        self._pxr.UsdGeom.Scope.Define(stage, parent)
        self._pxr.UsdGeom.Xform.Define(stage, f"{self._root}/surfaces")
        for index, surface in enumerate(surfaces):
            mesh = self._mesh(stage, f"{self._root}/surfaces/surface{index}", surface)
            binding = self._pxr.UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim())
            binding.Bind(materials.add(index, surface))
        if any(not surface.material.emission.is_black for surface in surfaces):
            glow = stage.GetDefaultPrim().GetVariantSets().AddVariantSet(GLOW)
            for variant in (HIDDEN, SHOWN):
                glow.AddVariant(variant)
            glow.SetVariantSelection(SHOWN)
            with glow.GetVariantEditContext():
                materials.add_emission()
        for name, content in images.files.items():
            # MaterialX is in the layer of the surfaces.
            ((self._side if materialx else self._folder) / f"{name}.png").write_bytes(content)
        self.lost |= materials.lost

    def _mesh(self, stage: Any, path: str, surface: Surface) -> Any:
        geometry, arrays = self._pxr.UsdGeom, surface.mesh
        vertices, faces = arrays["vertices"], arrays["faces"].astype(np.int32)
        mesh = geometry.Mesh.Define(stage, path)
        mesh.CreateSubdivisionSchemeAttr(geometry.Tokens.none)
        mesh.CreateDoubleSidedAttr(surface.material.two_sided)
        mesh.CreatePointsAttr(self._vectors(vertices))
        mesh.CreateExtentAttr(self._vectors(np.stack([vertices.min(axis=0), vertices.max(axis=0)])))
        integers = self._pxr.Vt.IntArray.FromNumpy
        mesh.CreateFaceVertexCountsAttr(integers(np.full(len(faces), 3, np.int32)))
        mesh.CreateFaceVertexIndicesAttr(integers(faces.ravel()))
        if "normals" in arrays:
            mesh.CreateNormalsAttr(self._vectors(arrays["normals"]))
            mesh.SetNormalsInterpolation(geometry.Tokens.vertex)
        primvars = geometry.PrimvarsAPI(mesh.GetPrim())
        kind = self._pxr.Sdf.ValueTypeNames.TexCoord2fArray
        for number, places in enumerate(surface.uv):
            # The first row of an image is at v = 1.
            st = np.stack([places[:, 0], 1 - places[:, 1]], axis=1).astype(np.float32)
            primvar = primvars.CreatePrimvar(primvar_name(number), kind, geometry.Tokens.vertex)
            primvar.Set(self._pxr.Vt.Vec2fArray.FromNumpy(st))
        if "colours" in arrays:
            colours = mesh.CreateDisplayColorPrimvar(geometry.Tokens.vertex)
            colours.Set(self._vectors(arrays["colours"]))
        return mesh

    def _add_light(
        self, stage: Any, index: int, light: ProfiledLight | Spot, profile: Path | None
    ) -> None:
        """Define a light, and write its profile into a file if there is one."""
        lux, radius = self._pxr.UsdLux, float(self._asset.frame.scale) * _RADIUS
        prim = lux.SphereLight.Define(stage, f"{self._root}/lights/light{index}")
        prim.AddTranslateOp().Set(self._pxr.Gf.Vec3d(*light.position.tolist()))
        prim.CreateRadiusAttr(radius)
        prim.CreateTreatAsPointAttr(True)
        prim.CreateNormalizeAttr(True)
        prim.CreateColorAttr(self._pxr.Gf.Vec3f(*light.colour))
        corners = np.array([[-radius] * 3, [radius] * 3], np.float32)
        prim.CreateExtentAttr(self._vectors(corners))
        intensity = INTENSITY_PER_CANDELA * light.candela
        if isinstance(light, Spot):
            x, y, z, w = light.rotation
            prim.AddOrientOp().Set(self._pxr.Gf.Quatf(w, x, y, z))
            # Blender's importer makes W of the candela of UsdLux.
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
            shaping.CreateShapingIesFileAttr(
                self._pxr.Sdf.AssetPath(f"./{self._side.name}/{profile.name}")
            )
            shaping.CreateShapingIesNormalizeAttr(False)
            shaping.CreateShapingIesAngleScaleAttr(0.0)
            shaping.CreateShapingConeAngleAttr(_ALL_DIRECTIONS)
        # The profiles include all shadows of the lamp.
        linked = lux.LightAPI(prim.GetPrim()).GetShadowLinkCollectionAPI()
        linked.CreateExcludesRel().AddTarget(f"{self._root}/surfaces")

    def _vectors(self, array: NDArray[np.floating]) -> Any:
        return self._pxr.Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(array, np.float32))


def _write_package(request: ExportRequest, folder: Path) -> Written:
    """A package, which contains layers and images only, as its specification has it."""
    pxr = load_usd()
    with scratch_folder() as scratch:
        name = f"{request.stem}.usdc"
        written = _write(request, scratch, name, one_layer=True)
        given = pxr.Sdf.AssetPath(str(scratch / name))
        if not pxr.UsdUtils.CreateNewUsdzPackage(given, str(folder / request.name), name):
            raise LumitreeError(f"OpenUSD did not write the package {shown(request.name, 200)}")
    return written


def _write(request: ExportRequest, folder: Path, name: str, *, one_layer: bool) -> Written:
    if request.importer == "blender":
        spots, written = blender_spots(request)
        stage = LampStage(request, folder, name, written.units or _UNITS)
        stage.write([], spots, one_layer=True)
        return written
    stage = LampStage(request, folder, name)
    lights = profiled_lights(request.place("y"), request.asset.luminaire)
    surfaces, lost = surfaces_of(request.asset, turn_up(request.up, "y"))
    stage.write(surfaces, lights, one_layer=one_layer)
    lost = [LOST_IN_BLENDER, LOST_COLOUR, *sorted({*lost, *stage.lost})]
    if one_layer:
        lost.append(_LOST_PROFILES)
    if surfaces:
        lost.append(LOST_SHADOWS)
    if any(not surface.material.emission.is_black for surface in surfaces):
        lost.append(f"{LOST_GLOW}: choose the variant {HIDDEN} of {GLOW} of the lamp there")
    triangles = sum(len(surface.mesh["faces"]) for surface in surfaces)
    return Written(not_carried_over=lost, lights=len(lights), triangles=triangles)


def _check(_: object) -> None:
    load_usd()


STAGE = Target(
    name="OpenUSD",
    write=lambda request, folder: _write(request, folder, request.name, one_layer=False),
    up="y",
    units=_UNITS,
    importers=True,
    check=_check,
)
PACKAGE = Target(
    name="USDZ", write=_write_package, up="y", units=_UNITS, importers=True, check=_check
)
