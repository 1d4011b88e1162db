"""The integrator of a scene: one that sees through the null surfaces of placed luminaires."""

from __future__ import annotations

import warnings

import mitsuba as mi

from lumitree.errors import LumitreeWarning
from lumitree.rendering.layers import records_layers
from lumitree.rendering.register import register

# Classes of `volpath` and `volpathmis`, which take the transmittance of null surfaces for shadow
# rays, and render media.
_SEE_MEDIA = ("VolumetricPathIntegrator", "VolpathMisIntegratorImpl")
# These become `lumitree_path`, or `volpath` where media are heterogeneous.
_PATH_TRACERS = ("path", "lumitree_path")
_DEFAULT_PATH_DEPTH = 16


def integrator_for(
    scene: mi.Scene, described: mi.Properties | None, title: str, *, heterogeneous: bool
) -> mi.Integrator:
    """The integrator of a scene, or what replaces it.

    `described` is None where the scene has none, or one whose settings cannot be read.
    """
    tracer, own = _path_tracer(heterogeneous), scene.integrator()
    kind = described.plugin_name() if described is not None else None
    if own is not None and own.class_name() in _SEE_MEDIA:
        return own
    if described is not None and kind in _PATH_TRACERS:
        described.set_plugin_name(tracer)
        return mi.PluginManager.instance().create_object(described)
    if own is not None and records_layers(own) and not heterogeneous:
        return own
    found = f"integrator {kind!r}" if kind else "no integrator"
    if described is None and own is not None:
        found = f"the integrator {own.class_name()}, which is created already"
    warnings.warn(
        f"{title} has {found}; using {tracer} with max_depth {_DEFAULT_PATH_DEPTH}",
        LumitreeWarning,
        stacklevel=3,
    )
    return default_integrator(heterogeneous=heterogeneous)


def default_integrator(
    path_depth: int = _DEFAULT_PATH_DEPTH, *, heterogeneous: bool = False
) -> mi.Integrator:
    """Integrator for scenes that name none."""
    register()
    return mi.load_dict({"type": _path_tracer(heterogeneous), "max_depth": path_depth})


def _path_tracer(heterogeneous: bool) -> str:
    return "volpath" if heterogeneous else "lumitree_path"
