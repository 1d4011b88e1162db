"""Changes of the arrays within the streams of a file's tensors."""

import json

from lumitree.asset import field_file, geometry_file, light_field_file
from lumitree.asset.array_stream import compressed, decompressed
from lumitree.core.tables import converted


def change_field_arrays(tensors, asset, change):
    """Change the arrays of `field.stream`: occupied, leaf, density and coefficients.

    Args:
        tensors: of the file, by name.
        asset: that the file holds.
        change: takes the arrays by name, and changes them; not their shapes.
    """
    layouts = field_file.field_layouts(len(asset.children), asset.num_leaves, asset.l_max)
    _change(tensors, "field.stream", layouts, change)


def change_light_arrays(tensors, field, change):
    """Change the arrays of `light.stream`, as `change_field_arrays` does.

    Args:
        field: the light field that the file holds; names of its light inside begin with "inside.".
    """
    _, description = light_field_file.stored_light_field(field)
    description = converted(description, light_field_file.LightDescription)
    _change(tensors, "light.stream", light_field_file.layouts_of(description), change)


def change_geometry_arrays(tensors, change):
    """Change the arrays of `geometry.stream`, as `change_field_arrays` does."""
    rows = json.loads(tensors["geometry.shapes"].tobytes())["arrays"]
    _change(tensors, "geometry.stream", geometry_file._layouts(rows), change)


def _change(tensors, name, layouts, change):
    arrays = decompressed(tensors[name], layouts, name)
    change(arrays)
    tensors[name] = compressed(arrays, layouts)
