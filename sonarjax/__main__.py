"""`python -m sonarjax`: the same as the command `sonarjax`."""

import sys

from sonarjax.cli import main

if __name__ == "__main__":
    sys.exit(main())
