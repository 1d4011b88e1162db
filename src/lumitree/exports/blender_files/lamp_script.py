"""A lamp for Blender 4.2 or newer, written by lumitree. It needs no other file.

    blender --python lamp.py                                  # adds the lamp to the open scene
    blender --background --python lamp.py -- lamp.blend       # writes a file with the lamp only
    python lamp.py lamp.blend                                 # the same, with the module bpy

In Blender: Scripting, Open, Run Script. The lamp is a collection of the scene. Move, rotate and
scale its empty. Its property "gain" is a factor on the light, and "tint" has factors on red, green
and blue; "watts" is the flux without these factors at a scale of 1. Lengths are metres, z is up.
Point lights illuminate the scene. Camera rays and mirror images show the lamp's surfaces, which
neither illuminate nor cast shadows.
"""

import base64
import io
import json
import sys
from typing import Any

import bpy  # type: ignore[import-not-found]
import numpy as np

DATA = """@@DATA@@"""
# Variables of drivers: paths of properties of the lamp's empty. Besides, there is its "scale".
VARIABLES = {"gain": '["gain"]'}
VARIABLES |= {name: f'["tint"][{i}]' for i, name in enumerate(("red", "green", "blue"))}


def read_data():
    """The description, and arrays by name."""
    content = base64.b64decode(DATA)
    arrays = dict(np.load(io.BytesIO(content), allow_pickle=False))
    return json.loads(arrays.pop("description").tobytes().decode("utf-8")), arrays


class Lamp:
    """Makes the objects of the lamp."""

    def __init__(self, description, arrays):
        self.description, self.arrays, self.images = description, arrays, {}
        self.name, self.absolute = description["name"], description.get("absolute", False)
        self.collection = bpy.data.collections.new(self.name)
        self.empty = bpy.data.objects.new(self.name, None)
        self.empty.empty_display_size = description["radius"]
        self.empty["gain"] = 1.0
        self.empty.id_properties_ui("gain").update(min=0.0, description="Factor on the light")
        self.empty["tint"] = [1.0, 1.0, 1.0]
        text = "Factors on the red, green and blue of the light"
        self.empty.id_properties_ui("tint").update(min=0.0, description=text)
        for name in ("watts", "temperature", "absolute"):
            if name in description:
                self.empty[name] = description[name]
        self.collection.objects.link(self.empty)

    def build(self):
        """Make everything; returns the collection."""
        for index, light in enumerate(self.description["lights"]):
            self.add_light(index, light)
        surfaces = zip(self.description["surfaces"], self.description["absorption"], strict=True)
        for index, (tree, absorption) in enumerate(surfaces):
            self.add_mesh(index, tree, absorption)
        return self.collection

    def add(self, name, data):
        thing = bpy.data.objects.new(name, data)
        thing.parent = self.empty
        self.collection.objects.link(thing)
        return thing

    def add_light(self, index, light):
        data = bpy.data.lights.new(f"{self.name} light {index}", "POINT")
        data.shadow_soft_size = 0.0
        table = self.arrays["tables"][index].astype(np.float32)
        tree = node_tree(data)
        tree.nodes.clear()
        output = tree.nodes.new("ShaderNodeOutputLight")
        emission = tree.nodes.new("ShaderNodeEmission")
        lookup = tree.nodes.new("ShaderNodeTexEnvironment")
        lookup.image = self.new_image(data.name, table, "Non-Color", True)
        coordinates = tree.nodes.new("ShaderNodeTexCoord")
        tree.links.new(coordinates.outputs["Normal"], lookup.inputs["Vector"])
        tree.links.new(lookup.outputs["Color"], emission.inputs["Color"])
        tree.links.new(emission.outputs[0], output.inputs["Surface"])
        # Flux grows as the area of what emits, but a photometric file has its flux at any size.
        grown = "" if self.absolute else " * scale * scale"
        drive(data, "energy", self.empty, f"{light['watts']!r} * gain{grown}")
        for channel, factor in enumerate(("red", "green", "blue")):
            drive(data, "color", self.empty, factor, channel)
        self.add(data.name, data).location = light["position"]

    def add_mesh(self, index, tree, absorption):
        arrays = {
            name: self.arrays[f"{index}.{name}"]
            for name in ("vertices", "faces", "normals", "texcoords", "colours")
            if f"{index}.{name}" in self.arrays
        }
        name = f"{self.name} surface {index}"
        mesh = make_mesh(name, arrays)
        mesh.materials.append(self.make_material(name, tree, absorption))
        thing = self.add(name, mesh)
        # The point lights illuminate the scene; their light is not blocked, and not added to.
        thing.visible_shadow = thing.visible_diffuse = thing.visible_volume_scatter = False

    def make_material(self, name, tree, absorption):
        """A material with a tree, and what it absorbs per metre inside, R, G and B, or None."""
        material = bpy.data.materials.new(name)
        nodes = node_tree(material)
        nodes.nodes.clear()
        output = nodes.nodes.new("ShaderNodeOutputMaterial")
        nodes.links.new(self.make_nodes(nodes, tree), output.inputs["Surface"])
        if absorption is not None:
            # Cycles absorbs (1 - colour) * density per unit of the scene.
            density = max(*absorption, 1e-30)
            inside = nodes.nodes.new("ShaderNodeVolumeAbsorption")
            set_value(inside.inputs["Color"], [1 - each / density for each in absorption])
            drive(inside.inputs["Density"], "default_value", self.empty, f"{density!r} / scale")
            nodes.links.new(inside.outputs["Volume"], output.inputs["Volume"])
        return material

    def make_nodes(self, nodes, tree):
        """Nodes of a tree; returns the socket that it names."""
        made = nodes.nodes.new(tree["node"])
        for name, value in tree["set"].items():
            setattr(made, name, value)
        if "image" in tree:
            made.image = self.image(*tree["image"])
        if made.name == "lumitree gain":
            dimmed = " / scale / scale" if self.absolute else ""
            drive(made.outputs[0], "default_value", self.empty, f"gain{dimmed}")
        if made.name == "lumitree tint":
            for channel, factor in enumerate(("red", "green", "blue")):
                drive(made.inputs[channel], "default_value", self.empty, factor)
        for key, value in tree["inputs"].items():
            socket = made.inputs[int(key) if key.isdigit() else key]
            if isinstance(value, dict):
                nodes.links.new(self.make_nodes(nodes, value), socket)
            else:
                set_value(socket, value)
        output = tree["output"]
        return made.outputs[output]

    def image(self, index, raw):
        if (index, raw) not in self.images:
            pixels = self.arrays[f"image {index}"][::-1]
            encoded = pixels.dtype == np.uint8
            colours = pixels.astype(np.float32) / (255 if encoded else 1)
            space = "sRGB" if encoded and not raw else "Non-Color"
            name = f"{self.name} image {index}"
            self.images[index, raw] = self.new_image(name, colours, space, not encoded)
        return self.images[index, raw]

    def new_image(self, name, colours, space, as_float):
        """Image from numbers [H, W, C] in the colour space; row 0 is at v = 0 of Blender."""
        height, width, channels = colours.shape
        image = bpy.data.images.new(name, width, height, alpha=channels == 4, float_buffer=as_float)
        image.colorspace_settings.name = space
        pixels = np.ones((height, width, 4), np.float32)
        pixels[..., :3] = colours[..., :3]
        if channels == 4:
            pixels[..., 3] = colours[..., 3]
        image.pixels.foreach_set(pixels.ravel())
        image.update()
        image.pack()
        return image


