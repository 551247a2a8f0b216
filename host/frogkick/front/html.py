"""HTML of an object in a notebook: a small table, and a picture if there is one."""

from __future__ import annotations

import html
from collections.abc import Mapping
from typing import Any


def page_of(title: str, rows: Mapping[str, Any], figure: Any = None) -> str:
    """Return the HTML of an object.

    Args:
        title: name of the object.
        rows: name -> value; numbers are shown with four digits.
        figure: a matplotlib figure to show below, or None.
    """
    cells = "".join(
        f"<tr><th style='text-align:left'>{html.escape(name)}</th><td>{html.escape(_text(value))}</td></tr>"
        for name, value in rows.items()
    )
    picture = ""
    if figure is not None:
        from frogkick.report.style import figure_uri

        picture = f"<img style='max-width:100%' alt='{html.escape(title)}' src='{figure_uri(figure)}'>"
    return f"<div><b>{html.escape(title)}</b><table>{cells}</table>{picture}</div>"


def _text(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
