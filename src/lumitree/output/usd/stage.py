"""The stage of a lamp: its lights, its surfaces and their materials."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.asset import Asset
from lumitree.errors import shown
from lumitree.output.ies_profiles import ProfiledLight
from lumitree.output.pbr_images import PbrImages
from lumitree.output.pbr_meshes import Surface
from lumitree.output.spots import Spot
from lumitree.output.usd.lights import LightWriter
from lumitree.output.usd.materials import MaterialWriter
from lumitree.output.usd.shaders import ShaderPlace, primvar_name

# Variants: whether the surfaces emit, which in path tracers illuminates.
GLOW, SHOWN, HIDDEN = "glow", "on", "off"
_COMMENT = (
    "The lamp's own shadows are in its lights, so their shadow links exclude its surfaces. In the "
    "variant off of glow surfaces do not emit."
)
_NAME_CHARACTERS = 60


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
