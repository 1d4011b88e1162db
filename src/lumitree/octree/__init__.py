"""Octrees: building, extraction from a field that can be queried, and the field on the device.

`field.Field` holds one copy of an asset on the device. A query integrates along the whole ray,
independently of its origin, and visits the cells on it in integer coordinates (`traversal`): each
step crosses a plane, so a traversal always ends, also of axis-parallel and grazing rays. The levels
of the octree are joined into wide nodes (`wide_nodes`). Inside a leaf density and emission are
constant, so the integral has a closed form. `coarse` is the field of lower resolution that shadows
take beside a light field. `tests/support/reference_field.py` is the reference implementation: it
intersects every leaf with the ray, sorts, and integrates in double precision.
"""
