"""Octrees: building, extraction from a field that can be queried, and the field on the device.

`field.Field` holds one copy of an asset on the device. A query integrates along the whole ray,
independently of its origin, and visits the cells on it in integer coordinates (`traversal`): each
step crosses a plane, so a traversal always ends, also of axis-parallel and grazing rays. The levels
of the octree are joined into wide nodes (`build.wide_nodes`). Inside a leaf density and emission
are constant, so the integral has a closed form. Beside a light field, shadows take a field of lower
resolution (`field.coarsened`). The reference implementation, `tests/support/reference_field.py`,
intersects every leaf with the ray, sorts, and integrates in double precision.
"""
