"""`lumitree render`."""

import argparse
from typing import Any

from lumitree.cli import options
from lumitree.cli.output import check_outputs, image_report, print_open, print_report
from lumitree.cli.placements import add_placements, placements


def add(commands: Any) -> None:
    text = "render a Mitsuba scene with luminaires placed in it"
    parser = options.command(commands, "render", text, run, show)
    parser.add_argument("scene", metavar="SCENE.xml", help="a Mitsuba 3 scene with a camera")
    options.add_output(
        parser, "IMAGE", "image to write, .exr (linear radiance) or .png (as --view shows it)"
    )
    add_placements(parser)
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
        type=options.Output,
        metavar="FILE.exr",
        help="also write the light of each luminaire as a layer, for `lumitree mix`",
    )
    parser.add_argument(
        "--aov",
        type=options.Output,
        metavar="FILE.exr",
        help="also write the image before denoising, albedo and normal",
    )
    parser.add_argument(
        "--luminance",
        type=options.Output,
        metavar="FILE.png",
        help="also write the luminance in false colours, with a legend in cd/m²",
    )
    parser.add_argument(
        "--glare",
        action="store_true",
        help="also compute the glare of the view: UGR, and DGP for daylight",
    )
    parser.add_argument(
        "--width",
        type=int,
        metavar="W",
        help="width of the image in pixels (default: the scene's)",
    )
    options.add_work(parser, "IMAGE followed by .work")
    options.add_variant(parser, "; llvm_ad_spectral or cuda_ad_spectral to render spectra")
    options.add_executor(parser, "the samples")


def run(args: argparse.Namespace) -> Any:
    import lumitree
    from lumitree.core.arguments import check_sheet_output
    from lumitree.core.backend import load_rgb
    from lumitree.core.results import plain
    from lumitree.rendering.render_job import forget_passes

    check_outputs(args.output, args.layers, args.aov)
    if args.luminance is not None:
        check_sheet_output(args.luminance, "luminance image")
    if args.glare:
        # For the illuminance at the camera.
        load_rgb(args.variant)
    work = f"{args.output}.work" if args.work is None else args.work
    with options.executor(args) as executor:
        result = lumitree.render(
            args.scene,
            placements(args),
            spp=args.spp,
            time=args.time,
            noise=args.noise,
            denoise=args.denoise,
            layers=args.layers is not None,
            aov=args.aov is not None,
            width=args.width,
            unit=options.number(args.unit),
            view=args.view,
            exposure=args.exposure,
            so_far=(lambda image: image.save(args.output)) if args.progressive else None,
            work=work,
            variant=args.variant,
            executor=executor,
        )
    if args.aov is not None:
        result.save_aov(args.aov)
    if args.layers is not None:
        result.save_layers(args.layers)
    if args.luminance is not None:
        result.save_luminance(args.luminance)
    result.save(args.output)
    if args.work is None:
        forget_passes(work)
    further = {"layers": args.layers, "aov": args.aov, "luminance": args.luminance}
    if args.glare:
        further["glare"] = plain(_glare(args, result))
    return image_report(result, args.output) | further


def _glare(args: argparse.Namespace, result: Any) -> Any:
    """Glare of the image, with the illuminance at the camera."""
    import lumitree

    if result.camera is None:
        return lumitree.glare(result, 0)
    eye = lumitree.illuminance(
        args.scene,
        placements(args),
        points=[result.camera.origin],
        normals=[result.camera.direction],
        unit=options.number(args.unit),
        variant=args.variant,
    )
    return lumitree.glare(result, float(eye.total[0]))


def show(args: argparse.Namespace, result: Any) -> None:
    print_report(result)
    print_open(args.output)
