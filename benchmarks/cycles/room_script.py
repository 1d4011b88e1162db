"""Renders a lamp in a room by Cycles; run by Blender, with a JSON file as its argument.

The keys of the file are the fields of `room.CyclesJob`.
"""

import json
import os
import runpy
import sys
import time

import bpy  # type: ignore[import-not-found]
import numpy as np
from mathutils import Matrix, Vector  # type: ignore[import-not-found]


def z_up(point):
    x, y, z = point
    return Vector((x, -z, y))


def add_walls(scene, walls, node_tree):
    for name, wall in walls.items():
        centre, first, second = (z_up(wall[key]) for key in ("centre", "first", "second"))
        corners = [centre + s * first + t * second for s, t in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
        mesh = bpy.data.meshes.new(name)
        mesh.from_pydata(corners, [], [(0, 1, 2, 3)])
        material = bpy.data.materials.new(name)
        tree = node_tree(material)
        tree.nodes.clear()
        bsdf = tree.nodes.new("ShaderNodeBsdfDiffuse")
        bsdf.inputs["Color"].default_value = [*wall["reflectance"], 1.0]
        output = tree.nodes.new("ShaderNodeOutputMaterial")
        tree.links.new(bsdf.outputs[0], output.inputs["Surface"])
        mesh.materials.append(material)
        scene.collection.objects.link(bpy.data.objects.new(name, mesh))


def add_camera(scene, camera):
    data = bpy.data.cameras.new("camera")
    data.sensor_fit = "HORIZONTAL"
    if "fov" in camera:
        data.angle = np.radians(camera["fov"])
    else:
        data.type, data.ortho_scale = "ORTHO", camera["width"]
    data.clip_start = 0.01
    thing = bpy.data.objects.new("camera", data)
    origin, target = z_up(camera["origin"]), z_up(camera["target"])
    turn = (target - origin).to_track_quat("-Z", "Y").to_matrix().to_4x4()
    thing.matrix_world = Matrix.Translation(origin) @ turn
    scene.collection.objects.link(thing)
    scene.camera = thing


def make_explicit(collection):
    """Take the lights away, and let the lamp's surfaces emit and cast shadows."""
    for thing in list(collection.objects):
        if thing.type == "LIGHT":
            bpy.data.objects.remove(thing)
        elif thing.type == "MESH":
            thing.visible_shadow = thing.visible_diffuse = True
            nodes = thing.data.materials[0].node_tree
            for node in nodes.nodes:
                if node.name.startswith("lumitree visible"):
                    for socket in node.inputs:
                        for link in list(socket.links):
                            nodes.links.remove(link)
                        socket.default_value = 1.0


def set_up(scene, job, node_tree):
    scene.render.engine = "CYCLES"
    scene.render.resolution_x, scene.render.resolution_y = job["width"], job["height"]
    scene.render.resolution_percentage = 100
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    cycles = scene.cycles
    cycles.device, cycles.samples = "CPU", job["samples"]
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = cycles.blur_glossy = 0.0
    cycles.light_sampling_threshold = 0.0
    cycles.pixel_filter_type = "BOX"
    if job["pixel_centres"]:
        # The width of a box cannot be changed.
        cycles.pixel_filter_type, cycles.filter_width = "BLACKMAN_HARRIS", 0.01
    cycles.max_bounces = job["bounces"]
    cycles.glossy_bounces = cycles.transmission_bounces = job["bounces"]
    cycles.transparent_max_bounces = cycles.volume_bounces = job["bounces"]
    cycles.diffuse_bounces = job["diffuse_bounces"]
    cycles.use_guiding = job["guiding"]
    scene.render.use_persistent_data = job["warm_up"]
    scene.world = bpy.data.worlds.new("black")
    scene.world.color = (0.0, 0.0, 0.0)
    node_tree(scene.world).nodes.clear()


def render(scene, path):
    """Image [H, W, 3], the upper row first."""
    scene.render.filepath = path
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(path)
    pixels = np.empty(image.size[0] * image.size[1] * 4, np.float32)
    image.pixels.foreach_get(pixels)
    shape = image.size[1], image.size[0], 4
    bpy.data.images.remove(image)
    os.remove(path)
    return pixels.reshape(shape)[::-1, :, :3]


def timed(scene, path):
    """Image [H, W, 3], and its wall and CPU seconds."""
    start, start_cpu = time.perf_counter(), time.process_time()
    image = render(scene, path)
    return image, time.perf_counter() - start, time.process_time() - start_cpu


def main(path):
    with open(path, encoding="utf-8") as file:
        job = json.load(file)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    lamp = runpy.run_path(job["lamp"], run_name="lamp")
    set_up(scene, job, lamp["node_tree"])
    collection = lamp["add_lamp"](scene)
    (empty,) = (thing for thing in collection.objects if thing.type == "EMPTY")
    empty.location = z_up(job["at"])
    empty.scale = [job["scale"]] * 3
    empty["gain"] = job["gain"]
    empty.update_tag()
    if job["explicit"]:
        make_explicit(collection)
    if job["room"] is None:
        add_walls(scene, job["walls"], lamp["node_tree"])
    else:
        make_explicit(runpy.run_path(job["room"], run_name="room")["add_lamp"](scene))
    add_camera(scene, job["camera"])
    path = os.path.join(job["folder"], "image.exr")
    samples, fixed, share = job["samples"], (0.0, 0.0), 1.0
    if job["warm_up"]:
        scene.cycles.samples = 1
        render(scene, path)
        _, *fixed = timed(scene, path)
        scene.cycles.samples, share = samples, samples / (samples - 1)
    images, seconds, cpu_seconds = [], [], []
    for seed in job["seeds"]:
        scene.cycles.seed = seed
        image, wall, cpu = timed(scene, path)
        images.append(image)
        seconds.append((wall - fixed[0]) * share)
        cpu_seconds.append((cpu - fixed[1]) * share)
    np.savez(
        os.path.join(job["folder"], "result.npz"),
        images=images,
        seconds=seconds,
        cpu_seconds=cpu_seconds,
        version=bpy.app.version_string,
    )


if __name__ == "__main__":
    main(sys.argv[-1])
