"""IES files of Types A, B and C, written without the package.

The frame is the same as in `formats.type_c`: y is up, C = 0 is towards +x, C = 90 towards -z.
"""

import numpy as np


def world(kind, horizontal, vertical):
    """Directions [H, V, 3] of a pair of angles; each type by its own formula."""
    h, v = np.deg2rad(np.broadcast_arrays(horizontal[:, None], vertical))
    if kind == "A":
        # H is clockwise seen from above, from +x to +z; V is the elevation.
        parts = np.cos(v) * np.cos(h), np.sin(v), np.cos(v) * np.sin(h)
    elif kind == "B":
        # V turns about the z axis from down to +x; H is the elevation towards +z.
        parts = np.cos(h) * np.sin(v), -np.cos(h) * np.cos(v), np.sin(h)
    else:
        # H is counter-clockwise seen from above, from +x to -z; V is the angle from down.
        parts = np.sin(v) * np.cos(h), -np.cos(v), -np.sin(v) * np.sin(h)
    return np.stack(parts, axis=-1)


def ies(kind, horizontal, vertical, intensity):
    """Text of a file."""
    rows = [vertical, horizontal, *intensity]
    numbers = "\n".join(" ".join(f"{value:.7g}" for value in row) for row in rows)
    code = {"C": 1, "B": 2, "A": 3}[kind]
    return (
        f"IESNA:LM-63-2002\n[TEST] own\nTILT=NONE\n1 -1 1 {len(vertical)} {len(horizontal)} {code} "
        f"2 0.4 0.2 0\n1 1 10\n{numbers}\n"
    )
