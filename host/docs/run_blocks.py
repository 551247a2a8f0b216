"""Runs the Python code blocks of the documentation's pages: each page in a folder and a process of its own.

A page's blocks run in their order and share their names, as in a notebook. A block that needs hardware or
files of the reader's own says so in the line above it, ``<!-- not run: why -->``, and is compiled only.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

PAGES = Path(__file__).parent / "pages"
BLOCK = re.compile(r"(<!-- not run: .+ -->\n)?^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def main() -> int:
    """Run all pages, say how each went, and return how many failed."""
    failed = 0
    for page in sorted(PAGES.rglob("*.md")):
        found = BLOCK.findall(page.read_text(encoding="utf-8"))
        name = page.relative_to(PAGES).as_posix()
        for _, text in found:
            compile(text, name, "exec")
        program = "\n".join(text for skipped, text in found if not skipped)
        if program:
            begin = time.monotonic()
            with tempfile.TemporaryDirectory() as folder:
                done = subprocess.run([sys.executable, "-W", "error", "-c", program], cwd=folder, check=False)
            failed += done.returncode != 0
            print(f"{name}: {'ran' if done.returncode == 0 else 'FAILED'}, {time.monotonic() - begin:.1f} s")
    return failed


if __name__ == "__main__":
    sys.exit(main())
