"""Overrides: what each key does, what lumens mean, and one line for everything that is wrong."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest
import trimesh

from lumitree.asset.geometry import Medium
from lumitree.asset.materials import Dielectric, Diffuse, MetallicRoughness, ThinDielectric
from lumitree.core.photometry import blackbody_colour, flux_from_radiance
from lumitree.errors import LumitreeError, LumitreeWarning
from lumitree.lamp.importers.overrides import (
    apply_overrides,
    check_emits,
    read_overrides,
    select_parts,
)
from lumitree.lamp.materials import MaskedEmission, Material, glass, metal
from lumitree.lamp.meshes import Mesh
from lumitree.lamp.parts import Geometry, Part


def box(sides=(1, 1, 1), open_faces=0):
    mesh = trimesh.creation.box(sides)
    normals = np.asarray(mesh.vertex_normals)
    return Mesh(np.asarray(mesh.vertices), normals, np.asarray(mesh.faces)[open_faces:])


HERE = (np.eye(4),)


def lamp(mesh=None, places=HERE):
    return Geometry(
        (Part("shade", box(), "steel"), Part("bulb", mesh or box(), "bulb glass", places)),
        (Material("steel", Diffuse()), Material("bulb glass", Diffuse(), opacity=0.3)),
    )


@pytest.fixture
def written(tmp_path):
    def write(text):
        path = tmp_path / "lamp.toml"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return read_overrides(path)

    return write


@pytest.fixture
def changed(written):
    """Function of the lines of [material."bulb glass"] (and a model): the material."""

    def change(lines, model=None, head=""):
        overrides = written(head + '\n[material."bulb glass"]\n' + lines)
        return apply_overrides(model or lamp(), overrides).materials[1]

    return change


def test_glass_by_every_key(changed):
    found = changed("glass = { ior = 1.6, tint = [1, 0.9, 0.8], thin = true }")
    assert found.surface == glass(1.6, tint=(1, 0.9, 0.8), thin=True)
    assert found.opacity == 1
    assert found.bsdf == found.surface
    found = changed("glass = { roughness = 0.2, absorption = [1, 2, 3], scattering = 4 }")
    assert found.surface == glass(1.5, 0.2)
    assert found.medium == Medium((1, 2, 3), (4, 4, 4))


def test_other_surfaces(changed):
    assert changed('metal = { conductor = "Au", roughness = 0.3 }').surface == metal(
        roughness=0.3, conductor="Au"
    )
    assert changed("metal = { tint = [1, 0.5, 0.25] }").surface == metal((1, 0.5, 0.25))
    assert changed("diffuse = { reflectance = 0 }").surface == Diffuse(reflectance=(0, 0, 0))
    found = changed("principled = { base_color = 0.2, metallic = 1, roughness = 0 }\nopacity = 0.5")
    assert found.surface == MetallicRoughness(
        base_color=(0.2, 0.2, 0.2), metallic=1.0, roughness=0.0
    )
    assert (found.opacity, found.two_sided) == (0.5, True)


def test_what_is_not_named_stays(changed):
    found = changed("emitter = { radiance = 5 }")
    assert found.surface == Diffuse()
    assert found.opacity == 0.3
    assert changed("opacity = 1").radiance is None


def test_emission_follows_the_opacity_of_the_override(written):
    """The radiance of the file is kept where the surface is present; a flux is kept in all."""
    model = lamp()
    first, _ = model.materials
    model = dataclasses.replace(
        model, materials=(first, Material("bulb glass", Diffuse(), (2.0, 2.0, 2.0), opacity=0.5))
    )

    def emitted(lines):
        found = apply_overrides(model, written('[material."bulb glass"]\n' + lines))
        radiance = MaskedEmission([]).of(found.materials[1])
        return radiance[0], 6 * np.pi * radiance[1]

    assert emitted("opacity = 1")[0] == 2
    assert emitted("diffuse = {}")[0] == 2
    assert emitted("opacity = 0.25")[0] == 0.5
    assert emitted("emitter = { radiance = 3 }")[0] == 1.5
    for lines in ("", "opacity = 1\n", "opacity = 0.25\n"):
        assert emitted(lines + "emitter = { lumens = 683 }")[1] == pytest.approx(1)


def test_open_or_partly_open_glass_is_reported(changed):
    with pytest.warns(LumitreeWarning, match="'bulb glass' is solid glass, but only 0 of its 1"):
        found = changed("glass = { thin = false }", lamp(box(open_faces=2)))
    assert isinstance(found.surface, Dielectric)
    apart = box()
    both = Mesh(
        np.concatenate([apart.vertices, apart.vertices + 5]),
        np.concatenate([apart.normals, apart.normals]),
        np.concatenate([apart.faces, apart.faces[3:] + 8]),
    )
    with pytest.warns(LumitreeWarning, match="1 of 2 pieces are closed"):
        assert isinstance(changed("glass = {}", lamp(both)).surface, ThinDielectric)


def test_lumens_are_shared_by_all_copies_in_metres(mi, changed):
    """A box of 2 x 3 x 4 cm, once as it is, once twice as large and turned: 52 and 208 cm²."""
    turn = np.diag([2.0, 2.0, 2.0, 1.0])
    turn[:3, :3] = turn[:3, :3] @ np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    model = lamp(box((2, 3, 4)), (np.eye(4), turn))
    text = "emitter = { lumens = 800, temperature = 2700 }"
    found = changed(text, model, 'units = "cm"').radiance
    # 0.3 of the surface is present.
    assert flux_from_radiance(found, 0.3 * 260e-4) == pytest.approx(800)
    assert found[0] / found[1] == pytest.approx(np.divide(*blackbody_colour(2700)[:2]))
    white = changed("emitter = { lumens = 800 }", model, "units = 0.01").radiance
    assert white == pytest.approx([800 / (683 * np.pi * 0.3 * 260e-4)] * 3)


def test_units_and_up_axis_move_the_lamp(written):
    model = apply_overrides(lamp(), written('units = "mm"\nup = "z"'))
    place = model.parts[0].places[0]
    np.testing.assert_allclose(place @ [1, 2, 3, 1], [0.001, 0.003, -0.002, 1])
    np.testing.assert_allclose(np.linalg.det(place[:3, :3]), 1e-9)


def test_media_of_the_file_are_rescaled_and_those_of_overrides_are_per_metre(written):
    model = lamp()
    tinted = Material("bulb glass", glass(), medium=Medium((0.5, 0, 0)), two_sided=True)
    model = dataclasses.replace(model, materials=(model.materials[0], tinted))
    kept = apply_overrides(model, written('units = "cm"')).materials[1]
    assert kept.medium.absorption == pytest.approx((50, 0, 0))
    text = 'units = "cm"\n[material."bulb glass"]\nglass = { absorption = [50, 0, 0] }'
    assert apply_overrides(model, written(text)).materials[1] == kept


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("units =", "not valid TOML"),
        (b"units = '\xff'", "not valid TOML"),
        ("a = " + "[" * 5000, "not valid TOML"),
        ("unit = 'm'", "unknown key 'unit'; did you mean 'units'?"),
        ("units = 'km'", "units is 'km'; expected one of m, cm"),
        ("units = 0", "units is '0'"),
        ("up = 'x'", "up is 'x'; expected 'y' or 'z'"),
        ("variant = 3", "variant is '3'; expected a text"),
        ("material.a = 3", "material.a is '3'; expected a table"),
        ("[material.a]\nglas = {}", "unknown key 'material.a.glas'"),
        ("[material.a]\nglass = 1", "material.a.glass is '1'; expected a table"),
        ("[material.a]\nglass = { ior = 1 }", "glass.ior is '1'; expected a number above 1"),
        ("[material.a]\nglass = { thin = 1 }", "glass.thin is '1'; expected true or false"),
        ("[material.a]\nglass = { tint = [1, 1, 1.5] }", "glass.tint"),
        ("[material.a]\nglass = { absorption = -1 }", "glass.absorption is '-1'"),
        ("[material.a]\nglass = { thin = true, roughness = 0.1 }", "a thin sheet has no roughness"),
        ("[material.a]\nglass = {}\nmetal = {}", "material.a has 2 surfaces"),
        ("[material.a]\nmetal = { conductor = 'brass' }", "conductor is 'brass'; expected Ag"),
        ("[material.a]\nopacity = -0.5", "opacity is '-0.5'"),
        ("[material.a]\nemitter = {}", "needs either radiance or lumens"),
        ("[material.a]\nemitter = { radiance = 1, lumens = 1 }", "needs either radiance or lumens"),
        ("[material.a]\nemitter = { radiance = -1 }", "emitter.radiance is '-1'"),
        (f"[material.a]\nemitter = {{ lumens = {10**400} }}", "emitter.lumens is '1000"),
        ("[material.a]\nemitter = { lumens = 8, temperature = 50 }", "emitter.temperature is '50'"),
        ("[material.a]\nemitter = { radiance = [1, 2, 3], temperature = 3000 }",
         "its radiance has to be one number"),
    ],
)  # fmt: skip
def test_wrong_files(written, text, message):
    with pytest.raises(LumitreeError, match=r"lamp\.toml(:| is) ") as caught:
        written(text)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400


def test_documented_and_example_files_are_valid(tmp_path):
    root = Path(__file__).parents[3]
    page = (root / "docs" / "bring-your-own-lamp.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```toml\n(.*?)```", page, flags=re.S)
    examples = sorted((root / "examples" / "overrides").glob("*.toml"))
    assert len(blocks) == 1
    assert len(examples) >= 3
    (tmp_path / "page.toml").write_text(blocks[0], encoding="utf-8")
    assert len(read_overrides(tmp_path / "page.toml").materials) == 5
    for path in examples:
        found = read_overrides(path)
        assert found.metres_per_unit in (0.01, 1.0)
        assert any(change.emission for change in found.materials.values())


def test_wrong_names_and_missing_files(written, tmp_path):
    with pytest.raises(LumitreeError, match=r"no material is called 'bulb'.*steel, bulb glass"):
        apply_overrides(lamp(), written("[material.bulb]\nopacity = 1"))
    with pytest.raises(LumitreeError, match=r"no\.toml does not exist"):
        read_overrides(tmp_path / "no.toml")
    (tmp_path / "big.toml").write_bytes(b"#" * (2**20 + 1))
    with pytest.raises(LumitreeError, match="larger than 1 MiB"):
        read_overrides(tmp_path / "big.toml")


def test_lumens_need_an_area(changed):
    flat = box()
    flat = dataclasses.replace(flat, vertices=np.zeros_like(flat.vertices))
    with pytest.raises(LumitreeError, match="'bulb glass' has no area"):
        changed("emitter = { lumens = 5 }", lamp(flat))


def test_parts_are_kept_and_dropped_by_name_or_material():
    model = lamp()

    def names(keep=(), drop=()):
        return [part.name for part in select_parts(model, keep, drop, "lamp.obj").parts]

    assert names() == ["shade", "bulb"]
    assert names(keep=["bulb*"]) == names(keep=["bulb glass"]) == names(drop=["st??l"]) == ["bulb"]
    assert names(keep=["*"], drop=["bulb"]) == ["shade"]
    with pytest.raises(LumitreeError, match=r"--keep 'x\*' matches no .*shade, steel, bulb"):
        names(keep=["bulb", "x*"])
    with pytest.raises(LumitreeError, match="--drop 'Bulb' matches no"):
        names(drop=["Bulb"])
    with pytest.raises(LumitreeError, match="leave nothing"):
        names(drop=["*"])


def test_lamp_without_light_gives_an_error_with_an_example():
    import tomllib

    with pytest.raises(
        LumitreeError, match=r"no emitter \(materials: steel, bulb glass\)"
    ) as caught:
        check_emits(lamp(), "lamp.obj", "lamp.toml")
    advice = str(caught.value).partition("lamp.toml: ")[2]
    assert tomllib.loads(advice)["material"]["steel"]["emitter"]["lumens"] == 800
    assert "\n" not in str(caught.value)
