"""`lumitree bake`."""

import argparse
from typing import Any

from lumitree.cli import options
from lumitree.cli.output import print_lamps, print_open, print_result
from lumitree.errors import LumitreeError, shown

# Options that apply to one method only.
_DIRECT_ONLY = ("quality", "time", "rays", "l_max", "law", "lumens", "temperature")
_NETWORK_ONLY = ("preset",)


def add(commands: Any) -> None:
    parser = options.command(commands, "bake", "convert a luminaire into an asset", run, show)
    options.add_luminaire(
        parser,
        "; or the folder of a dataset, or a photometric file (.ies, .ldt, .ray, .tm25ray). Several "
        "are baked into a folder",
        many=True,
    )
    options.add_output(
        parser,
        "ASSET|FOLDER/",
        "the .lumitree file to write; for several luminaires, or with / at the end, a folder for "
        "the assets and an index page. The same command continues an interrupted bake",
    )
    parser.add_argument(
        "--method",
        choices=("direct", "nerf"),
        default="direct",
        help="direct: from traced rays, in minutes; nerf: by a network, as in the paper; "
        "needs the extra 'network'",
    )
    parser.add_argument(
        "--quality",
        choices=("preview", "standard", "high"),
        help="direct only. preview: depth 7, 1 minute on 2 CPU cores; standard (default): depth 8, "
        "5 minutes; high: depth 10, 30 minutes",
    )
    # There are no defaults here, so that `run` can refuse options of the other method.
    options.add_budget(parser, seed=None)
    options.add_preset(parser, default=None)
    parser.add_argument(
        "--depth",
        type=int,
        metavar="D",
        help="tree depth, 1 to 10 (default: that of the quality or of the preset)",
    )
    parser.add_argument(
        "--l-max",
        dest="l_max",
        type=int,
        metavar="L",
        help="direct only: highest band of the spherical harmonics, 0 to 4 (default: 2)",
    )
    parser.add_argument(
        "--law",
        choices=("linear", "exponential"),
        help="direct only: transmittance law (default: exponential)",
    )
    parser.add_argument(
        "--parts",
        type=lambda text: tuple(text.split(",")),
        metavar="PARTS",
        help="what the asset gets, separated by commas. exitant: what the luminaire "
        "sends to its surroundings; field: what images show of it; model: the luminaire itself, "
        "which images show in place of the field, not for --method nerf (default: all that the "
        "method and the luminaire allow)",
    )
    options.add_irradiance_paths(parser, None)
    parser.add_argument(
        "--lumens",
        type=float,
        metavar="LM",
        help="direct only: luminous flux of the asset, lm, if lengths are in metres (default: that "
        "of the luminaire)",
    )
    parser.add_argument(
        "--temperature",
        type=float,
        metavar="K",
        help="direct only: colour temperature of the whole flux, 1000 to 20000 K; all colours get "
        "the same factors (default: the colours of the luminaire)",
    )
    options.add_work(parser)
    options.add_variant(parser)


def run(args: argparse.Namespace) -> Any:
    import lumitree

    unused = _NETWORK_ONLY if args.method == "direct" else _DIRECT_ONLY
    if given := [name for name in unused if getattr(args, name) is not None]:
        names = ", ".join("--" + name.replace("_", "-") for name in given)
        raise LumitreeError(f"{names}: not for --method {args.method}; leave it out")
    many = len(args.luminaires) > 1 or args.output.endswith("/")
    if many:
        return _run_many(args)
    luminaire = options.luminaire(args, args.luminaires[0])
    if args.method == "nerf":
        from lumitree.fit.bake_network import NETWORK_PARTS

        return lumitree.bake_network(
            luminaire,
            args.output,
            preset=args.preset or "preview",
            tree_depth=args.depth,
            parts=args.parts or NETWORK_PARTS,
            irradiance_paths=args.irradiance_paths,
            seed=args.seed or 0,
            work=args.work,
            variant=args.variant,
        )
    return lumitree.bake(
        luminaire,
        args.output,
        **_settings(args),
        work=args.work,
        variant=args.variant,
    )


def show(args: argparse.Namespace, result: Any) -> None:
    import lumitree

    if isinstance(result, lumitree.BakeManyResult):
        print_lamps(result.lamps)
        print_open(result.index)
    else:
        print_result(result, result.path)


def _settings(args: argparse.Namespace) -> dict[str, Any]:
    """Settings of a direct bake."""
    return {
        "quality": args.quality or "standard",
        "time": args.time,
        "rays": args.rays,
        "tree_depth": args.depth,
        "l_max": args.l_max,
        "law": args.law,
        "parts": args.parts,
        "irradiance_paths": args.irradiance_paths,
        "lumens": args.lumens,
        "temperature": args.temperature,
        "seed": args.seed or 0,
    }


def _run_many(args: argparse.Namespace) -> Any:
    import lumitree

    if args.method == "nerf" or args.work is not None:
        what = "--method nerf" if args.method == "nerf" else "--work"
        raise LumitreeError(f"{what}: for one luminaire at a time; leave it out")
    if args.output.endswith(".lumitree"):
        raise LumitreeError(
            f"{shown(args.output, 300)} is the name of one asset, but there are "
            f"{len(args.luminaires)} luminaires; give a folder"
        )
    luminaires = [options.luminaire(args, name) for name in args.luminaires]
    return lumitree.bake_many(luminaires, args.output, variant=args.variant, **_settings(args))
