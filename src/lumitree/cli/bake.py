"""`lumitree bake`."""

import argparse
import dataclasses
import glob
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lumitree.cli import options
from lumitree.cli.output import print_lamps, print_open, print_report
from lumitree.errors import LumitreeError, shown

if TYPE_CHECKING:
    from lumitree.asset.asset import Asset
    from lumitree.fit.config import BakeConfig

# Options that are fields of the settings.
_FIELDS = ("time", "seed", "parts", "lumens", "temperature")
_SHOWN = {
    "geometry": "Images show the lamp's own geometry.",
    "field": "Images show the radiance field.",
    "light": "Images show the light field, blurred.",
}
_MAX_LIST_BYTES = 1 << 26
_HEAD = """# Settings of 'lumitree bake --config FILE'. Remove the # before a setting to change it.
# "..." stands for None: the setting has no value unless it is given.

# Folder for the state, which is kept; it must be new, empty or that of an earlier call. Default:
# the name of ASSET with .work, removed at the end.
#work = ...

# Mitsuba variant. Default: "llvm_ad_rgb".
#variant = ...
"""


def add(commands: Any) -> None:
    parser = options.command(commands, "bake", "convert a luminaire into an asset", run, show)
    parser.add_argument(
        "luminaires",
        metavar="LUMINAIRE",
        nargs="*",
        help=options.LUMINAIRE + "; or the folder of a dataset, or a photometric file (.ies, .ldt, "
        ".gldf, .tm33, .ray, .tm25ray). Several are baked into a folder, NAME=LUMINAIRE under that "
        "name; @FILE stands for those that a text file lists, one a line",
    )
    options.add_reading(parser)
    parser.add_argument(
        "-o",
        dest="output",
        type=options.Output,
        metavar="ASSET|FOLDER/",
        help="the .lumitree file to write; for several luminaires, or with / at the end, a folder "
        "for the assets and an index page. The same command continues an interrupted bake",
    )
    parser.add_argument(
        "--method",
        choices=("octree", "network"),
        help="octree: from traced rays; network: by a network, as in the paper; needs "
        "the extra 'network'",
    )
    parser.add_argument(
        "--quality",
        choices=("preview", "standard", "high", "paper"),
        help="preview, standard (default) or high: 1, 2 or 16 million light paths, 5 to 30 s on 2 "
        "CPU cores; and, if one is made, a radiance field of depth 7 in 1 minute, of depth 8 in 5 "
        "minutes, or of depth 10 in 30 minutes. With --method network, preview (default): minutes "
        "on 2 CPU cores; paper: hours on a GPU",
    )
    # There are no defaults here, so that `run` can refuse options that do not apply.
    options.add_time(parser)
    options.add_seed(parser, default=None)
    parser.add_argument(
        "--parts",
        type=_parts,
        metavar="PARTS",
        help="what the asset gets, separated by commas. light: what the luminaire sends to its "
        "surroundings; geometry: the luminaire itself, which images show, in seconds, not for "
        "--method network; field: a radiance field, which images show in place of geometry, in "
        "minutes; all: these three (default: light and geometry; light and field where the "
        "geometry cannot be stored or the method is network)",
    )
    parser.add_argument(
        "--lumens",
        type=float,
        metavar="LM",
        help="luminous flux of the asset, lm, if lengths are in metres (default: that of the "
        "luminaire)",
    )
    parser.add_argument(
        "--temperature",
        type=float,
        metavar="K",
        help="colour temperature of the whole flux, 1000 to 20000 K; all colours get the same "
        "factors (default: the colours of the luminaire)",
    )
    options.add_executor(parser, "several luminaires, or the light paths of one,")
    parser.add_argument(
        "--config",
        metavar="FILE",
        help="TOML file of all other settings, such as tree_depth, l_max, law, rays, "
        "irradiance_paths, work and variant; options replace its values, and it replaces those of "
        "the quality",
    )
    parser.add_argument(
        "--write-config",
        metavar="FILE",
        nargs="?",
        const="-",
        help="write the settings of the quality, with comments, to FILE or to the terminal, and "
        "end",
    )
    parser.add_argument(
        "--task",
        type=_task,
        metavar="K/N",
        help="of several luminaires bake only those at positions K, K + N, K + 2 N and so on, "
        "counted from 1: one of N tasks of a farm; 'collect' then writes the index page",
    )


def _task(text: str) -> tuple[int, int]:
    number, sign, count = text.partition("/")
    if not (sign and number.isdecimal() and count.isdecimal() and 1 <= int(number) <= int(count)):
        raise argparse.ArgumentTypeError(
            f"{text!r} is not a task; write K/N, such as 1/4 for the first of four"
        )
    return int(number), int(count)


def _parts(text: str) -> tuple[str, ...]:
    from lumitree.asset.asset import PARTS

    return PARTS if text == "all" else tuple(text.split(","))


