"""The variant of Mitsuba in tests: that of LUMITREE_TEST_VARIANT, else the one of CPUs."""

import os

VARIANT = os.environ.get("LUMITREE_TEST_VARIANT", "llvm_ad_rgb")
