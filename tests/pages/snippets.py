"""The snippets of the pages."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def blocks(text, language):
    return re.findall(rf"```{language}\n(.*?)```", text, re.DOTALL)
