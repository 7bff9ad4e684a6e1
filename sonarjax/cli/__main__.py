"""`python -m sonarjax.cli`: the command without its script."""

import sys

from sonarjax.cli import main

sys.exit(main())
