"""A self-contained HTML page from sections of text, tables and pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import jinja2

from frogkick.core.files import write_text


@dataclass(frozen=True)
class Table:
    """A table: header cells and rows of cells."""

    header: Sequence[str]
    rows: Sequence[Sequence[str]]


@dataclass(frozen=True)
class Section:
    """A headed part of a page.

    Attributes:
        title: heading.
        text: paragraphs.
        table: a table or None.
        images: (data URI, caption) of each picture.
        links: (file beside the page, its description) of each link.
    """

    title: str
    text: Sequence[str] = ()
    table: Table | None = None
    images: Sequence[tuple[str, str]] = field(default_factory=tuple)
    links: Sequence[tuple[str, str]] = field(default_factory=tuple)


def write_page(target: Path, title: str, lead: str, sections: Sequence[Section]) -> None:
    """Write one HTML file that needs no other file.

    Args:
        title: title of the page.
        lead: the first paragraph, which summarises the page.
        sections: sections in order.
    """
    write_text(target, rendered("page.html.jinja", title=title, lead=lead, sections=sections))


def rendered(template: str, **values: object) -> str:
    """Return the text of one of this package's templates, with values filled in."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("frogkick.report"), autoescape=True, undefined=jinja2.StrictUndefined
    )
    return environment.get_template(template).render(**values)
