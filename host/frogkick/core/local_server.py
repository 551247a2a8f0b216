"""HTTP for this computer alone: pages of a run, pictures of a simulated camera."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from frogkick.core.errors import InputError

HOST = "127.0.0.1"


class QuietHandler(BaseHTTPRequestHandler):
    """Answers requests without a line for each of them."""

    def log_message(self, format: str, *args: object) -> None: ...

    def answer(self, kind: str, content: bytes | None, more: Mapping[str, str] | None = None) -> None:
        """Send a page or a file of a MIME type, with further headers; of a stream only the headers."""
        self.send_response(200)
        for name, value in (more or {}).items():
            self.send_header(name, value)
        self.send_header("Content-Type", kind)
        if content is not None:
            self.send_header("Content-Length", str(len(content)))
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        self.wfile.write(content or b"")


class _Server(ThreadingHTTPServer):
    daemon_threads = True

    def handle_error(self, request: object, client_address: object) -> None:
        """Ignore a viewer that leaves while it is answered; report other errors as usual."""
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)  # type: ignore[arg-type]


@contextmanager
def serving(handler: type[QuietHandler], port: int = 0) -> Iterator[str]:
    """Serve as long as the context lives; yield the address, without a slash at its end.

    A handler answers each request in a thread of its own. InputError where the TCP port (0: a free one) is
    taken, or is none.
    """
    try:
        server = _Server((HOST, port), handler)
    except (OSError, OverflowError) as error:
        raise InputError(
            f"nothing can be served on TCP port {port} ({getattr(error, 'strerror', None) or error}): "
            "give another --port, or 0 for a free one"
        ) from error
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://{HOST}:{server.server_address[1]}"
    finally:
        server.shutdown()
        server.server_close()
