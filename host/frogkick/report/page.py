"""A self-contained HTML page from sections of text, tables and pictures."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import jinja2

from frogkick.core.files import write_text
from frogkick.report.style import figure_uri

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Item = TypeVar("Item")


@dataclass(frozen=True)
class Table:
    """A table: header cells and rows of cells."""

    header: Sequence[str]
    rows: Sequence[Sequence[object]]

    @classmethod
    def of(cls, items: Iterable[Item], columns: Mapping[str, Callable[[Item], object]]) -> Table:
        """Return a table with a row for each item; ``columns``: head of a column -> its cell for an item."""
        return cls(tuple(columns), [[cell(item) for cell in columns.values()] for item in items])


@dataclass(frozen=True)
class Section:
    """A headed part of a page."""

    title: str
    text: Sequence[str] = ()  # paragraphs
    table: Table | None = None
    images: Sequence[tuple[Figure | bytes, str]] = ()  # (figure or PNG, caption) of each picture
    links: Sequence[tuple[str, str]] = ()  # (file beside the page, its description) of each link


def write_page(target: Path, title: str, lead: str, sections: Sequence[Section]) -> None:
    """Write one HTML file that needs no other file; ``lead``: the first paragraph, which summarises it.

    Raises:
        InputError: the file cannot be written.
    """
    page = rendered("page.html.jinja", title=title, lead=lead, sections=sections, uri_of=figure_uri)
    write_text(target, page)


def left_out(rows: Sequence[tuple[str, str]], what: str) -> Section:
    """Return the section of omitted items: rows of the item (a case, a design) and the reason."""
    if not rows:
        return Section("Left out", [f"No {what} was left out."])
    return Section("Left out", table=Table((what, "reason"), rows))


def rendered(template: str, **values: object) -> str:
    """Return the text of one of this package's templates, with values filled in."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("frogkick.report"), autoescape=True, undefined=jinja2.StrictUndefined
    )
    return environment.get_template(template).render(**values)
