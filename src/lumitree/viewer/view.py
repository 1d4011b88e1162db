"""The viewer: a web page that shows an asset, and a web server on this computer that serves it.

The page is a template with the asset, style, scripts and shaders in it.
"""

import dataclasses
import html
import os
import sys
from collections.abc import Callable, Sequence
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from lumitree.asset.asset import Asset
from lumitree.core.arguments import check_range
from lumitree.core.backend import in_turn, load_rgb
from lumitree.core.files import FilePath, check_writable, json_text, write_bytes
from lumitree.core.results import Json, Result, Stopwatch
from lumitree.errors import LumitreeError, shown
from lumitree.rendering.asset_cache import open_asset
from lumitree.rendering.view_transform import glsl_constants

# In the order in which they are run; all share one scope.
_SCRIPTS = ("gl.js", "field.js", "model.js", "irradiance.js", "camera.js", "interface.js")
_SHADERS = ("field", "model", "display", "irradiance", "walls")
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


@dataclasses.dataclass(frozen=True, repr=False, kw_only=True)
class ViewResult(Result):
    """Result of `view`. In a notebook it shows the page.

    Attributes:
        luminaire: name of the luminaire.
        page: file that was written; None if none was.
        page_bytes: size of the page.
        html: text of the page.
    """

    luminaire: str
    page: Path | None
    page_bytes: int
    html: str = dataclasses.field(repr=False)

    def _repr_html_(self) -> str:
        return notebook_frame(self.html)


@in_turn
def view(
    asset: Asset | FilePath, output: FilePath | None = None, *, exposure: float = 0.0
) -> ViewResult:
    """Make a web page that shows an asset, and the illuminance around it.

    It shows what images show: the geometry; or the field; or the light field of an asset that has
    neither, blurred and hiding almost nothing. With geometry and a field it shows either.

    Rays are followed through glass and from metals. Other surfaces have the mean radiance
    that they send out, which is traced first: highlights on them do not move with the viewer.

    The page needs a browser with WebGL 2, and loads nothing from a network.

    Args:
        asset: an asset, or the path of a `.lumitree` file, a photometric file or a ray file.
        output: path of the HTML file to write. Default: no file is written.
        exposure: of the lamp when the page is opened, stops more than automatic, -12 to 12.

    Returns:
        The page as `html`; in a notebook, the result shows it.

    Raises:
        LumitreeError: the asset cannot be read, or is too large for a browser; the exposure is out
            of range; or the file has another ending than .html or .htm, or cannot be written.
    """
    check_range("exposure", exposure, -12, 12, "stops")
    if output is not None:
        if Path(output).suffix.lower() not in (".html", ".htm"):
            name = shown(repr(str(output)), 300)
            raise LumitreeError(f"page name {name} does not end in .html")
        check_writable(output)
    # The surfaces of geometry are traced, and directions go through Dr.Jit.
    load_rgb()
    watch = Stopwatch()
    with watch.stage("load"):
        loaded = open_asset(asset)
    with watch.stage("page"):
        html = make_page(loaded, exposure)
        content = html.encode()
        if output is not None:
            write_bytes(output, content)
    return ViewResult(
        luminaire=loaded.luminaire,
        page=None if output is None else Path(output),
        page_bytes=len(content),
        html=html,
        **watch.costs(),
    )


def make_page(asset: Asset, exposure: float = 0.0) -> str:
    """HTML text of a page that shows an asset; it loads nothing. Errors are as in `pack_asset`."""
    import matplotlib

    from lumitree.viewer.packing import pack_asset
    from lumitree.viewer.polar import polar_svg

    packed = pack_asset(asset)
    colours = matplotlib.colormaps["inferno"](np.linspace(0, 1, 256))[:, :3]
    colour_map = np.round(colours * 255).astype(int).ravel().tolist()
    content = {
        **packed.description,
        "block": packed.block,
        "colours": colour_map,
        "exposure": exposure,
    }
    body = page_file("lamp.html").replace("@@POLAR@@", polar_svg(asset))
    return web_page(f"{asset.luminaire} - lumitree", body, content, _SHADERS, _SCRIPTS)


def web_page(
    title: str,
    body: str,
    content: Json,
    shaders: Sequence[str],
    scripts: Sequence[str],
) -> str:
    """HTML text of a page, which loads nothing.

    Args:
        title: of the page.
        body: HTML text of its body.
        content: what the scripts show; `content` in `gl.js`.
        shaders: names of files of the folder `page`, beside "agx".
        scripts: names of files of the folder, in the order in which they are run.
    """
    texts = {name: page_file(f"{name}.glsl") for name in shaders}
    texts["agx"] = glsl_constants() + page_file("agx.glsl")
    parts = {
        "TITLE": html.escape(title),
        "STYLE": page_file("style.css"),
        "BODY": body,
        "CONTENT": _json(content),
        "SHADERS": _json(texts),
        "SCRIPT": "\n".join(map(page_file, scripts)),
    }
    # The parts are joined, and not replaced one after the other: a name may look like a place.
    pieces = page_file("template.html").split("@@")
    return "".join(parts[piece] if index % 2 else piece for index, piece in enumerate(pieces))


def notebook_frame(page: str, height: int = 560) -> str:
    """HTML of an iframe with a page."""
    return (
        f'<iframe srcdoc="{html.escape(page)}" style="width:100%;height:{height}px;border:0" '
        'sandbox="allow-scripts" title="lumitree viewer"></iframe>'
    )


def page_file(name: str) -> str:
    """Text of a file of the folder `page`."""
    return (resources.files("lumitree.viewer") / "page" / name).read_text(encoding="utf-8")


def _json(value: object) -> str:
    """JSON that can stand in a script element: it has no `<`, so that it cannot end it."""
    return json_text(value).replace("<", "\\u003c")


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
            """Whether the request names this computer: a page elsewhere may give this address
            another name (DNS rebinding), and would otherwise be allowed to read the answer.
            """
            port = self.connection.getsockname()[1]
            allowed = {each for name in _NAMES for each in (name, f"{name}:{port}")}
            hosts = self.headers.get_all("Host", [])
            return len(hosts) == 1 and hosts[0].strip().lower() in allowed

        def log_message(self, format: str, *args: object) -> None:
            """Requests are not logged."""

    return Handler
