"""`lumitree bake`."""

import argparse
from typing import Any

from lumitree.cli import options
from lumitree.cli.output import print_result
from lumitree.errors import LumitreeError

# Options that only one method has.
_DIRECT_ONLY = ("quality", "time", "rays", "seed", "l_max", "law")
_NETWORK_ONLY = ("preset",)


def add(commands: Any) -> None:
    parser = options.command(commands, "bake", "turn a luminaire into an asset", run)
    options.add_luminaire(parser, "; or the folder of a dataset")
    options.add_output(parser, "ASSET", "the .lumitree file; run again to continue")
    parser.add_argument(
        "--method",
        choices=("direct", "nerf"),
        default="direct",
        help="direct: from traced rays, in minutes; nerf: the paper's views and network",
    )
    parser.add_argument(
        "--quality",
        choices=("preview", "standard", "high"),
        help="of direct, on 2 CPU cores: 1 minute and depth 7, 5 and 8 (standard), or 30 and 10",
    )
    # No defaults, so that options of the other method can be refused.
    options.add_budget(parser, seed=None)
    options.add_preset(parser, default=None)
    parser.add_argument(
        "--depth",
        type=int,
        metavar="D",
        help="octree levels, 1 to 10 (default: the quality's or the preset's)",
    )
    parser.add_argument(
        "--l-max", type=int, metavar="L", help="highest harmonics of direct, 0 to 4 (default: 2)"
    )
    parser.add_argument(
        "--law",
        choices=("linear", "exponential"),
        help="transmittance law of direct (default: exponential)",
    )
    options.add_work(parser)
    options.add_variant(parser)


def run(args: argparse.Namespace) -> Any:
    import lumitree

    unused = _NETWORK_ONLY if args.method == "direct" else _DIRECT_ONLY
    if given := [name for name in unused if getattr(args, name) is not None]:
        names = ", ".join("--" + name.replace("_", "-") for name in given)
        raise LumitreeError(f"{names}: unknown to --method {args.method}; leave it out")
    luminaire = options.luminaire(args, args.luminaire)
    if args.method == "nerf":
        result = lumitree.bake_network(
            luminaire,
            args.output,
            preset=args.preset or "preview",
            tree_depth=args.depth,
            work=args.work,
            variant=args.variant,
        )
    else:
        result = lumitree.bake(
            luminaire,
            args.output,
            quality=args.quality or "standard",
            time=args.time,
            rays=args.rays,
            tree_depth=args.depth,
            l_max=args.l_max,
            law=args.law,
            seed=args.seed or 0,
            work=args.work,
            variant=args.variant,
        )
    print_result(result)
    return result
