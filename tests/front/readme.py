"""README's Python block, as it is or at a reduced size."""

from __future__ import annotations

import re

from tests.conftest import REPOSITORY


def readme_lines(*replaced: tuple[str, str]) -> str:
    """Return README's Python block with some of its words replaced."""
    text = (REPOSITORY / "README.md").read_text(encoding="utf-8")
    (lines,) = re.findall(r"```python\n(import frogkick as fk\n.*?)```", text, re.DOTALL)
    for old, new in replaced:
        assert old in lines
        lines = lines.replace(old, new)
    return str(lines)


def fewer(states: int) -> list[tuple[str, str]]:
    """What to replace there to get a small robot and few states."""
    return [('fk.load_robot("frog2022")', "made_robot()"), ("states=300", f"states={states}")]
