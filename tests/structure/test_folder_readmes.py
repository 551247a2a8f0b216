"""Each folder's README is there, and names files that there are."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from tests.structure.test_repository import tracked

REPOSITORY = Path(__file__).parents[2]
FOLDERS = sorted(
    [
        *(path.parent for path in (REPOSITORY / "host" / "frogkick").glob("*/__init__.py")),
        *(REPOSITORY / name for name in ("host", "codegen", "firmware", "tests")),
        *(path for path in (REPOSITORY / "firmware").iterdir() if path.is_dir()),
    ]
)
LINKS = re.compile(r"\]\((?!https?://)([^)#\s]+)")
KINDS = re.compile(r"`([\w./-]+\.(?:py|c|h|toml|md|ld))`")
OTHERS = {
    "robot.toml", "camera.toml", "corners.toml", "world.toml", "mine.py", "fk_table.c", "fk_robot_config.h",
}  # fmt: skip
"""What users write, or a build makes."""


def test_links_lead_to_files_that_are_there() -> None:
    """Of every page but the documentation's own, whose links ``make docs`` checks."""
    pages = [REPOSITORY / name for name in tracked() if name.endswith(".md") and "docs/pages" not in name]
    links = [(page, link) for page in pages for link in LINKS.findall(page.read_text(encoding="utf-8"))]
    assert len(links) > 10
    assert [f"{page}: {link}" for page, link in links if not (page.parent / link).is_file()] == []


def test_each_test_that_the_hazards_name_is_there() -> None:
    page = (REPOSITORY / "host/docs/pages/explanation/hazards.md").read_text(encoding="utf-8")
    named = set(re.findall(r"`(test_\w+)`", page))
    sources = "".join(path.read_text(encoding="utf-8") for path in (REPOSITORY / "tests").rglob("test_*.py"))
    assert len(named) > 15
    assert named <= set(re.findall(r"^def (test_\w+)", sources, re.MULTILINE))


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda path: path.relative_to(REPOSITORY).as_posix())
def test_a_folder_s_readme_names_what_is_there(folder: Path) -> None:
    readme = folder / "README.md"
    assert readme.is_file(), f"{readme.relative_to(REPOSITORY)} is missing: what is this folder, in a minute?"
    there = {
        path.name
        for root in ("host", "firmware", "codegen", "tests")
        for path in (REPOSITORY / root).rglob("*")
        if path.suffix and "__pycache__" not in path.parts
    }
    named = {Path(name).name for name in KINDS.findall(readme.read_text(encoding="utf-8"))}
    assert named - OTHERS <= there, sorted(named - OTHERS - there)
    if folder.parent == REPOSITORY / "host" / "frogkick":  # the clone itself may be called so
        mine = {path.name for path in folder.glob("*.py")} - {"__init__.py"}
        assert mine <= named, f"does not name {sorted(mine - named)}"
