"""`lumitree mix`."""

import argparse
from typing import Any

from lumitree.cli import options
from lumitree.cli.output import check_outputs, image_report, print_open, print_report


def add(commands: Any) -> None:
    text = "change the brightness and colour of lamps in an image, without rendering it again"
    parser = options.command(commands, "mix", text, run, show)
    parser.add_argument("layers", metavar="LAYERS.exr", help="a file of `render --layers`")
    options.add_output(
        parser, "IMAGE", "image to write, .exr (linear radiance) or .png (as --view shows it)"
    )
    parser.add_argument(
        "--gain",
        action="append",
        type=_gain,
        default=[],
        metavar="LAYER=R,G,B",
        help="factors on the red, green and blue light of a layer, or one number for all; may be "
        "repeated",
    )
    options.add_view(parser)


def run(args: argparse.Namespace) -> Any:
    import lumitree

    check_outputs(args.output)
    result = lumitree.mix(args.layers, dict(args.gain), view=args.view, exposure=args.exposure)
    result.save(args.output)
    return image_report(result, args.output)


def show(args: argparse.Namespace, result: Any) -> None:
    print_report(result)
    print_open(args.output)


def _gain(text: str) -> tuple[str, Any]:
    name, equals, numbers = text.rpartition("=")
    if not equals or not name:
        raise argparse.ArgumentTypeError(f"{text!r} is not LAYER=GAIN; write lamp=0.5")
    values = options.vector(1, 3)(numbers)
    return name, values if len(values) == 3 else values[0]
