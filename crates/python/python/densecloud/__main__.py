"""`python -m densecloud` is the program."""

import sys

from . import _main

sys.exit(_main())
