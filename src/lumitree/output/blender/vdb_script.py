"""Writes grids of OpenVDB; run by Blender, with an archive of NumPy and the output's name.

Blender brings the module `openvdb`, which no package of Python's index offers alone.
"""

import os
import sys

import bpy  # type: ignore[import-not-found]
import numpy as np


def find_openvdb():
    """The module; the package bpy has it in a folder that is not on the path of imports."""
    version = f"python{sys.version_info[0]}.{sys.version_info[1]}"
    root = bpy.utils.resource_path("LOCAL")
    sys.path.append(os.path.join(root, "python", "lib", version, "site-packages"))
    try:
        import openvdb  # type: ignore[import-not-found]
    except ImportError:
        sys.exit("this Blender has no module openvdb; Blender 4.4 and newer have it")
    return openvdb


def main(source, output):
    openvdb = find_openvdb()
    arrays = np.load(source, allow_pickle=False)
    # OpenVDB multiplies rows by matrices.
    transform = openvdb.createLinearTransform(arrays["transform"].T.tolist())
    grids = []
    for name, kind in (("density", openvdb.FloatGrid), ("emission", openvdb.Vec3SGrid)):
        grid = kind()
        grid.name, grid.transform = name, transform
        boxes = zip(*(arrays[key].tolist() for key in ("first", "last", name)))  # noqa: B905
        for first, last, value in boxes:
            grid.fill(tuple(first), tuple(last), tuple(value) if name == "emission" else value)
        grids.append(grid)
    openvdb.write(output, grids=grids)


if __name__ == "__main__":
    main(*sys.argv[-2:])
