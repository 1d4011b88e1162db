"""`lumitree export -o lamp.usda` and `.usdz`, read by OpenUSD and judged by its validators."""

import dataclasses
import os
import sys
import zipfile

import numpy as np
import pytest

import lumitree
from benchmarks.exported_files.usd import (
    lights_of,
    luminous_intensity,
    profile_of,
    value,
)
from lumitree.asset.materials import Mask
from lumitree.cli import main
from lumitree.core.frames import rows_of, similarity
from lumitree.errors import LumitreeError
from lumitree.exports.point_lights import turn_up
from lumitree.exports.surfaces import geometry_meshes
from support.every_material import MATERIALS, TEXTURE, every_material
from support.exported_lamps import lamp
from support.geometry_assets import small_geometry, with_geometry

pytestmark = pytest.mark.usefixtures("mi")


@pytest.fixture
def pxr():
    pytest.importorskip("pxr", reason="the optional dependency usd is not installed")
    from lumitree.exports.usd import load_usd

    return load_usd()


def meshes_of(pxr, stage):
    return [prim for prim in stage.Traverse() if prim.IsA(pxr.UsdGeom.Mesh)]


def flux_of(prim, lumens):
    """Flux [3] of R, G and B, W, as the schema of UsdLux has it: see `exports.usd`."""
    assert prim.GetAttribute("inputs:normalize").Get() is True
    return luminous_intensity(prim) * lumens / 683


def problems(stage_path):
    """Problems found by the validators that are part of OpenUSD.

    The package usd-core has no definitions of the nodes of MaterialX, which OpenUSD can be built
    with; that one is missing is not a problem.
    """
    validation = pytest.importorskip("pxr.UsdValidation", reason="this OpenUSD has no validators")
    usd = pytest.importorskip("pxr.Usd")

    registry = validation.ValidationRegistry()
    context = validation.ValidationContext(registry.GetOrLoadAllValidators())
    stage = usd.Stage.Open(str(stage_path))
    found = context.Validate(stage)
    errors = [f"{each.GetName()}: {each.GetMessage()}" for each in found]
    return [each for each in errors if "'ND_standard_surface_surfaceshader'" not in each]


@pytest.mark.parametrize("gain", [(1.0, 1.0, 1.0), (2.0, 1.0, 0.5)])
def test_intensity_times_profile_is_the_flux_of_the_asset(pxr, tmp_path, gain):
    from lumitree.rendering.asset_flux import asset_watts

    asset = lamp(gain=gain)
    result = lumitree.export(asset, tmp_path / "lamp.usda", lights=6)
    stage = pxr.Usd.Stage.Open(str(result.file))
    lights = lights_of(pxr, stage)
    assert len(lights) == result.lights == 6
    flux = sum(flux_of(prim, profile_of(prim).lumens) for prim in lights)
    np.testing.assert_allclose(flux, asset_watts(asset), rtol=5e-3)
    # A program that ignores the profiles shows the same flux.
    flux = sum(flux_of(prim, 4 * np.pi) for prim in lights)
    np.testing.assert_allclose(flux, asset_watts(asset), rtol=1e-6)


def test_lights_are_shaped_by_their_profiles_alone(pxr, tmp_path):
    lumitree.export(with_geometry(small_geometry()), tmp_path / "lamp.usda")
    stage = pxr.Usd.Stage.Open(str(tmp_path / "lamp.usda"))
    root = stage.GetDefaultPrim()
    for prim in lights_of(pxr, stage):
        # The schema's default cuts off all light above the horizontal.
        assert value(prim, "shaping:cone:angle") == 180
        assert value(prim, "shaping:ies:angleScale") == 0
        assert value(prim, "shaping:ies:normalize") is False
        assert prim.GetAttribute("treatAsPoint").Get() is True
        assert prim.GetAttribute("inputs:radius").Get() < 2e-3
        linked = pxr.UsdLux.LightAPI(prim).GetShadowLinkCollectionAPI().ComputeMembershipQuery()
        assert linked.IsPathIncluded("/room/wall")
        assert not linked.IsPathIncluded(f"{root.GetPath()}/surfaces/surface0")


def test_the_stage_holds_the_surfaces(pxr, tmp_path):
    geometry, turn = small_geometry(), turn_up("z", "y")
    result = lumitree.export(with_geometry(geometry), tmp_path / "lamp.usda", up="z")
    stage = pxr.Usd.Stage.Open(str(tmp_path / "lamp.usda"))
    root = stage.GetDefaultPrim()
    assert pxr.Usd.ModelAPI(root).GetKind() == "component"
    meshes = meshes_of(pxr, stage)
    expected = geometry_meshes(geometry, similarity(turn))
    assert len(meshes) == len(expected) == 3
    assert result.triangles == sum(len(each["faces"]) for each in expected)
    for prim, arrays in zip(meshes, expected, strict=True):
        mesh = pxr.UsdGeom.Mesh(prim)
        points = np.array(mesh.GetPointsAttr().Get())
        np.testing.assert_array_equal(points, arrays["vertices"])
        faces = np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
        np.testing.assert_array_equal(faces, arrays["faces"])
        extent = np.array(mesh.GetExtentAttr().Get())
        np.testing.assert_array_equal(extent, [points.min(axis=0), points.max(axis=0)])
        if "normals" in arrays:
            found = np.array(mesh.GetNormalsAttr().Get())
            length = np.linalg.norm(arrays["normals"], axis=1, keepdims=True)
            np.testing.assert_allclose(found, arrays["normals"] / length, atol=1e-6)
        assert pxr.UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()[0]
    st = pxr.UsdGeom.PrimvarsAPI(meshes[0]).GetPrimvar("st").Get()
    np.testing.assert_allclose(st, expected[0]["texcoords"] * [1, -1] + [0, 1], atol=1e-6)
    shown = geometry.num_triangles
    assert shown < result.triangles


