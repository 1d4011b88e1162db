"""OpenUSD: a layer with lights, surfaces and photometric files beside it, or one package.

A light of UsdLux has a luminance, cd/m²: intensity · colour · profile, over the area of its surface
if `normalize` is set. A sphere of the radius r sends its luminance times π r² in each direction,
and its area is 4 π r²; so with the intensity 4 I its luminous intensity is I · colour · profile.
"""

import importlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.asset import Asset
from lumitree.core.files import FilePath, scratch_folder
from lumitree.core.photometry import LUMENS_PER_WATT
from lumitree.errors import LumitreeError, shown
from lumitree.exports.light_profiles import LOST_COLOUR, ProfiledLight, Spot, profiled_lights
from lumitree.exports.point_lights import place_lights, turn_up
from lumitree.exports.surfaces import LOST_GLOW, LOST_SHADOWS, PbrImages, Surface, surfaces_of
from lumitree.exports.target import (
    LOST_IN_BLENDER,
    ExportRequest,
    Target,
    Written,
    blender_spots,
    file_orientation,
)
from lumitree.exports.usd_materials import MaterialWriter, ShaderPlace, primvar_name
from lumitree.formats.ies import ies_content

_MODULES = ("Gf", "Kind", "Sdf", "Tf", "Usd", "UsdGeom", "UsdLux", "UsdShade", "UsdUtils", "Vt")
_LOST_PROFILES = (
    "lights emit the same in all directions: a package may hold no photometric files; write .usda "
    "for them"
)
_UNITS = (
    "metres; luminance in cd/m² (683 times W/(m² sr)), so a light of the intensity 4 has a mean "
    "of 1 cd"
)
# Variants: whether the surfaces emit, which in path tracers illuminates.
GLOW, SHOWN, HIDDEN = "glow", "on", "off"
_COMMENT = (
    "The lamp's own shadows are in its lights, so their shadow links exclude its surfaces. In the "
    "variant off of glow surfaces do not emit."
)
_NAME_CHARACTERS = 60
# From a luminous intensity, cd, to the intensity of a normalised sphere of UsdLux.
INTENSITY_PER_CANDELA = 4.0
# Radius of a light, as a part of half the lamp's longest side.
_RADIUS = 1e-3
# Degrees about x from the frame of a light to the frame of the stage, with y up.
_TURN = -90.0
# UsdLux cuts off light at 90 degrees unless it is told otherwise.
_ALL_DIRECTIONS = 180.0


def load_usd() -> Any:
    """The package `pxr`, whose modules state no types; refuses to go on without it."""
    try:
        library: Any = importlib.import_module("pxr")
        for name in _MODULES:
            importlib.import_module(f"pxr.{name}")
    except ImportError as error:
        raise LumitreeError(
            f"USD files need the package usd-core ({error}); install it with "
            "`pip install 'lumitree[usd]'`"
        ) from None
    return library


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


