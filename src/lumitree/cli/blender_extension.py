"""`lumitree blender-extension`."""

import argparse
from typing import Any

from lumitree.cli import options
from lumitree.cli.output import print_result


def add(commands: Any) -> None:
    text = "write the extension for Blender, which imports assets and bakes objects"
    parser = options.command(commands, "blender-extension", text, run, show)
    options.add_output(
        parser,
        "FILE",
        ".zip file to write; Blender installs it: Edit, Preferences, Add-ons, Install from Disk",
    )


def run(args: argparse.Namespace) -> Any:
    import lumitree

    return lumitree.blender_extension(args.output)


def show(args: argparse.Namespace, result: Any) -> None:
    print_result(result, result.file)