def node_tree(owner: Any) -> Any:
    """The nodes of a material, a light or a world; from Blender 5 on they always have some."""
    if owner.node_tree is None:
        owner.use_nodes = True
    return owner.node_tree


def set_value(socket, value):
    """A number or a colour as the socket takes it."""
    if socket.type == "VALUE":
        socket.default_value = sum(value) / 3 if isinstance(value, list) else value
        return
    colour = value if isinstance(value, list) else [value] * 3
    socket.default_value = [*colour, 1.0] if socket.type == "RGBA" else colour


def drive(owner, path, empty, expression, channel=-1):
    """A driver by `VARIABLES` and `scale` of the lamp's empty; Blender needs no permission for it.

    Names in the expression stand between spaces. `channel` is the channel of a colour.
    """
    driver = owner.driver_add(path, channel).driver
    words = set(expression.split())
    for name in sorted(words & {"scale", *VARIABLES}):
        variable = driver.variables.new()
        variable.name = name
        if name == "scale":
            variable.type = "TRANSFORMS"
            variable.targets[0].id = empty
            variable.targets[0].transform_type = "SCALE_AVG"
            variable.targets[0].transform_space = "WORLD_SPACE"
        else:
            variable.targets[0].id = empty
            variable.targets[0].data_path = VARIABLES[name]
    driver.expression = expression


def make_mesh(name, arrays):
    """Mesh with shading normals, texture coordinates and colours, as far as there are any."""
    mesh = bpy.data.meshes.new(name)
    faces = arrays["faces"]
    mesh.from_pydata(arrays["vertices"].tolist(), [], faces.tolist())
    mesh.polygons.foreach_set("use_smooth", np.full(len(faces), "normals" in arrays))
    if "texcoords" in arrays:
        layer = mesh.uv_layers.new(name="UVMap")
        # Blender counts v from the last row of an image.
        texcoords = arrays["texcoords"] * [1, -1] + [0, 1]
        layer.data.foreach_set("uv", texcoords[faces.ravel()].astype(np.float32).ravel())
    if "colours" in arrays:
        layer = mesh.color_attributes.new("vertex_color", "FLOAT_COLOR", "POINT")
        colours = np.ones((len(arrays["colours"]), 4), np.float32)
        colours[:, :3] = arrays["colours"]
        layer.data.foreach_set("color", colours.ravel())
    mesh.update()
    if "normals" in arrays:
        mesh.normals_split_custom_set_from_vertices(arrays["normals"].tolist())
    return mesh


def add_lamp(scene):
    """Add the lamp to a scene; returns its collection."""
    collection = Lamp(*read_data()).build()
    scene.collection.children.link(collection)
    return collection


def main(arguments):
    """Add the lamp to the open scene, or write a file with it only."""
    if not arguments:
        add_lamp(bpy.context.scene)
        return
    bpy.ops.wm.read_factory_settings(use_empty=True)
    add_lamp(bpy.context.scene)
    bpy.context.preferences.filepaths.save_version = 0
    bpy.ops.wm.save_as_mainfile(filepath=arguments[0], compress=True)


def script_arguments(arguments):
    """The arguments after `--` for Blender, and after the script's name for Python."""
    if bpy.app.binary_path:
        return arguments[arguments.index("--") + 1 :] if "--" in arguments else []
    return arguments[1:]


if __name__ == "__main__":
    main(script_arguments(sys.argv))
