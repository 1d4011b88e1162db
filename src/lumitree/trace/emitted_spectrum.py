"""The spectrum of the light of a luminaire's bare emitters."""

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.asset import EmittedSpectrum
from lumitree.core.photometry import luminance, matching_functions
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.core.spectrum import sampled_spectrum
from lumitree.lamp.luminaire import Luminaire
from lumitree.trace.emitted_rays import as_rows, seeded_sampler
from lumitree.trace.light_paths import emitted_flux

# Light paths that estimate the shares of the emitters, to about 0.2 %, always the same ones.
_PATHS = 1 << 18


def emitted_spectrum(luminaire: Luminaire) -> EmittedSpectrum | None:
    """The spectra of a luminaire's emitters, weighted by their luminous flux.

    Returns:
        The spectrum; None if no emitter has one, as in a `mi.Scene` and in models.

    Raises:
        LumitreeError: a spectrum has negative values, or wavelengths that do not increase.
    """
    known = {} if luminaire.file is None else luminaire.file.spectra
    samples = [known.get(emitter.id()) for emitter in luminaire.scene.emitters()]
    if not any(samples):
        return None
    lumens = _lumens_by_emitter(luminaire)
    luminosity = matching_functions()[1]
    power, lumens_known = np.zeros(len(luminosity)), 0.0
    for each, flux in zip(samples, lumens.tolist(), strict=True):
        spectrum = np.zeros(len(luminosity)) if each is None else sampled_spectrum(*each)
        if (visible := spectrum @ luminosity) > 0:
            power += flux / visible * spectrum
            lumens_known += flux
    return EmittedSpectrum.of(power, min(lumens_known / max(float(lumens.sum()), 1e-300), 1.0))


def _lumens_by_emitter(luminaire: Luminaire) -> NDArray[np.float64]:
    """Luminous flux of each emitter of the scene, relative."""
    count = len(luminaire.scene.emitters())
    if count == 1:
        return np.ones(1)
    sampler = seeded_sampler(SeedStream(Purpose.SPECTRUM).seed(0), _PATHS)
    flux, emitter = emitted_flux(luminaire, sampler, _PATHS)
    lumens = np.bincount(np.array(emitter), luminance(as_rows(flux)), count)
    return lumens.astype(np.float64)
