"""Seeds of all random numbers that Mitsuba and NumPy generate.

A result depends on one *root seed*, which the user may choose. Every use of random numbers has its
separate seed. It is derived from the root seed, the purpose of the numbers (`Purpose`), the step of
that work, and the draw within the step. Two uses share random numbers only if their 32-bit seeds
coincide. Among n seeds the probability of this is about n² / 2³³: 0.01 for the 10,000
seeds of a long bake. The consequence is small: two of thousands of batches of rays are equal.
"""

import dataclasses
import enum

import numpy as np

from lumitree.errors import LumitreeError

MAX_SEED = 2**31 - 1


class Purpose(enum.IntEnum):
    """Purpose of random numbers. A number is part of the seed: append, and never renumber."""

    CAPTURE = 0  # images of a dataset; step: Halton index
    PREVIEW = 1  # images of a preview; step: view
    FLUX = 2  # total flux; step: batch; draw 1: of the bare emitters, 2: light that is lost
    LONG_PATHS = 3  # flux of long paths; step: batch
    MAX_RADIANCE = 4  # paths that estimate L_max of a luminaire
    HELD_OUT = 5  # rays of the score
    GROWTH = 6  # which cells of the first octree hold something; step: level, draw: batch
    ESTIMATE = 7  # statistics of the first octree; step: batch
    REFINEMENT = 8  # rays of gradient descent; step: its step
    STRAIGHT = 9  # rays of gradient descent that are followed straight through only; step: its step
    CALIBRATION = 10  # scale of emission; step: step of the descent
    CLOSING_CALIBRATION = 11  # the same after the descent; step: steps done
    FLUX_CORRECTION = 12  # scale of the total flux; step: steps done
    ERROR_INDICATOR = 13  # which leaves are split; step: step of the descent
    RENDER = 14  # images of a scene; step: samples done
    CONTINUATION = 15  # root seed of a bake that goes on with an asset; step: checksum of the asset
    IRRADIANCE = 16  # rays that leave a luminaire; step: batch, draw: 0 traced, 1 and 2 from assets
    LIGHT_FIELD = 17  # light paths of the light field; step: batch
    PHOTOMETRY = 18  # rays that leave a luminaire, for intensities; step: batch
    ASSET_FLUX = 19  # flux of an asset without a light field
    EXPORT = 20  # clusters of a light field
    LINES = 21  # total flux from camera paths; step: batch
    # Light that arrives at a luminaire; see `fit.light_field.inside.EndingDraw`.
    ENDING = 22
    # 23 belonged to rays through the surfaces of a lamp.
    RECEIVED = 24  # irradiance at points of a scene; step: samples at once
    SURFACES = 25  # radiance of the surfaces of an asset; step: faces at once
    # Illuminance at points of a scene; draw 0: paths, step: pass; draw 1: places in cells of light
    # fields, step: sums at once; draw 2: points of a surface; draw 3: rays that find solids.
    ILLUMINANCE = 26
    SPECTRUM = 27  # flux of each emitter of a luminaire, by which its spectrum is weighted
    CELLS = 28  # cells of a light field; draw 0: light paths, 1: which segments
    FIELD_RAYS = 29  # rays of a radiance field, from which its light field is made; step: batch
    # Root seeds of illuminance in a design; step: round; draw 1: of the last simulation. Draw 2:
    # places in cells of light fields; draw 3: of direct illuminance.
    DESIGN = 30


@dataclasses.dataclass(frozen=True)
class SeedStream:
    """The seeds of one draw of random numbers.

    Attributes:
        purpose: what the random numbers are for.
        step: index of the step, as listed in `Purpose`; 0 to 2³² - 1.
        draw: index of the draw within the step; 0 to 2³² - 1.
    """

    purpose: Purpose
    step: int = 0
    draw: int = 0

    def seed(self, root: int, part: int = 0) -> int:
        """The 32-bit seed of one part of the draw.

        Args:
            root: the user's seed, 0 to 2³¹ - 1.
            part: index of an independent set of random numbers within the draw.

        Raises:
            LumitreeError: the root seed is out of range.
        """
        key = (int(self.purpose), self.step, self.draw, part)
        sequence = np.random.SeedSequence(check_seed(root), spawn_key=key)
        return int(sequence.generate_state(1)[0])


def check_seed(seed: int) -> int:
    """Return the seed if it is valid.

    Raises:
        LumitreeError: the seed is not an integer from 0 to 2³¹ - 1.
    """
    if type(seed) is not int or not 0 <= seed <= MAX_SEED:
        raise LumitreeError(f"seed is {seed!r}; expected a whole number from 0 to {MAX_SEED}")
    return seed
