"""`lumitree train` of a small network, which saves a checkpoint every half second.

python tiny_training.py train DATASET -o RUN [--resume]
"""

import dataclasses
import sys

from lumitree.cli import main
from lumitree.fit.network import train
from lumitree.fit.network.config import PRESETS

if __name__ == "__main__":
    PRESETS["preview"] = dataclasses.replace(
        PRESETS["preview"], width=32, output_width=16, num_coarse=16, num_fine=16,
        rays_per_batch=512, num_steps=400,
    )  # fmt: skip
    train._CHECKPOINT_SECONDS = 0.5
    sys.exit(main())