def surface_input(pxr, prim, name):
    material = pxr.UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()[0]
    shader = material.ComputeSurfaceSource()[0]
    return shader.GetInput(name)


def test_materials_have_the_numbers_of_the_lamp(pxr, tmp_path):
    lumitree.export(with_geometry(small_geometry()), tmp_path / "lamp.usda")
    stage = pxr.Usd.Stage.Open(str(tmp_path / "lamp.usda"))
    textured, metal, glass = meshes_of(pxr, stage)
    assert surface_input(pxr, metal, "metallic").Get() == 1
    assert surface_input(pxr, metal, "roughness").Get() == pytest.approx(0.2**0.5)
    emitted = surface_input(pxr, metal, "emissiveColor").Get()
    np.testing.assert_allclose(emitted, 683 * np.array([3, 2, 1]), rtol=1e-6)
    assert surface_input(pxr, glass, "ior").Get() == pytest.approx(1.5, abs=1e-3)
    # The reflectance of smooth glass at normal incidence.
    assert surface_input(pxr, glass, "opacity").Get() == pytest.approx(0.04, abs=1e-3)
    image = surface_input(pxr, textured, "diffuseColor").GetConnectedSources()[0][0].source
    path = pxr.UsdShade.Shader(image).GetInput("file").Get().resolvedPath
    from PIL import Image

    with Image.open(path) as opened:
        np.testing.assert_array_equal(np.asarray(opened), small_geometry().images[1])
    material = pxr.UsdShade.MaterialBindingAPI(glass).ComputeBoundMaterial()[0]
    standard = material.ComputeSurfaceSource("mtlx")[0]
    assert standard.GetInput("transmission").Get() == 1
    assert standard.GetInput("specular_IOR").Get() == pytest.approx(1.5, abs=1e-3)


def test_the_variant_off_shows_no_emission(pxr, tmp_path):
    asset = with_geometry(every_material())
    lumitree.export(asset, tmp_path / "lamp.usda")
    stage = pxr.Usd.Stage.Open(str(tmp_path / "lamp.usda"))
    glow = stage.GetDefaultPrim().GetVariantSets().GetVariantSet("glow")
    assert glow.GetVariantSelection() == "on"
    for selection, emits in (("on", True), ("off", False)):
        glow.SetVariantSelection(selection)
        for prim in meshes_of(pxr, stage):
            assert bool(surface_input(pxr, prim, "emissiveColor")) == emits


@pytest.mark.parametrize("suffix", [".usda", ".usdz"])
def test_the_validators_of_usd_find_nothing(pxr, tmp_path, suffix):
    geometry = every_material()
    to_uv = rows_of(np.diag([2.0, 3, 1, 1]))
    moved = dataclasses.replace(TEXTURE, to_uv=to_uv, filter_type="nearest")
    masked = Mask(opacity=moved, nested=(MATERIALS[1],))
    shape = dataclasses.replace(geometry.shapes[0], material=len(MATERIALS))
    geometry = dataclasses.replace(
        geometry,
        materials=(*geometry.materials, masked),
        shapes=(
            shape,
            *(dataclasses.replace(each, radiance=None) for each in geometry.shapes[1:8]),
            *geometry.shapes[8:],
        ),
    )
    asset = dataclasses.replace(with_geometry(geometry), luminaire="12 every @material@, ö")
    path = tmp_path / f"every one{suffix}"
    lumitree.export(asset, path)
    assert problems(path) == []


def test_a_package_holds_layers_and_images_only(pxr, tmp_path):
    from lumitree.rendering.asset_flux import asset_watts

    asset = with_geometry(small_geometry())
    result = lumitree.export(asset, tmp_path / "lamp.usdz")
    assert os.listdir(tmp_path) == ["lamp.usdz"]
    with zipfile.ZipFile(result.file) as archive:
        names = archive.namelist()
    assert names[0] == "lamp.usdc"
    assert {os.path.splitext(name)[1] for name in names} == {".usdc", ".png"}
    assert any("same in all directions" in line for line in result.not_carried_over)
    stage = pxr.Usd.Stage.Open(str(result.file))
    flux = sum(flux_of(prim, 4 * np.pi) for prim in lights_of(pxr, stage))
    np.testing.assert_allclose(flux, asset_watts(asset), rtol=1e-6)
    assert len(meshes_of(pxr, stage)) == 3


def test_a_missing_package_is_explained(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "pxr", None)
    with pytest.raises(LumitreeError, match=r"need the package usd-core .* 'lumitree\[usd\]'"):
        lumitree.export(lamp(), tmp_path / "lamp.usda")
    lumitree.save(lamp(), tmp_path / "lamp.lumitree")
    before = sorted(os.listdir(tmp_path))
    arguments = ["export", str(tmp_path / "lamp.lumitree"), "-o", str(tmp_path / "lamp.usdz")]
    assert main(arguments) == 2
    assert "usd-core" in capsys.readouterr().err
    assert sorted(os.listdir(tmp_path)) == before
