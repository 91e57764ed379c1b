"""``python -m gaitopt``: the command line without an installed script."""

import sys

from gaitopt.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
