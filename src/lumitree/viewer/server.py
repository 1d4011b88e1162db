"""A web server on this computer that serves one page."""

from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from lumitree.errors import LumitreeError

# Only programs of the same computer can connect.
_HOST = "127.0.0.1"


def open_server(page: str, port: int = 0) -> ThreadingHTTPServer:
    """A server that answers `/` with a page; its `serve_forever` runs it.

    Args:
        page: HTML text.
        port: TCP port, 0 to 65535. 0: a free one.

    Raises:
        LumitreeError: the port is out of range, in use, or not permitted.
    """
    if not 0 <= port <= 65535:
        raise LumitreeError(f"port {port}; expected 0 to 65535")
    try:
        return _Server((_HOST, port), _handler(page.encode()))
    except OSError as error:
        reason = error.strerror or str(error)
        raise LumitreeError(
            f"cannot serve on port {port}: {reason}; choose another --port, or 0 for a free one"
        ) from error


def address(server: ThreadingHTTPServer) -> str:
    """URL of the page."""
    return f"http://{_HOST}:{server.server_address[1]}/"


class _Server(ThreadingHTTPServer):
    # Else a browser's open connection would keep the command from ending.
    daemon_threads = True


def _handler(content: bytes) -> Callable[..., BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            found = self.path.partition("?")[0] == "/"
            body = content if found else b"not found"
            self.send_response(200 if found else 404)
            self.send_header("Content-Type", "text/html; charset=utf-8" if found else "text/plain")
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, format: str, *args: Any) -> None:
            """Requests are not logged."""

    return Handler
