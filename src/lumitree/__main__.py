"""`python -m lumitree`."""

import sys

from lumitree.cli.app import main

if __name__ == "__main__":
    sys.exit(main())
