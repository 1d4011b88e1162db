"""The command and its server."""

import os
import signal
import socket
import subprocess
import sys
import threading
import urllib.request

import pytest

import lumitree
from lumitree.cli import main
from lumitree.errors import LumitreeError
from lumitree.viewer.view import open_server
from support.fields import random_asset


@pytest.fixture
def asset_file(tmp_path):
    path = tmp_path / "lamp.lumitree"
    lumitree.save(random_asset(3), path)
    return path


def test_command_writes_the_page(asset_file, tmp_path, capsys):
    page = tmp_path / "lamp.html"
    assert main(["view", str(asset_file), "-o", str(page)]) == 0
    assert capsys.readouterr().out == f"Open: {page}\n"
    result = lumitree.view(asset_file)
    assert page.read_text() == result.html
    assert result.page is None
    assert result.page_bytes == page.stat().st_size
    assert result._repr_html_().startswith("<iframe srcdoc=")


def test_bad_input_gives_one_line(asset_file, tmp_path, capsys):
    (tmp_path / "page.html").mkdir()
    damaged = tmp_path / "damaged.lumitree"
    damaged.write_bytes(asset_file.read_bytes()[:-1])
    for arguments, message in (
        ([str(damaged)], "damaged.lumitree"),
        ([str(asset_file), "-o", str(tmp_path / "page.html")], "it is a folder"),
        ([str(asset_file), "--port", "70000"], "port 70000; expected 0 to 65535"),
        ([str(asset_file), "--exposure", "13"], "exposure is 13.0; expected -12 to 12 stops"),
    ):
        assert main(["view", *arguments]) == 2
        error = capsys.readouterr().err
        assert message in error
        assert error.count("\n") == 1
    assert list(tmp_path.rglob("*.html")) == [tmp_path / "page.html"]


def test_port_in_use_is_refused():
    with (
        open_server("page") as server,
        pytest.raises(LumitreeError, match=r"cannot serve on port \d+: .*--port"),
    ):
        open_server("other", server.server_address[1])


def test_command_serves_until_interrupted(asset_file):
    process = subprocess.Popen(
        [sys.executable, "-m", "lumitree", "view", str(asset_file)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=os.environ,
    )  # fmt: skip
    try:
        url = process.stdout.readline().split()[1]
        with urllib.request.urlopen(url, timeout=20) as answer:
            assert answer.read().decode() == lumitree.view(asset_file).html
        process.send_signal(signal.SIGINT)
        _, error = process.communicate(timeout=20)
    finally:
        process.kill()
    assert process.returncode == 0
    assert error.endswith("lumitree: the page is no longer served\n")


@pytest.fixture
def port():
    """Port of a server in the background."""
    with open_server("<p>page</p>" * 100_000) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield server.server_address[1]
        server.shutdown()
        thread.join()


def answer(port, request):
    """Status, headers and body of the answer to the bytes of a request."""
    with socket.create_connection(("127.0.0.1", port), timeout=20) as connection:
        connection.sendall(request)
        received = b"".join(iter(lambda: connection.recv(1 << 16), b""))
    head, _, body = received.partition(b"\r\n\r\n")
    first, *lines = head.decode().split("\r\n")
    return int(first.split()[1]), dict(line.split(": ", 1) for line in lines), body


def get(port, *hosts, method="GET", path="/"):
    lines = [f"{method} {path} HTTP/1.1", *(f"Host: {host}" for host in hosts), "", ""]
    return answer(port, "\r\n".join(lines).encode())


def test_only_names_of_this_computer_are_answered(port):
    for name in ("localhost", "127.0.0.1", "[::1]", "LocalHost"):
        for host in (name, f"{name}:{port}"):
            assert get(port, host)[0] == 200
    for host in ("evil.example", f"evil.example:{port}", f"localhost:{port + 1}", "localhost.evil",
                 "127.0.0.1.evil.example", "0.0.0.0", "", f"evil@localhost:{port}"):  # fmt: skip
        status, headers, body = get(port, host)
        assert (status, headers["Content-Type"]) == (403, "text/plain; charset=utf-8")
        assert b"page" not in body
    assert get(port)[0] == 403
    assert get(port, "localhost", "evil.example")[0] == 403
    assert answer(port, b"GET http://evil.example/ HTTP/1.1\r\nHost: localhost\r\n\r\n")[0] == 404


def test_head_and_headers(port):
    status, headers, body = get(port, "localhost", method="HEAD")
    assert (status, body) == (200, b"")
    assert headers["Content-Length"] == "1100000"
    for name, value in (
        ("Cache-Control", "no-store"),
        ("Cross-Origin-Resource-Policy", "same-origin"),
        ("Referrer-Policy", "no-referrer"),
        ("X-Content-Type-Options", "nosniff"),
    ):
        assert headers[name] == value
    assert get(port, "localhost", path="/?a=1")[0] == 200
    assert get(port, "localhost", path="/other")[0] == 404
