"""`lumitree` with images of many passes, each of which is kept.

python tiny_render.py render ...
"""

import sys

from lumitree.cli import main
from lumitree.rendering import passes, saved_passes

if __name__ == "__main__":
    # 16 samples of 64 x 64 pixels.
    passes._SAMPLES_PER_PASS = dict.fromkeys(passes._SAMPLES_PER_PASS, 1 << 16)
    saved_passes._SECONDS_BETWEEN_STATES, saved_passes._MOST_TIME_OF_STATES = 0.0, 1e9
    sys.exit(main(sys.argv[1:]))
