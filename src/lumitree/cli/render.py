"""`lumitree render`."""

import argparse
from typing import Any

from lumitree.cli import options
from lumitree.cli.output import check_outputs, image_report, print_open, print_report


class _Place(argparse.Action):
    """`--place` adds a placement; `--at` and the others set values of the latest one."""

    def __call__(self, parser, namespace, values, option_string=None):
        if self.dest == "place":
            namespace.place = [*(namespace.place or []), {"source": values}]
        elif not namespace.place:
            parser.error(f"{option_string} comes before any --place")
        elif self.dest in namespace.place[-1]:
            parser.error(f"{option_string} is given twice for {namespace.place[-1]['source']}")
        else:
            namespace.place[-1][self.dest] = values


def add(commands: Any) -> None:
    text = "render a Mitsuba scene with luminaires placed in it"
    parser = options.command(commands, "render", text, run, show)
    parser.add_argument("scene", metavar="SCENE.xml", help="a Mitsuba 3 scene with a camera")
    options.add_output(
        parser, "IMAGE", "image to write, .exr (linear radiance) or .png (as --view shows it)"
    )
    _add_placements(parser)
    parser.add_argument(
        "--spp",
        type=int,
        metavar="N",
        help="samples per pixel (default: 64, or no limit if there is a --time or a --noise)",
    )
    parser.add_argument(
        "--time",
        type=options.duration,
        metavar="T",
        help="time of rendering, such as 90s, 5m or 1h",
    )
    parser.add_argument(
        "--noise",
        type=float,
        metavar="X",
        help="estimated relative error of the pixels, such as 0.02; the image is finished when the "
        "first of --spp, --time and --noise is reached",
    )
    parser.add_argument(
        "--denoise",
        action="store_true",
        help="filter the noise out with Open Image Denoise (`pip install 'lumitree[denoise]'`)",
    )
    parser.add_argument(
        "--progressive",
        action="store_true",
        help="write the image again and again while it is rendered, before denoising",
    )
    options.add_view(parser)
    parser.add_argument(
        "--layers",
        metavar="FILE.exr",
        help="also write the light of each luminaire as a layer, for `lumitree mix`",
    )
    parser.add_argument(
        "--aov",
        metavar="FILE.exr",
        help="also write the image before denoising, albedo and normal",
    )
    parser.add_argument(
        "--width",
        type=int,
        metavar="W",
        help="width of the image in pixels (default: the scene's)",
    )
    parser.add_argument(
        "--proxy",
        choices=("box", "sphere"),
        default="box",
        help="surface that carries a baked luminaire",
    )
    options.add_variant(parser, "; llvm_ad_spectral or cuda_ad_spectral to render spectra")


def _add_placements(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--place",
        action=_Place,
        metavar="ASSET",
        help=f"a .lumitree file{options.PHOTOMETRIC}; or a LUMINAIRE, which is placed as explicit "
        "geometry; may be repeated, each with its own --at, --size, --rotate, --gain, --lumens and "
        "--temperature",
    )
    parser.add_argument(
        "--at",
        action=_Place,
        type=options.vector(3),
        metavar="X,Y,Z",
        help="centre of the bounding box, scene units (default: as in the luminaire's file)",
    )
    parser.add_argument(
        "--size",
        action=_Place,
        type=float,
        metavar="S",
        help="largest side of the bounding box, scene units (default: as in the luminaire's file)",
    )
    parser.add_argument(
        "--rotate",
        action=_Place,
        type=options.vector(4),
        metavar="AX,AY,AZ,DEG",
        help="rotation about the centre: axis, and angle in degrees",
    )
    parser.add_argument(
        "--gain",
        action=_Place,
        type=options.vector(1, 3),
        metavar="R,G,B",
        help="factors on the red, green and blue light of an asset, or one number for all "
        "(default: 1)",
    )
    parser.add_argument(
        "--lumens",
        action=_Place,
        type=float,
        metavar="LM",
        help="luminous flux of an asset in the scene before --gain, lm, if the scene is in "
        "metres (default: its own)",
    )
    parser.add_argument(
        "--temperature",
        action=_Place,
        type=float,
        metavar="K",
        help="colour temperature of the light of an asset before --gain, 1000 to 20000 K "
        "(default: its own colour)",
    )
    parser.add_argument(
        "--placements",
        metavar="FILE",
        help="TOML file with a table [lamps.NAME] for each lamp; its lamps come before those of "
        "--place",
    )


def run(args: argparse.Namespace) -> Any:
    import lumitree

    check_outputs(args.output, args.layers, args.aov)
    placements = [] if args.placements is None else lumitree.read_placements(args.placements)
    placements += [lumitree.Placement(**placement) for placement in args.place or ()]
    result = lumitree.render(
        args.scene,
        placements,
        samples_per_pixel=args.spp,
        time=args.time,
        noise=args.noise,
        denoise=args.denoise,
        layers=args.layers is not None,
        aov=args.aov is not None,
        width=args.width,
        view=args.view,
        so_far=(lambda image: image.save(args.output)) if args.progressive else None,
        proxy=args.proxy,
        variant=args.variant,
    )
    if args.aov is not None:
        result.save_aov(args.aov)
    if args.layers is not None:
        result.save_layers(args.layers)
    result.save(args.output)
    return image_report(result, args.output) | {"layers": args.layers, "aov": args.aov}


def show(args: argparse.Namespace, result: Any) -> None:
    print_report(result)
    print_open(args.output)
