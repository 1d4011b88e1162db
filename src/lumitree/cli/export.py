"""`lumitree export`."""

import argparse
from typing import Any

from lumitree.cli import options
from lumitree.cli.output import print_open, print_report


def add(commands: Any) -> None:
    parser = options.command(commands, "export", "write an asset for another program", run, show)
    parser.add_argument(
        "asset",
        metavar="ASSET",
        help="a .lumitree file with a light field, or with a field for .vdb; or a photometric file",
    )
    options.add_output(
        parser,
        "OUTPUT",
        "what to write: .py (a script that contains the lamp and runs in Blender 4.2 or newer), "
        ".blend (the same, made by Blender), .vdb (density and emission of the field), .rad "
        "(Radiance), .pbrt (pbrt-v4), .usda or .usdz (OpenUSD), .glb (glTF), or a folder (an IES "
        "file for each light, for all others)",
    )
    parser.add_argument(
        "--lights", type=int, metavar="N", default=16, help="largest number of point lights"
    )
    parser.add_argument(
        "--unit",
        default="m",
        metavar="UNIT",
        help="unit of length of the Mitsuba scene of the lamp: m, cm, mm, in, ft, or the metres in "
        "a unit; models and photometric files are in metres once they are baked",
    )
    parser.add_argument(
        "--up",
        choices=("y", "z"),
        default="y",
        help="axis that points up in the Mitsuba scene of the lamp; models and photometric files "
        "have y up once they are baked",
    )
    parser.add_argument(
        "--blender",
        metavar="PROGRAM",
        help="Blender, or a Python with the module bpy, for .blend and .vdb (default: blender on "
        "PATH, else this Python if it has bpy)",
    )
    parser.add_argument(
        "--importer",
        choices=("any", "blender"),
        default="any",
        help="program that reads the .glb, .usda or .usdz: for blender, lights that its importers "
        "turn into the illumination of .py, and no surfaces (default: any)",
    )


def run(args: argparse.Namespace) -> Any:
    import lumitree

    return lumitree.export(
        args.asset,
        args.output,
        lights=args.lights,
        unit=options.number(args.unit),
        up=args.up,
        blender=args.blender,
        importer=args.importer,
    )


def show(args: argparse.Namespace, result: Any) -> None:
    report = result.to_json()
    report["files"] = len(result.files)
    for line in report.pop("not_carried_over"):
        print(f"note: {line}")
    print_report(report)
    print_open(result.file)
