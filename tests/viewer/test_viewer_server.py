"""The command and its server."""

import os
import signal
import subprocess
import sys
import urllib.request

import pytest

import lumitree
from fields import random_asset
from lumitree.cli import main
from lumitree.errors import LumitreeError
from lumitree.viewer.server import address, open_server


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
    damaged = tmp_path / "damaged.lumitree"
    damaged.write_bytes(asset_file.read_bytes()[:-1])
    for arguments, message in (
        ([str(damaged)], "damaged.lumitree"),
        ([str(asset_file), "-o", str(tmp_path)], "it is a folder"),
        ([str(asset_file), "--port", "70000"], "port 70000; expected 0 to 65535"),
    ):
        assert main(["view", *arguments]) == 2
        error = capsys.readouterr().err
        assert message in error
        assert error.count("\n") == 1
    assert not list(tmp_path.glob("*.html"))


def test_port_in_use_is_refused():
    with (
        open_server("page") as server,
        pytest.raises(LumitreeError, match=r"cannot serve on port \d+: .*--port"),
    ):
        open_server("other", server.server_address[1])


def test_command_serves_until_interrupted(asset_file):
    process = subprocess.Popen(
        [sys.executable, "-m", "lumitree.cli", "view", str(asset_file)],
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
    assert process.returncode == 130
    assert error.endswith("interrupted; the page is no longer served\n")


def test_address_is_of_this_computer():
    with open_server("page") as server:
        assert address(server).startswith("http://127.0.0.1:")
