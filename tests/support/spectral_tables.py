"""RGB light in a spectral variant: `python spectral_tables.py VARIANT` prints it as JSON."""

import json
import sys
from typing import Any

import numpy as np


def facts(variant):
    """Largest errors of the laws of `light_table`, by spectrum."""
    from lumitree.asset.asset import EmittedSpectrum
    from lumitree.core.backend import load_mitsuba
    from lumitree.core.photometry import (
        FILM_LUMINANCE,
        LUMA,
        blackbody_spectrum,
        sampled_spectrum,
        srgb_from_xyz,
        xyz_of_spectrum,
    )

    mi = load_mitsuba(variant)
    from lumitree.rendering.light_colour import (
        LightSpectra,
        d65,
        light_table,
        smooth_basis,
    )

    rgb = np.random.default_rng(0).random((50, 3))

    def table(spectrum, share=1.0):
        known = None if spectrum is None else EmittedSpectrum.of(spectrum, share)
        return light_table(known)

    def colours(spectra):
        return srgb_from_xyz(xyz_of_spectrum(spectra)) / FILM_LUMINANCE

    found: dict[str, Any] = {
        "basis": [smooth_basis().min(), abs(smooth_basis().sum(axis=1) - 1).max()]
    }
    spectra = {
        "none": None,
        "incandescent": blackbody_spectrum(2700),
        "peaks": sampled_spectrum([400, 450, 500, 600, 700], [0, 3, 1, 3, 0.0]),
    }
    for name, spectrum in spectra.items():
        made = table(spectrum)
        own = d65() if spectrum is None else spectrum
        again = made @ colours(own)
        found[name] = {
            "colour": abs(colours(rgb @ made.T) - rgb).max(),
            "own": abs(again - own).max() / own.max(),
            "smallest": (rgb @ made.T).min(),
        }
    found["unknown"] = abs(table(spectra["peaks"], 0.5) - table(None)).max()
    line = table(sampled_spectrum([589.3], [1]))
    luminance = xyz_of_spectrum(rgb @ line.T)[:, 1] / FILM_LUMINANCE
    found["line"] = abs(luminance / (rgb @ LUMA) - 1).max()
    # The kernel, at whole wavelengths and between them.
    at = np.array([[400.0, 555.5, 610.25, 829.75]])
    device = LightSpectra(table(spectra["peaks"]))(
        mi.Color3f(1, 2, 3), mi.Spectrum(*at[0].tolist())
    )
    expected = np.interp(at[0], np.arange(360, 831), table(spectra["peaks"]) @ [1, 2, 3])
    found["kernel"] = abs(np.ravel(device) - expected).max() / abs(expected).max()
    return found


if __name__ == "__main__":
    print(json.dumps(facts(sys.argv[1])))
