"""`lumitree view`."""

import argparse
from typing import Any

from lumitree.cli import options
from lumitree.cli.output import print_open
from lumitree.core.interruption import deferred_interrupt

# Interval at which a server looks whether it is to end, s.
_LOOK_SECONDS = 0.2


def add(commands: Any) -> None:
    parser = options.command(commands, "view", "show an asset in a web browser", run, show)
    parser.add_argument("asset", metavar="ASSET", help=f"a .lumitree file{options.PHOTOMETRIC}")
    parser.add_argument(
        "-o",
        dest="output",
        type=options.Output,
        metavar="FILE",
        help="HTML file to write, which needs no other file and no network (default: the page is "
        "served on this computer until Ctrl-C)",
    )
    parser.add_argument(
        "--port", type=int, metavar="P", default=0, help="port to serve on (default: a free one)"
    )


def run(args: argparse.Namespace) -> Any:
    import lumitree
    from lumitree.viewer.view import address, open_server

    result = lumitree.view(args.asset, args.output)
    if result.page is not None:
        return result
    with (
        open_server(result.html, args.port) as server,
        deferred_interrupt("the page is no longer served") as stop,
    ):
        print(f"open {address(server)} in a browser; Ctrl-C ends", flush=True)
        server.timeout = _LOOK_SECONDS
        while not stop:
            server.handle_request()
    return result


def show(args: argparse.Namespace, result: Any) -> None:
    print_open(result.page)
