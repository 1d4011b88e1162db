"""`lumitree preview`."""

import argparse
from typing import Any

from lumitree.cli import options
from lumitree.cli.output import print_lines, print_open, print_result

# Shapes that are printed.
_MAX_SHAPES = 20


def add(commands: Any) -> None:
    text = "render a luminaire or an asset from six sides, and print its figures and its shapes"
    parser = options.command(commands, "preview", text, run, show)
    options.add_luminaire(parser, f"; or a .lumitree file{options.PHOTOMETRIC}")
    options.add_output(parser, "SHEET", "contact sheet to write, .png")
    options.add_pixels(parser, 256, 64)
    parser.add_argument(
        "--bounces",
        action="store_true",
        help="also measure the share of the flux that paths of 32, 64 and 128 bounces miss",
    )
    options.add_variant(parser)


def run(args: argparse.Namespace) -> Any:
    import lumitree

    return lumitree.preview(
        options.luminaire(args, args.luminaire),
        args.output,
        resolution=args.resolution,
        spp=args.spp,
        bounces=args.bounces,
        variant=args.variant,
    )


def show(args: argparse.Namespace, result: Any) -> None:
    import lumitree

    if isinstance(result, lumitree.AssetPreviewResult):
        print_result(result, result.sheet)
        return
    watts = ", ".join(f"{value:.4g}" for value in result.flux.watts)
    errors = ", ".join(f"{value:.2g}" for value in result.flux.watts_error)
    lines = {
        "luminaire": result.luminaire,
        "triangles": f"{result.triangles:,}",
        "emitters": result.emitters,
        "L_max": f"{result.max_radiance:.4g} W/(m² sr)",
        "size": " x ".join(f"{side:.4g}" for side in result.size),
        "media": "yes" if result.has_media else "no",
        "flux": f"{result.flux} (if lengths are in metres)",
        "flux R, G, B": f"{watts} ± {errors} W",
        "paths per second": f"{result.paths_per_second:,.0f}",
    }
    for item in result.bounces or ():
        name = f"beyond {item.path_depth} bounces"
        lines[name] = f"{100 * item.share:.2g} ± {100 * item.error:.1g} % of the flux"
    print_lines(lines)
    for shape in result.shapes[:_MAX_SHAPES]:
        print_lines({"shape": shape})
    if (more := len(result.shapes) - _MAX_SHAPES) > 0:
        print_lines({"shapes": f"{more:,} more; --json writes all"})
    print_lines({"sheet": result.sheet})
    print_open(result.sheet)
