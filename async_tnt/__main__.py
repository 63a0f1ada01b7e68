"""`python -m async_tnt`: the program `async-tnt`."""

import sys

from async_tnt.cli import main

sys.exit(main())
