"""Objects of Mitsuba that `mitsuba.load_dict` does not make, or not always in the same order."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

import drjit as dr
import mitsuba as mi

_STEPS: deque[Callable[[], object]] = deque()
_LOCK = threading.Lock()


def make_properties(plugin: str, values: Mapping[str, object]) -> mi.Properties:
    """Properties of a plugin; values may be objects."""
    properties = mi.Properties(plugin)
    for name, value in values.items():
        properties[name] = value
    return properties


def make_object(plugin: str, values: Mapping[str, object]) -> Any:
    """The object of a plugin; an object that contains several is not expanded into them."""
    return mi.PluginManager.instance().create_object(make_properties(plugin, values))


def shape_number(shape: mi.Shape) -> int:
    """The number that stands for a shape in arrays of mi.ShapePtr."""
    return int(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape))[0])


def shape_of(number: int) -> mi.Shape:
    """The shape of a number."""
    return dr.reinterpret_array(mi.ShapePtr, mi.UInt32(number))[0]


def medium_number(medium: mi.Medium) -> int:
    """The number that stands for a medium in arrays of mi.MediumPtr."""
    return int(dr.reinterpret_array(mi.UInt32, mi.MediumPtr(medium))[0])


def load_ordered(description: Mapping[str, object]) -> Any:
    """`mitsuba.load_dict`, with shapes and emitters in the order of the dictionary, in one thread.

    `load_dict` merges meshes, and then brings shapes into an order that differs from one call to
    the next: emitters are numbered differently, and equal seeds do not give equal images. It also
    creates objects as parallel tasks. A task that waits for others executes them within itself.
    """
    config = mi.parser.ParserConfig(mi.variant())
    config.merge_meshes = config.parallel = False
    state = mi.parser.parse_dict(config, dict(description))
    mi.parser.transform_all(config, state)
    return mi.parser.instantiate(config, state)


def complete_later(step: Callable[[], object]) -> None:
    """Do a step of the creation of a plugin that waits for the device; one at a time.

    Mitsuba creates plugins as parallel tasks, and a thread that waits for the device executes other
    tasks meanwhile. Otherwise plugins would be created within each other, each with its tables.
    If a step is being done, this one is done after it, by the same thread. Mitsuba creates the
    scene when all tasks are completed.
    """
    _STEPS.append(step)
    while _STEPS and _LOCK.acquire(blocking=False):
        try:
            while _STEPS:
                _STEPS.popleft()()
        except BaseException:
            _STEPS.clear()
            raise
        finally:
            _LOCK.release()
