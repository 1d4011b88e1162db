"""A web server on this computer that serves one page."""

import os
import sys
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from lumitree.errors import LumitreeError

# Only programs of the same computer can connect.
_HOST = "127.0.0.1"
# Names of this computer by which a browser may ask.
_NAMES = ("localhost", "127.0.0.1", "[::1]")
# Headers of every answer: no other page may load it, and browsers keep no copy.
_HEADERS = {
    "Cache-Control": "no-store",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}


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
    # On Windows two servers could have one port.
    allow_reuse_address = os.name != "nt"
    # Else the sixth connection at a time waits for a second.
    request_queue_size = 128

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Report nothing where the browser closed the connection, which is no error."""
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)


def _handler(content: bytes) -> Callable[..., BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        # Connections that send no request end after this time, s.
        timeout = 60

        def do_GET(self) -> None:
            self._answer(with_body=True)

        def do_HEAD(self) -> None:
            self._answer(with_body=False)

        def _answer(self, with_body: bool) -> None:
            if not self._is_local():
                status, kind, body = 403, "text/plain", b"this host name is not served\n"
            elif self.path.partition("?")[0] == "/":
                status, kind, body = 200, "text/html", content
            else:
                status, kind, body = 404, "text/plain", b"not found\n"
            self.send_response(status)
            self.send_header("Content-Type", f"{kind}; charset=utf-8")
            self.send_header("Content-Length", str(len(body)))
            for name, value in _HEADERS.items():
                self.send_header(name, value)
            self.end_headers()
            if with_body:
                self.wfile.write(body)

        def _is_local(self) -> bool:
            """Whether the request names this computer: a page elsewhere may have a name of its own
            for this address (DNS rebinding), and would otherwise be allowed to read the answer.
            """
            port = self.connection.getsockname()[1]
            allowed = {each for name in _NAMES for each in (name, f"{name}:{port}")}
            hosts = self.headers.get_all("Host", [])
            return len(hosts) == 1 and hosts[0].strip().lower() in allowed

        def log_message(self, format: str, *args: Any) -> None:
            """Requests are not logged."""

    return Handler
