"""Options that place luminaires in a scene."""

import argparse
from typing import Any, ClassVar

from lumitree.cli import options


class Grouped(argparse.Action):
    """An option that begins a group, or one that sets a value of the latest group.

    Class attributes: `into` is the destination of the list of groups, which are dictionaries.
    `begins` has the destinations of the options that begin one, and the key of their value in it.
    """

    into = "place"
    begins: ClassVar[dict[str, str]] = {"place": "source"}

    def __call__(self, parser, namespace, values, option_string=None):
        groups = getattr(namespace, self.into, None) or []
        if self.dest in self.begins:
            setattr(namespace, self.into, [*groups, {self.begins[self.dest]: values}])
        elif not groups:
            expected = " or ".join(f"--{each}" for each in self.begins)
            parser.error(f"{option_string} comes before any {expected}")
        elif self.dest in groups[-1]:
            first = next(iter(groups[-1].values()))
            parser.error(f"{option_string} is given twice for {first}")
        else:
            groups[-1][self.dest] = values


def add_placements(parser: argparse.ArgumentParser) -> None:
    """Add `--place` and the options that follow it, `--placements` and `--unit`."""
    parser.add_argument(
        "--place",
        action=Grouped,
        metavar="ASSET",
        help=f"a .lumitree file{options.PHOTOMETRIC}; or a LUMINAIRE, which is placed as explicit "
        "geometry; may be repeated, each with its own --at, --size, --rotate, --gain, --lumens and "
        "--temperature",
    )
    parser.add_argument(
        "--at",
        action=Grouped,
        type=options.vector(3),
        metavar="X,Y,Z",
        help="centre of the bounding box, scene units (default: as in the luminaire's file)",
    )
    parser.add_argument(
        "--size",
        action=Grouped,
        type=float,
        metavar="S",
        help="largest side of the bounding box, scene units (default: as in the luminaire's file); "
        "the flux of a photometric file stays",
    )
    parser.add_argument(
        "--rotate",
        action=Grouped,
        type=options.vector(4),
        metavar="AX,AY,AZ,DEG",
        help="rotation about the centre: axis, and angle in degrees",
    )
    parser.add_argument(
        "--gain",
        action=Grouped,
        type=options.vector(1, 3),
        metavar="R,G,B",
        help="factors on the red, green and blue light of an asset, or one number for all "
        "(default: 1)",
    )
    parser.add_argument(
        "--lumens",
        action=Grouped,
        type=float,
        metavar="LM",
        help="luminous flux of an asset in the scene before --gain, lm (default: its own)",
    )
    parser.add_argument(
        "--temperature",
        action=Grouped,
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
    parser.add_argument(
        "--unit",
        metavar="UNIT",
        default="m",
        help="unit of length of the scene, for --lumens and photometric files: m, cm, mm, in, ft, "
        "or the metres in a unit",
    )


def placements(args: argparse.Namespace) -> list[Any]:
    """The placements of these options."""
    import lumitree

    listed = [] if args.placements is None else lumitree.read_placements(args.placements)
    return listed + [lumitree.Placement(**placement) for placement in args.place or ()]
