"""Commands of `async-tnt` in processes of their own."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import Any


def command(*arguments: object) -> dict[str, Any]:
    """The JSON object that `async-tnt` prints if it is run with these arguments."""
    process = subprocess.run(
        [sys.executable, "-m", "async_tnt", *map(str, arguments)],
        stdout=subprocess.PIPE,
        check=True,
    )
    result: dict[str, Any] = json.loads(process.stdout)
    return result
