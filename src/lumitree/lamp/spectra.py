"""The spectra of a scene's emitters, of which RGB variants of Mitsuba keep the colour only."""

import collections
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lumitree.core.backend import load_mitsuba
from lumitree.core.photometry import WAVELENGTHS, blackbody_spectrum
from lumitree.lamp.blackbodies import blackbody_of

# Wavelengths, nm, and values, both [N]; not checked.
Samples = tuple[NDArray[np.float64], NDArray[np.float64]]


def spectra_of_emitters(file: Any) -> dict[str, Samples]:
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


def _samples(file: Any, emitter: Any) -> Samples | None:
    """The spectrum of an emitter's radiance; None if it has none."""
    held = file.children(emitter).get("radiance")
    if held is None:
        return _listed(emitter, "radiance")
    if held.props.plugin_name() == "blackbody":
        return WAVELENGTHS, blackbody_spectrum(*blackbody_of(held.props))
    return _listed(held.props, "value") if held.props.plugin_name() == "spectrum" else None


def _listed(props: Any, name: str) -> Samples | None:
    """A property that is a list of wavelengths and values, or a constant spectrum."""
    if name not in props:
        return None
    if props.type(name) != load_mitsuba().Properties.Type.Spectrum:
        return None
    spectrum = props[name]
    values = np.array(spectrum.values, np.float64)
    if spectrum.is_uniform():
        return WAVELENGTHS, np.broadcast_to(values, WAVELENGTHS.shape)
    return np.array(spectrum.wavelengths, np.float64), values
