"""Luminous flux and colour temperature of a lamp, as factors on its light.

`blackbody.json` has the colours of black bodies that lumitree uses
(`core.photometry.blackbody_colour`). `make_archive.py` writes it.

Symbols
    watts       flux of the lamp without factors and at a scale of 1: R, G and B, W
    tint        factors on R, G and B
    gain        factor on all
"""

import functools
import json
from collections.abc import Sequence
from pathlib import Path

# As in `core.photometry`.
LUMENS_PER_WATT = 683.0
LUMA = (0.2126, 0.7152, 0.0722)
MIN_TEMPERATURE, MAX_TEMPERATURE = 1000.0, 20000.0
TABLE = Path(__file__).with_name("blackbody.json")


@functools.cache
def _table() -> dict[str, list]:
    """Reciprocal temperatures, 1/K, in ascending order, and the colour of each."""
    return json.loads(TABLE.read_text(encoding="utf-8"))


def blackbody_colour(temperature: float) -> list[float]:
    """Linear sRGB colour, of luminance 1, of a black body of 1000 to 20000 K."""
    places, colours = _table()["reciprocal"], _table()["colour"]
    place = min(max(1 / temperature, places[0]), places[-1])
    after = next(i for i in range(1, len(places)) if place <= places[i])
    along = (place - places[after - 1]) / (places[after] - places[after - 1])
    pairs = zip(colours[after - 1], colours[after], strict=True)
    return [first + along * (second - first) for first, second in pairs]


def lumens(watts: Sequence[float], tint: Sequence[float], gain: float, scale: float) -> float:
    """Luminous flux, lm. Flux grows as the area of what emits: with the square of the scale."""
    mixed = sum(each * factor * luma for each, factor, luma in zip(watts, tint, LUMA, strict=True))
    return LUMENS_PER_WATT * mixed * gain * scale**2


def tint_for(watts: Sequence[float], temperature: float) -> list[float] | None:
    """Tint that gives the flux the colour of a black body, and keeps its luminous flux.

    None if the lamp emits nothing in a channel that the colour needs.
    """
    total = lumens(watts, (1.0, 1.0, 1.0), 1.0, 1.0) / LUMENS_PER_WATT
    wanted = blackbody_colour(temperature)
    if any(want > 0 and not have > 0 for want, have in zip(wanted, watts, strict=True)):
        return None
    pairs = zip(wanted, watts, strict=True)
    return [want * total / have if have > 0 else 0.0 for want, have in pairs]