class LampStage:
    """Writes the files of a lamp's stage into a folder.

    Args:
        name: name of the layer to open, such as "lamp.usda".
        stem: beginning of the names of the other files.
        units: of lengths and of light, one line.
    """

    def __init__(
        self, pxr: Any, folder: Path, name: str, stem: str, asset: Asset, units: str
    ) -> None:
        self._pxr, self._folder, self._name, self._stem = pxr, folder, name, stem
        self._asset, self._luminaire = asset, shown(asset.luminaire, _NAME_CHARACTERS)
        self._comment = f"A lamp, written by lumitree. y is up; {units}. {_COMMENT}"
        self._root = "/" + pxr.Tf.MakeValidIdentifier(self._luminaire)

    def write_layers(
        self, surfaces: Sequence[Surface], lights: Sequence[ProfiledLight]
    ) -> list[str]:
        """Write a layer of the surfaces, and one of the lights, with profiles, that refers to it.

        Returns one line for each property of the surfaces that is lost.
        """
        stage, lost = self._new_stage(self._name), []
        if surfaces:
            file = f"{self._stem}.surfaces.usdc"
            layer = self._new_stage(file)
            lost = self._add_surfaces(layer, surfaces, materialx=True)
            layer.GetRootLayer().Save()
            stage.GetDefaultPrim().GetReferences().AddReference(f"./{file}")
        files = [self._folder / f"{self._stem}.light{index}.ies" for index in range(len(lights))]
        self._add_lights(stage, lights, files)
        stage.GetRootLayer().Save()
        return lost

    def write_layer(
        self, surfaces: Sequence[Surface], lights: Sequence[ProfiledLight | Spot]
    ) -> list[str]:
        """Write one layer of everything, with UsdPreviewSurface alone and lights without profiles.

        Returns one line for each property of the surfaces that is lost.
        """
        stage = self._new_stage(self._name)
        lost = self._add_surfaces(stage, surfaces, materialx=False) if surfaces else []
        self._add_lights(stage, lights, [None] * len(lights))
        stage.GetRootLayer().Save()
        return lost

    def _add_surfaces(
        self, stage: Any, surfaces: Sequence[Surface], *, materialx: bool
    ) -> list[str]:
        """Define meshes and materials, and write images; returns what is lost."""
        assert self._asset.geometry is not None
        lost: set[str] = set()
        images = PbrImages(self._asset.geometry.images)
        place = ShaderPlace(self._pxr, stage, images, lambda name: f"./{self._image(name)}", lost)
        self._pxr.UsdGeom.Scope.Define(stage, f"{self._root}/materials")
        materials = MaterialWriter(place, f"{self._root}/materials", materialx=materialx)
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
            (self._folder / self._image(name)).write_bytes(content)
        return sorted(lost)

    def _add_lights(
        self, stage: Any, lights: Sequence[ProfiledLight | Spot], files: Sequence[Path | None]
    ) -> None:
        """Define lights, and write their profiles into files; after the surfaces."""
        root = stage.GetDefaultPrim()
        self._pxr.Usd.ModelAPI(root).SetKind(self._pxr.Kind.Tokens.component)
        self._pxr.Usd.ModelAPI(root).SetAssetName(self._luminaire)
        self._pxr.UsdGeom.Xform.Define(stage, f"{self._root}/lights")
        half_side = float(self._asset.frame.scale)
        hidden = f"{self._root}/surfaces"
        writer = LightWriter(self._pxr, stage, f"{self._root}/lights", hidden, half_side)
        for index, (light, file) in enumerate(zip(lights, files, strict=True)):
            writer.add(index, light, file)
        self._add_extents(stage, root)

    def _new_stage(self, name: str) -> Any:
        stage = self._pxr.Usd.Stage.CreateNew(str(self._folder / name))
        stage.GetRootLayer().comment = self._comment
        self._pxr.UsdGeom.SetStageUpAxis(stage, self._pxr.UsdGeom.Tokens.y)
        self._pxr.UsdGeom.SetStageMetersPerUnit(stage, 1.0)
        root = self._pxr.UsdGeom.Xform.Define(stage, self._root)
        stage.SetDefaultPrim(root.GetPrim())
        return stage

    def _mesh(self, stage: Any, path: str, surface: Surface) -> Any:
        geometry, arrays = self._pxr.UsdGeom, surface.mesh
        mesh = geometry.Mesh.Define(stage, path)
        mesh.CreateSubdivisionSchemeAttr(geometry.Tokens.none)
        mesh.CreateDoubleSidedAttr(surface.material.two_sided)
        mesh.CreatePointsAttr(self._vectors(arrays["vertices"]))
        mesh.CreateExtentAttr(
            self._vectors(
                np.stack([arrays["vertices"].min(axis=0), arrays["vertices"].max(axis=0)])
            )
        )
        counts = np.full(len(arrays["faces"]), 3, np.int32)
        mesh.CreateFaceVertexCountsAttr(self._pxr.Vt.IntArray.FromNumpy(counts))
        indices = arrays["faces"].ravel().astype(np.int32)
        mesh.CreateFaceVertexIndicesAttr(self._pxr.Vt.IntArray.FromNumpy(indices))
        if "normals" in arrays:
            mesh.CreateNormalsAttr(self._vectors(arrays["normals"]))
            mesh.SetNormalsInterpolation(geometry.Tokens.vertex)
        primvars, types = geometry.PrimvarsAPI(mesh.GetPrim()), self._pxr.Sdf.ValueTypeNames
        for number, places in enumerate(surface.uv):
            # The first row of an image is at v = 1.
            st = np.stack([places[:, 0], 1 - places[:, 1]], axis=1).astype(np.float32)
            primvar = primvars.CreatePrimvar(
                primvar_name(number), types.TexCoord2fArray, geometry.Tokens.vertex
            )
            primvar.Set(self._pxr.Vt.Vec2fArray.FromNumpy(st))
        if "colours" in arrays:
            mesh.CreateDisplayColorPrimvar(geometry.Tokens.vertex).Set(
                self._vectors(arrays["colours"])
            )
        return mesh

    def _add_extents(self, stage: Any, root: Any) -> None:
        purposes = [self._pxr.UsdGeom.Tokens.default_]
        time = self._pxr.Usd.TimeCode.Default()
        hint = self._pxr.UsdGeom.BBoxCache(time, purposes).ComputeWorldBound(root)
        box = hint.ComputeAlignedRange()
        corners = [[*box.GetMin()], [*box.GetMax()]]
        model = self._pxr.UsdGeom.ModelAPI.Apply(root)
        model.SetExtentsHint(self._vectors(np.array(corners, np.float32)))

    def _vectors(self, array: NDArray[Any]) -> Any:
        return self._pxr.Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(array, np.float32))

    def _image(self, name: str) -> str:
        return f"{self._stem}.{name}.png"


