"""`python -m async_tnt.cli`."""

import sys

from async_tnt.cli import main

sys.exit(main())
