"""A headless Chromium that runs one expression in a page, and returns its value as JSON."""

import contextlib
import json
import os
import shutil
import signal
import subprocess
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
_FLAGS = ["--headless", "--no-sandbox", "--disable-quic", "--no-first-run"]
_FLAGS += ["--disable-background-networking", "--disable-component-update", "--disable-sync"]
_FLAGS += ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


def evaluate(page, expression, profile, timeout=240):
    """Value of a JavaScript expression, which may be a promise, in a page.

    Args:
        page: HTML text.
        profile: an empty folder.
        timeout: s.
    """
    script = (
        f"<script>(async () => ({expression}))().then(v => JSON.stringify(v), e => JSON.stringify("
        "{error: String(e)})).then(body => fetch('/', {method: 'POST', body}))</script>"
    )
    # The page itself may connect to nothing.
    content = page.replace("default-src 'none'", "default-src 'none'; connect-src 'self'")
    content = content.replace("</body>", f"{script}</body>").encode()
    received, answer = threading.Event(), []

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self):
            self._reply(content)

        def do_POST(self):
            answer.append(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
            self._reply(b"")
            received.set()

        def _reply(self, body):
            self.send_response(200)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, format, *args):
            pass

    with contextlib.ExitStack() as stack:
        server = stack.enter_context(ThreadingHTTPServer(("127.0.0.1", 0), Handler))
        server.daemon_threads = True
        threading.Thread(target=server.serve_forever, daemon=True).start()
        stack.callback(server.shutdown)
        url = f"http://127.0.0.1:{server.server_address[1]}/"
        browser = subprocess.Popen(
            [CHROMIUM, *_FLAGS, "--remote-debugging-port=0", f"--user-data-dir={profile}", url],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        stack.callback(browser.wait)
        stack.callback(os.killpg, browser.pid, signal.SIGKILL)
        assert received.wait(timeout), "the page did not answer"
    assert not (isinstance(answer[0], dict) and "error" in answer[0]), answer[0]
    return answer[0]
