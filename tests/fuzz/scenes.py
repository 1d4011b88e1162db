"""Mitsuba scenes as lamps and as rooms, with the files that they name."""

import functools
import tempfile
from pathlib import Path

import numpy as np
import trimesh

from fuzz import words, xml_trees
from fuzz.models import changed_image, images
from fuzz.reader import MEBIBYTE, Reader
from fuzz.values import chance, pick
from lumitree.core.images import write_exr
from support.damage import damaged

_SPD = b"# a comment\n400 1\n500 4\n600 2.5\n700 0.5\n"
_LAMP = """<scene version="3.0.0">
<bsdf type="diffuse" id="white"><rgb name="reflectance" value="0.5, 0.4, 0.3"/></bsdf>
<bsdf type="twosided" id="both"><bsdf type="roughconductor"><string name="material" value="Al"/>
<float name="alpha" value="0.2"/></bsdf></bsdf>
<bsdf type="dielectric" id="glass"><float name="int_ior" value="1.5"/></bsdf>
<medium type="homogeneous" id="fog"><rgb name="sigma_t" value="0.5, 0.4, 0.3"/>
<rgb name="albedo" value="0"/></medium>
<shape type="sphere" id="bulb"><float name="radius" value="0.2"/><point name="center" x="0" y="0.1"
 z="0"/><ref id="white"/><emitter type="area"><rgb name="radiance" value="3, 2, 1"/></emitter>
</shape>
<shape type="cube" id="envelope"><transform name="to_world"><scale x="0.5" y="0.6" z="0.5"/>
<rotate y="1" angle="30"/><translate x="0" y="0.1" z="0"/></transform><ref id="glass"/>
<ref id="fog" name="interior"/></shape>
<shape type="rectangle" id="sheet"><transform name="to_world"><matrix value="0.3 0 0 0 0 0.3 0 0.7
 0 0 0.3 0 0 0 0 1"/></transform><bsdf type="diffuse"><texture type="bitmap" name="reflectance">
<string name="filename" value="image.png"/></texture></bsdf><emitter type="area">
<spectrum name="radiance" filename="led.spd"/></emitter></shape>
<shape type="ply" id="mesh"><string name="filename" value="mesh.ply"/><ref id="both"/></shape>
<shape type="obj" id="other"><string name="filename" value="mesh.obj"/><ref id="both"/>
<emitter type="area"><spectrum name="radiance" value="400:1, 500:2, 700:0.5"/></emitter></shape>
<shape type="cylinder" id="tube"><point name="p0" x="0" y="0" z="0"/><point name="p1" x="0" y="1"
 z="0"/><float name="radius" value="0.05"/><bsdf type="principled"><rgb name="base_color"
 value="0.8, 0.2, 0.1"/><float name="roughness" value="0.4"/></bsdf></shape>
</scene>"""
_ROOM = """<scene version="3.0.0">
<default name="spp" value="1"/>
<integrator type="path"><integer name="max_depth" value="4"/></integrator>
<sensor type="perspective"><float name="fov" value="45"/><transform name="to_world"><lookat
 origin="0, 1, 5" target="0, 1, 0" up="0, 1, 0"/></transform><film type="hdrfilm"><integer
 name="width" value="4"/><integer name="height" value="4"/><rfilter type="box"/></film>
<sampler type="independent"><integer name="sample_count" value="$spp"/></sampler></sensor>
<shape type="rectangle" id="floor"><transform name="to_world"><rotate x="1" angle="-90"/>
<scale value="3"/></transform><bsdf type="diffuse"><texture type="bitmap" name="reflectance">
<string name="filename" value="image.png"/></texture></bsdf></shape>
<shape type="ply" id="table"><string name="filename" value="mesh.ply"/><bsdf type="plastic"/>
</shape>
<emitter type="envmap"><string name="filename" value="sky.exr"/></emitter>
</scene>"""


@functools.cache
def _files():
    """Files that scenes name."""
    ball = trimesh.creation.icosphere(subdivisions=0, radius=0.1)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        ball.export(folder / "mesh.ply", encoding="binary")
        ball.export(folder / "ascii.ply", encoding="ascii")
        ball.export(folder / "mesh.obj")
        sky = np.random.default_rng(0).random((4, 8, 3)).astype(np.float32)
        write_exr(folder / "sky.exr", {"RGB": sky})
        result = {path.name: path.read_bytes() for path in folder.iterdir()}
    rows = b"\x02\x02\x01\x80" * 8
    result["image.hdr"] = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 4 +X 2\n" + rows
    result["image.pfm"] = b"PF\n2 2\n-1.0\n" + np.ones(12, "<f4").tobytes()
    return result | images() | {"led.spd": _SPD}


def _scene(name, whole):
    """Function that makes a scene file, and changes it or a file that it names."""

    def made(rng):
        files = dict(_files())
        text = whole
        if chance(rng, 0.3):
            text = text.replace("mesh.ply", "ascii.ply")
        if chance(rng, 0.3):
            other = pick(rng, (*images(), "sky.exr", "image.hdr", "image.pfm"))
            text = text.replace("image.png", other)
        used = [each for each in files if f'"{each}"' in text]
        content = text.encode()
        if chance(rng, 0.35):
            content = xml_trees.nudged(content, rng)
        elif chance(rng, 0.3):
            content = xml_trees.changed(content, rng, times=1)
        elif chance(rng, 0.15):
            content = damaged(content, rng)
        else:
            chosen = pick(rng, used)
            files[chosen] = _changed_file(rng, chosen, files[chosen])
        return {name: content} | {each: files[each] for each in used}

    return made


def _changed_file(rng, name, content):
    if name in images():
        return changed_image(rng, name, content)
    if name in ("led.spd", "mesh.obj", "ascii.ply") and chance(rng, 0.8):
        return words.changed(content, rng, separators=(b" ", b" ", b"/"))
    return words.flipped(content, rng)


def _load_lamp(folder):
    from lumitree.core.backend import load_mitsuba
    from lumitree.lamp.loading import load_luminaire
    from support.variant import VARIANT

    load_mitsuba(VARIANT)
    return load_luminaire(folder / "lamp.xml")


def _sound_lamp(lamp):
    assert np.isfinite(lamp.frame.world_from_local).all()
    assert np.isfinite(lamp.size).all()
    assert np.isfinite(lamp.bounding_radius)
    assert lamp.size.max() > 0
    assert lamp.num_emitters > 0


def _use_lamp(lamp):
    from fuzz.rendering import assert_lamp_renders

    assert_lamp_renders(lamp)


def _load_room(folder):
    from lumitree.core.backend import load_mitsuba
    from lumitree.errors import explained
    from lumitree.rendering.plugins.register import register
    from support.variant import VARIANT

    load_mitsuba(VARIANT)
    register()
    from lumitree.rendering.scene import load_scene

    return explained(load_scene)(folder / "room.xml")


def _render_room(found):
    from fuzz.rendering import assert_room_renders

    assert_room_renders(*found)


READERS = (
    Reader(
        "lamp",
        _scene("lamp.xml", _LAMP),
        _load_lamp,
        _sound_lamp,
        _use_lamp,
        memory=3072 * MEBIBYTE,
        at_once=500,
        in_suite=20,
        full_share=1 / 50,
    ),
    Reader(
        "room",
        _scene("room.xml", _ROOM),
        _load_room,
        use_in_full=_render_room,
        memory=3072 * MEBIBYTE,
        at_once=500,
        in_suite=20,
        full_share=1 / 50,
    ),
)
