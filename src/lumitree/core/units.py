"""Units of length."""

from lumitree.errors import LumitreeError, shown

# Metres in a unit.
UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "ft": 0.3048}


def metres_of(unit: float | str) -> float:
    """Metres in a unit of length.

    Args:
        unit: "m", "cm", "mm", "in" or "ft"; or the metres in a unit, 1e-6 to 1e6.

    Raises:
        LumitreeError: it is something else.
    """
    metres = UNITS.get(unit, 0.0) if isinstance(unit, str) else unit
    if not (isinstance(metres, int | float) and 1e-6 <= metres <= 1e6):
        expected = f"{', '.join(UNITS)}, or 1e-6 to 1e6 metres"
        raise LumitreeError(f"unit is {shown(repr(unit), 40)}; expected {expected}")
    return metres
