"""The two transmittance laws and the emission weights they give.

Symbols
    tau        optical depth, the integral of density along a ray
    T          transmittance, 1 at the start of a ray; opacity is 1 - T
    weight     decrease of T over an interval, w_i = T_i - T_{i+1}; for both laws the weights of
               a ray sum to its opacity
    literal    weight of Eq. 3 as it is printed, the integral of T over tau
"""

from typing import Any, Literal, get_args

Law = Literal["linear", "exponential"]
LAWS: tuple[Law, ...] = get_args(Law)

EmissionWeights = Literal["decrease", "literal"]
EMISSION_WEIGHTS: tuple[EmissionWeights, ...] = get_args(EmissionWeights)

# The exponential law never reaches 0. Below this transmittance a ray counts as blocked.
BLOCKED = 1e-3


def transmittance(tau: Any, law: Law, xp: Any) -> Any:
    """T(tau): `max(0, 1 - tau)` (Eq. 4) or `exp(-tau)`.

    Args:
        tau: optical depth, at least 0, any shape.
        law: "linear" or "exponential".
        xp: array module of `tau`: `numpy`, `jax.numpy` or `drjit`.
    """
    if law == "linear":
        return xp.maximum(1 - tau, 0)
    if law == "exponential":
        return xp.exp(-tau)
    raise ValueError(f"unknown transmittance law {law!r}; expected one of {LAWS}")


def emission_weights(before: Any, after: Any, law: Law, kind: EmissionWeights) -> Any:
    """Weights of the emission in intervals of constant density (Eq. 3).

    Args:
        before, after: T at both ends of each interval, any shape.
        law: transmittance law.
        kind: "decrease", T_i - T_{i+1}; or "literal", the integral of T over the optical depth of
            the interval. For the exponential law the two are equal. For the linear law the literal
            weights are (T_i² - T_{i+1}²) / 2, and sum to at most 1/2.
    """
    if kind == "literal" and law == "linear":
        return (before - after) * (before + after) / 2
    return before - after