def run(args: argparse.Namespace) -> Any:
    import lumitree
    from lumitree.fit.config import chosen_config

    if args.write_config is not None:
        return _write_config(args)
    if not args.luminaires or args.output is None:
        what = "-o" if args.luminaires else "LUMINAIRE"
        raise LumitreeError(
            f"the following arguments are required: {what}; see 'lumitree bake --help'"
        )
    settings = {name: getattr(args, name) for name in _FIELDS}
    config, work, variant = _file(args)
    if config is None:
        settings |= {"quality": args.quality, "method": args.method}
    luminaires = [_luminaire(args, name) for name in _listed(args.luminaires)]
    if len(luminaires) != 1 or args.output.endswith(("/", os.sep)):
        if args.output.endswith(".lumitree"):
            raise LumitreeError(
                f"{shown(args.output, 300)} is the name of one asset, but there are "
                f"{len(luminaires)} luminaires; give a folder"
            )
        if work is not None:
            raise LumitreeError("work: for one luminaire at a time; leave it out")
        with options.executor(args) as executor:
            return lumitree.bake_many(
                luminaires,
                args.output,
                chosen_config(config, **settings),
                executor=executor,
                task=args.task,
                variant=variant,
            )
    if args.task is not None:
        raise LumitreeError(
            "--task: for several luminaires; leave it out, or give a folder with / at its end "
            "after -o"
        )
    (luminaire,) = luminaires
    if luminaire.title is not None:
        raise LumitreeError(
            f"{shown(luminaire.title, 60)}=: for several luminaires; leave it out, or give a "
            "folder with / at its end after -o"
        )
    with options.executor(args) as executor:
        return lumitree.bake(
            luminaire,
            args.output,
            config,
            **settings,
            work=work,
            variant=variant,
            executor=executor,
        )


def show(args: argparse.Namespace, result: Any) -> None:
    import lumitree

    if isinstance(result, dict):
        if args.write_config == "-":
            sys.stdout.write(result["config"])
        else:
            print_open(args.write_config)
    elif isinstance(result, lumitree.BakeManyResult):
        print_lamps(result.lamps)
        print_open(result.index if args.task is None else result.folder)
    else:
        print_report(result.to_json())
        print(_shown(result.asset))
        print_open(result.path)


def _shown(asset: "Asset") -> str:
    """Part of an asset that images show, and the part that it lacks for more."""
    appearance = asset.info.appearance
    line = _SHOWN[appearance]
    if appearance == "geometry" and asset.num_leaves == 0:
        line += " Other integrators than lumitree_path need a radiance field: --parts all adds it."
    # A photometric file has no light paths, and no geometry to add.
    if appearance == "light" and asset.info.light_field_paths is not None:
        line += " --parts light,geometry adds what sharp ones need."
    return line


def _file(args: argparse.Namespace) -> "tuple[BakeConfig | None, str | None, str | None]":
    """Settings, work folder and variant of the file of `--config`."""
    if args.config is None:
        return None, None, None
    from lumitree.cli.config_file import read_config
    from lumitree.core.toml_table import read_toml, text
    from lumitree.fit.config import BakeConfig

    table = read_toml(Path(args.config), "a TOML file of settings")
    work, variant = table.take("work", text), table.take("variant", text)
    config, _ = read_config(table, BakeConfig.of(args.quality, args.method or "octree"))
    table.finish()
    return config, work, variant


def _luminaire(args: argparse.Namespace, text: str) -> Any:
    """The `LuminaireSource` of LUMINAIRE or NAME=LUMINAIRE; a file may have such a name."""
    title, equals, name = text.partition("=")
    if not (title and equals and name) or os.path.exists(text) or os.path.basename(title) != title:
        return options.luminaire(args, text)
    return dataclasses.replace(options.luminaire(args, name), title=title)


def _listed(names: list[str]) -> list[str]:
    """The names, with those that the file of a name @FILE lists in its place."""
    from lumitree.core.file_kinds import in_utf8
    from lumitree.core.reading import read_bytes

    found: list[str] = []
    for name in names:
        if not name.startswith("@"):
            found += _expanded(name)
            continue
        content = in_utf8(read_bytes(name[1:], "a list of luminaires", _MAX_LIST_BYTES))
        try:
            text = os.fsdecode(content)
        except UnicodeDecodeError:
            raise LumitreeError(
                f"{shown(name[1:], 300)} is not in UTF-8; save the list of luminaires in UTF-8"
            ) from None
        found += [line.strip() for line in text.split("\n") if line.strip()]
    return found


def _expanded(name: str) -> list[str]:
    """The files of a pattern such as *.ies, where the shell leaves patterns to the program."""
    if os.name != "nt" or not glob.has_magic(name) or os.path.exists(name):
        return [name]
    return sorted(glob.glob(name)) or [name]


def _write_config(args: argparse.Namespace) -> dict[str, str]:
    """Write the settings of a quality; returns the text, or the path of the file."""
    from lumitree.cli.config_file import config_text
    from lumitree.core.files import write_bytes
    from lumitree.fit.config import BakeConfig

    content = _HEAD + config_text(BakeConfig.of(args.quality, args.method or "octree"))
    if args.write_config == "-":
        return {"config": content}
    write_bytes(args.write_config, content.encode())
    return {"config": args.write_config}
