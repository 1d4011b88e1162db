"""Objects of Mitsuba from properties that dictionaries of `mitsuba.load_dict` cannot express."""

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
