"""Commands of `async-tnt` in processes of their own."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import Any


def command(*words: object) -> dict[str, Any]:
    """The JSON object that `async-tnt` prints if it is run with these words."""
    done = subprocess.run(
        [sys.executable, "-m", "async_tnt", *map(str, words)], stdout=subprocess.PIPE, check=True
    )
    result: dict[str, Any] = json.loads(done.stdout)
    return result
