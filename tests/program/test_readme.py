"""What README shows, run."""

import re
import subprocess
import sys
from pathlib import Path

README = Path(__file__).resolve().parents[2] / "README.md"


def test_the_snippet_runs_and_says_three():
    (snippet,) = re.findall(r"```python\n(.*?)```", README.read_text(), re.DOTALL)
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", snippet], capture_output=True, text=True, timeout=120, check=True
    )
    lines = done.stdout.splitlines()
    assert [line.split()[2] for line in lines if line.endswith(("window", "end"))] == ["3", "3", "3"]
    assert len(lines) > 10 and lines[-1] in {str(digit) for digit in range(10)}


def test_links_lead_somewhere():
    for page in [README, *README.parent.glob("docs/*.md"), README.parent / "benchmarks" / "README.md"]:
        for target in re.findall(r"\]\(([^)#]+)", page.read_text()):
            assert target.startswith("http") or (page.parent / target).exists(), f"{page}: {target}"
