"""Calls of a function for many lamps, whose code is recorded once for each kind of lamp.

`dr.dispatch` records a function once for each emitter, which takes seconds of every image where
there are hundreds. Lamps of one asset differ by numbers only, which are read from a table here.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from lumitree.core.device import on_device
from lumitree.rendering.plugins.deferred_emitter import DeferredEmitter
from lumitree.rendering.plugins.lamp_light import LampLight

# Packets of four numbers of a lamp: scale, centre and rotation.
_PACKETS = 4
# Arrays that one kernel joins: with 1,000, LLVM compiles it for more than ten minutes.
_JOINED = 16


class LampKinds:
    """The emitters of a scene by kind; `emitters` and `pointers` are its two lists of them."""

    def __init__(self, emitters: list[mi.Emitter], pointers: mi.EmitterPtr) -> None:
        lamps = {i: each for i, each in enumerate(emitters) if isinstance(each, DeferredEmitter)}
        self._others = len(emitters) > len(lamps)
        kinds: dict[Hashable, int] = {}
        self._lights: list[LampLight] = []
        numbers = np.array(dr.reinterpret_array(mi.UInt32, pointers))
        # By the number of an emitter among all emitters of the process.
        kind_of = np.full(numbers.max(initial=0) + 1, len(lamps), np.uint32)
        rows = np.zeros((len(kind_of), 4 * _PACKETS))
        slot_of = np.zeros(len(kind_of), np.uint32)
        for slot, (index, lamp) in enumerate(lamps.items()):
            kind = kinds.setdefault(_kind(lamp), len(kinds))
            if kind == len(self._lights):
                self._lights.append(lamp.light())
            number = numbers[index]
            kind_of[number], slot_of[number] = kind, slot
            rows[number, :13] = lamp.placed.numbers
        self._apart = len(lamps) > len(kinds)
        if not self._apart:
            return
        kind_of[kind_of == len(lamps)] = len(kinds)
        self._kind_of, self._slot_of = on_device(mi.UInt32, kind_of), on_device(mi.UInt32, slot_of)
        self._rows = on_device(mi.Float, rows)
        self._gains = joined_colours([lamp.light().gain for lamp in lamps.values()])

    def call(self, function: Callable[..., Any], emitter: mi.EmitterPtr, *args: Any) -> Any:
        """As `dr.dispatch`.

        Args:
            function: of `emitter_calls`; its emitter may also be a `LampLight`, and None for lanes
                whose result is of no use.
        """
        if not self._apart:
            return dr.dispatch(emitter, function, *args)
        number = dr.reinterpret_array(mi.UInt32, emitter)
        kind = dr.gather(mi.UInt32, self._kind_of, number)
        targets = [self._target(function, light) for light in self._lights]
        return dr.switch(kind, [*targets, self._other(function)], number, emitter, *args)

    def _target(self, function: Callable[..., Any], light: LampLight) -> Callable[..., Any]:
        """The function for the lamps of one kind."""

        def call(number: mi.UInt32, emitter: mi.EmitterPtr, *args: Any) -> Any:
            packets = [
                dr.gather(mi.Vector4f, self._rows, _PACKETS * number + i) for i in range(_PACKETS)
            ]
            values = [value for packet in packets for value in packet]
            slot = dr.gather(mi.UInt32, self._slot_of, number)
            gain = dr.gather(mi.Color3f, self._gains, slot)
            centre, rotation = mi.Point3f(*values[1:4]), mi.Matrix3f(*values[4:13])
            return function(light.moved(values[0], centre, rotation, gain), *args)

        return call

    def _other(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """The function for all other emitters."""

        def record(emitter: mi.Emitter, *args: Any) -> Any:
            return function(None if isinstance(emitter, DeferredEmitter) else emitter, *args)

        def call(number: mi.UInt32, emitter: mi.EmitterPtr, *args: Any) -> Any:
            return dr.dispatch(emitter, record, *args) if self._others else function(None, *args)

        return call


def joined_colours(colours: list[mi.Color3f]) -> mi.Color3f:
    """Evaluated arrays, one after another, in one; derivatives pass through."""
    while len(colours) > 1:
        groups = [colours[i : i + _JOINED] for i in range(0, len(colours), _JOINED)]
        colours = [_concatenated(group) for group in groups]
    return colours[0]


def _concatenated(colours: list[mi.Color3f]) -> mi.Color3f:
    colour = mi.Color3f(*(dr.concat([each[i] for each in colours]) for i in range(3)))
    dr.eval(colour)
    return colour


def _kind(lamp: DeferredEmitter) -> Hashable:
    """Equal for lamps whose code is the same."""
    placed = lamp.placed
    what = id(placed.asset), id(placed.field), placed.sampling
    return *what, placed.shows_geometry, placed.holds
