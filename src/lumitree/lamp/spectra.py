"""Spectra of a scene's emitters, and black bodies as RGB.

Mitsuba evaluates its plugin `blackbody` in spectral variants alone, and keeps only the colour of
other spectra.
"""

from __future__ import annotations

import collections
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lumitree.core.backend import load_mitsuba
from lumitree.core.photometry import (
    FILM_LUMINANCE,
    LUMA,
    RGB,
    WAVELENGTHS,
    blackbody_radiance,
    blackbody_spectrum,
    xyz_of_spectrum,
)
from lumitree.errors import LumitreeError, shown, shown_names

if TYPE_CHECKING:
    import mitsuba as mi

    from lumitree.lamp.scene_shapes import SceneNodes

# With their defaults: K, and the range of wavelengths, nm.
_PARAMETERS = {"temperature": None, "wavelength_min": 360.0, "wavelength_max": 830.0}
# Wavelengths, nm, and values, both [N]; not checked.
Samples = tuple[NDArray[np.float64], NDArray[np.float64]]


def replace_blackbodies(file: SceneNodes) -> list[str]:
    """Replace the black bodies of a `SceneFile`'s emitters by their radiance, W/(m² sr).

    Returns a note for each temperature, with the radiance.
    """
    notes: dict[str, list[str]] = {}
    for owner in (*file.nodes("Shape"), *file.nodes("Emitter")):
        name = owner.props.id() or owner.props.plugin_name()
        for emitter in (owner, *file.children(owner.props).values()):
            if emitter.type == load_mitsuba().ObjectType.Emitter:
                for line in _replaced(file, emitter.props):
                    notes.setdefault(line, []).append(name)
    return [f"{shown_names(dict.fromkeys(names))}: {line}" for line, names in notes.items()]


def _replaced(file: SceneNodes, emitter: mi.Properties) -> Iterator[str]:
    for name, node in file.children(emitter).items():
        if node.props.plugin_name() == "blackbody":
            body = blackbody_of(node.props)
            temperature, radiance = body[0], blackbody_radiance(*body)
            del emitter[name]
            emitter[name] = _radiance_property(radiance, body)
            colour = ", ".join(f"{channel:.4g}" for channel in radiance)
            yield (
                f"a blackbody of {temperature:g} K is taken as the RGB {colour} W/(m² sr), which "
                "has its luminance; Mitsuba's own integrators render it 106.9 times darker in "
                "spectral variants"
            )


def _radiance_property(radiance: RGB, body: tuple[float, float, float]) -> Any:
    mi = load_mitsuba()
    if not mi.is_spectral:
        return mi.ScalarColor3d(radiance)
    spectrum = blackbody_spectrum(*body)
    spectrum *= (np.array(radiance) @ LUMA) * FILM_LUMINANCE / xyz_of_spectrum(spectrum)[1]
    values = ", ".join(map(repr, spectrum.tolist()))
    limits = {"wavelength_min": WAVELENGTHS[0], "wavelength_max": WAVELENGTHS[-1]}
    return mi.load_dict({"type": "regular", "values": values, **limits})


def blackbody_of(props: mi.Properties) -> tuple[float, float, float]:
    """Temperature, K, and shortest and longest wavelength, nm, of the plugin `blackbody`."""
    values = []
    for name, default in _PARAMETERS.items():
        value = props.get(name, default)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise LumitreeError(f"{name} of a blackbody is {shown(value, 60)}; expected a number")
        values.append(float(value))
    return values[0], values[1], values[2]


def spectra_of_emitters(file: SceneNodes) -> dict[str, Samples]:
    """The spectra of a `SceneFile`'s surfaces that emit one, by the ids of their emitters.

    Emitters without an id of their own get one. Colours (RGB, textures, numbers) are no spectra.
    Black bodies must still be in the file.
    """
    emitters = file.nodes("Emitter")
    # In a dictionary, several may have one.
    ids = collections.Counter(node.props.id() for node in emitters)
    found = {}
    for number, node in enumerate(emitters):
        samples = _samples(file, node.props)
        if samples is not None:
            if not node.props.id() or ids[node.props.id()] > 1:
                node.props.set_id(f"emitter {number}")
            found[node.props.id()] = samples
    return found


def _samples(file: SceneNodes, emitter: mi.Properties) -> Samples | None:
    held = file.children(emitter).get("radiance")
    if held is None:
        return _listed(emitter, "radiance")
    if held.props.plugin_name() == "blackbody":
        return WAVELENGTHS, blackbody_spectrum(*blackbody_of(held.props))
    return _listed(held.props, "value") if held.props.plugin_name() == "spectrum" else None


def _listed(props: mi.Properties, name: str) -> Samples | None:
    if name not in props:
        return None
    if props.type(name) != load_mitsuba().Properties.Type.Spectrum:
        return None
    spectrum = props[name]
    values = np.array(spectrum.values, np.float64)
    if spectrum.is_uniform():
        return WAVELENGTHS, np.broadcast_to(values, WAVELENGTHS.shape)
    return np.array(spectrum.wavelengths, np.float64), values
