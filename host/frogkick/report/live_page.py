"""A page that draws a run in progress, served to this computer only."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from frogkick.core.local_server import QuietHandler, serving
from frogkick.report import style
from frogkick.report.page import rendered

ASKS = "X-Frogkick"
"""Header of a request to act; pages of other sites cannot send it here."""


def page(stops: bool = False) -> str:
    """Return the page, which reads ``state.json`` ten times a second; ``stops``: a button ends the run."""
    colours = {
        name.lower(): getattr(style, name)
        for name in ("DESIRED", "TRUE", "MEASURED", "ESTIMATED", "PREDICTED", "NOMINAL", "ALARM")
    }
    return rendered("live.html.jinja", colours=colours, stops=stops, asks=ASKS)


@contextmanager
def served(
    state: Callable[[], str],
    picture: Callable[[], tuple[bytes, dict[str, str]] | None] | None = None,
    stop: Callable[[], None] | None = None,
) -> Iterator[str]:
    """Serve the page as long as the context lives.

    Args:
        state: returns the newest state as JSON; it is called from other threads.
        picture: returns the camera's newest picture as JPEG with headers, or None if there is none yet. It is
            called from other threads when a page reads it. None: there is no camera.
        stop: ends the run; it is called from another thread when the button is pressed. None: no button.

    Returns:
        The page's address.
    """
    text = page(stop is not None).encode()

    class Handler(QuietHandler):
        def do_GET(self) -> None:
            if self.path == "/":
                self.answer("text/html; charset=utf-8", text)
            elif self.path == "/state.json":
                self.answer("application/json", state().encode())
            elif self.path == "/picture.jpg" and picture is not None and (made := picture()) is not None:
                self.answer("image/jpeg", *made)
            else:
                self.send_error(404)

        def do_POST(self) -> None:
            if self.path != "/stop" or stop is None or self.headers.get(ASKS) != "stop":
                self.send_error(404)
                return
            stop()
            self.send_response(204)
            self.end_headers()

    with serving(Handler) as base:
        yield f"{base}/"
