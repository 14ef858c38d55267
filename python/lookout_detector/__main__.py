"""`python -m lookout_detector`: the program."""

import sys

from . import main

sys.exit(main())
