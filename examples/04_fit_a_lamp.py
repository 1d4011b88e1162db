"""Find the place and the dim level of a desk lamp from an image of the lit desk."""

from pathlib import Path

import lumitree  # before mitsuba: it names a working libLLVM

# isort: split
import drjit as dr
import mitsuba as mi
import numpy as np

mi.set_variant("llvm_ad_rgb")
if not Path("desk_lamp.lumitree").exists():
    lumitree.bake("lantern", "desk_lamp.lumitree", quality="preview")
