"""With one thread, as on a single core, OpenEXR images are written and read."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np

from support.variant import VARIANT

# Far more than it takes; else a process that waits for ever would stop the tests.
LIMIT = 300


def test_images_are_written_and_read_by_one_thread(tmp_path):
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, __file__, str(tmp_path)]
    run = subprocess.run(
        command, env=environment, capture_output=True, text=True, timeout=LIMIT, check=False
    )
    assert run.returncode == 0, run.stderr
    assert run.stdout.split() == ["written", "loaded", "stored", "1"]


def main(folder):
    """A model with a texture that is written, and the steps that its bake takes."""
    from lumitree.core.backend import load_mitsuba, second_thread, use_threads
    from lumitree.lamp.loading import load_luminaire
    from lumitree.lamp.meshes import Mesh
    from lumitree.lamp.parts import Diffuse, Geometry, Material, Part, Texture
    from lumitree.lamp.scene_writer import write_scene
    from lumitree.lamp.stored_geometry import stored_geometry

    use_threads(1)
    load_mitsuba(VARIANT)
    corners = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    mesh = Mesh(corners, np.tile([0.0, 0, 1], (4, 1)), faces, corners[:, :2])
    radiance = Texture(np.full((64, 64, 3), (40, 20, 2.5), np.float32), False)
    material = Material("light", Diffuse(), radiance=radiance)
    path = write_scene(Geometry((Part("panel", mesh, "light", (np.eye(4),)),), (material,)), folder)
    print("written")
    luminaire = load_luminaire(path)
    print("loaded")
    assert len(stored_geometry(luminaire).images) == 1
    print("stored")

    import drjit as dr

    with second_thread():
        # As plugins do that are created meanwhile.
        load_mitsuba()
        assert dr.thread_count() == 2
    print(dr.thread_count())


if __name__ == "__main__":
    main(Path(sys.argv[1]))
