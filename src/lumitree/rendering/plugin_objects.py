"""Objects of Mitsuba that `mitsuba.load_dict` does not make, or not always in the same order."""

from collections.abc import Mapping
from typing import Any

import mitsuba as mi


def make_properties(plugin: str, values: Mapping[str, Any]) -> Any:
    """The mi.Properties of a plugin; values may be objects."""
    properties = mi.Properties(plugin)
    for name, value in values.items():
        properties[name] = value
    return properties


def make_object(plugin: str, values: Mapping[str, Any]) -> Any:
    """The object of a plugin, as it is: one that holds several is not expanded into them."""
    return mi.PluginManager.instance().create_object(make_properties(plugin, values))


def load_ordered(description: Mapping[str, Any]) -> Any:
    """`mitsuba.load_dict` for a scene, with shapes and emitters in the order of the dictionary.

    `load_dict` merges meshes, and then brings shapes into an order that differs from one call to
    the next: emitters are numbered differently, and equal seeds do not give equal images.
    """
    config = mi.parser.ParserConfig(mi.variant())
    config.merge_meshes = False
    state = mi.parser.parse_dict(config, dict(description))
    mi.parser.transform_all(config, state)
    return mi.parser.instantiate(config, state)