def _write_stage(request: ExportRequest, folder: Path) -> Written:
    if request.importer == "blender":
        return _write_spots(request, folder, request.name)
    stage = LampStage(load_usd(), folder, request.name, request.stem, request.asset, _UNITS)
    surfaces, lights, lost = _contents(request)
    return _written(surfaces, lights, [*lost, *stage.write_layers(surfaces, lights)])


def _write_package(request: ExportRequest, folder: Path) -> Written:
    """A package, which holds layers and images only, as its specification has it."""
    pxr = load_usd()
    with scratch_folder() as scratch:
        name = f"{request.stem}.usdc"
        if request.importer == "blender":
            written = _write_spots(request, scratch, name)
        else:
            stage = LampStage(pxr, scratch, name, request.stem, request.asset, _UNITS)
            surfaces, lights, lost = _contents(request)
            lost += stage.write_layer(surfaces, lights)
            written = _written(surfaces, lights, [_LOST_PROFILES, *lost])
        given = pxr.Sdf.AssetPath(str(scratch / name))
        if not pxr.UsdUtils.CreateNewUsdzPackage(given, str(folder / request.name), name):
            raise LumitreeError(f"OpenUSD did not write the package {shown(request.name, 200)}")
    return written


def _write_spots(request: ExportRequest, folder: Path, name: str) -> Written:
    spots, written = blender_spots(request)
    stage = LampStage(load_usd(), folder, name, request.stem, request.asset, written.units)
    stage.write_layer([], spots)
    return written


def _contents(
    request: ExportRequest,
) -> tuple[list[Surface], list[ProfiledLight], list[str]]:
    """Surfaces and lights in the frame of the stage, and what surfaces lack."""
    turn = turn_up(request.up, "y")
    placed = place_lights(request.asset, turn, request.lights, request.seed)
    surfaces, lost = surfaces_of(request.asset, turn)
    return surfaces, profiled_lights(placed, request.asset.luminaire), lost


def _written(surfaces: list[Surface], lights: list[ProfiledLight], lost: list[str]) -> Written:
    lost = [LOST_IN_BLENDER, LOST_COLOUR, *sorted(set(lost))]
    if surfaces:
        lost.append(LOST_SHADOWS)
    if any(not surface.material.emission.is_black for surface in surfaces):
        lost.append(f"{LOST_GLOW}: choose the variant {HIDDEN} of {GLOW} of the lamp there")
    return Written(
        units=_UNITS,
        orientation=file_orientation("y"),
        not_carried_over=lost,
        lights=len(lights),
        triangles=sum(len(surface.mesh["faces"]) for surface in surfaces),
    )


def _check(_: FilePath | None) -> None:
    load_usd()


STAGE = Target(name="OpenUSD", write=_write_stage, importers=True, check=_check)
PACKAGE = Target(name="USDZ", write=_write_package, importers=True, check=_check)
