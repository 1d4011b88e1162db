"""The variant of Mitsuba in tests: LUMITREE_TEST_VARIANT, or else the variant of CPUs."""

import os

VARIANT = os.environ.get("LUMITREE_TEST_VARIANT", "llvm_ad_rgb")
