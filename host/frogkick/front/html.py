"""HTML of an object in a notebook: a small table, and a picture if there is one."""

from __future__ import annotations

import html
from collections.abc import Mapping
from typing import Any


def page_of(title: str, rows: Mapping[str, Any], figure: Any = None) -> str:
    """Return the HTML of an object: its name, its values, and below a matplotlib figure if there is one."""
    texts = {name: f"{each:.4g}" if isinstance(each, float) else str(each) for name, each in rows.items()}
    cells = "".join(
        f"<tr><th style='text-align:left'>{html.escape(name)}</th><td>{html.escape(text)}</td></tr>"
        for name, text in texts.items()
    )
    picture = ""
    if figure is not None:
        from frogkick.report.style import figure_uri

        picture = f"<img style='max-width:100%' alt='{html.escape(title)}' src='{figure_uri(figure)}'>"
    return f"<div><b>{html.escape(title)}</b><table>{cells}</table>{picture}</div>"
