"""The command line: arguments in, one job of `pipeline`, a few lines or a table out."""

import argparse
import importlib
import math
import os
import sys
import warnings
from collections.abc import Callable, Sequence
from typing import Any, NoReturn

from lumitree.core.backend import quieten
from lumitree.core.interrupt import Interrupted, interruptible
from lumitree.errors import LumitreeError, LumitreeWarning, shown

Report = dict[str, Any]
# Their values may begin with a minus sign, which argparse would take for an option.
_VECTOR_OPTIONS = ("--at", "--rotate")
DEBUG = "LUMITREE_DEBUG"
_LONGEST_LINE = 1000
_LUMINAIRE = "built-in name, Mitsuba 3 scene (.xml) or model (.obj, .gltf, .glb)"


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command.

    Returns:
        The exit status: 0; 1 for an error in lumitree; 2 for bad input; 128 and the signal's number
        where a signal ended it.
    """
    arguments = _join_vectors(list(sys.argv[1:] if argv is None else argv))
    if not arguments:
        arguments = ["--help"]
    quieten()
    with warnings.catch_warnings(), interruptible():
        warnings.showwarning = _show_warning
        warnings.simplefilter("always", LumitreeWarning)
        try:
            args = _parser().parse_args(arguments)
            _check_json_output(args.json)
            report = args.run(args)
            if args.json:
                from lumitree.core.files import write_json

                write_json(args.json, report)
            args.show(report)
            return 0
        except BrokenPipeError:
            # The reader of our output (a pager, head) has gone.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return 0
        except (Exception, KeyboardInterrupt) as error:
            return _explain(error)


def _check_json_output(path: str | None) -> None:
    """Refuse a file for results that could not be written at the end; makes no folder for it."""
    if path is None:
        return
    from lumitree.core.files import check_writable

    folder = os.path.dirname(path) or "."
    if not os.path.isdir(folder):
        raise LumitreeError(f"--json: no folder {shown(folder, 300)}; make it, or name another")
    check_writable(path)


def _explain(error: BaseException) -> int:
    """Print what went wrong in one line; returns the exit status."""
    interrupted = _interruption(error)
    if interrupted is not None:
        done = str(interrupted) or "the same command continues where that is possible"
        return _fail(f"interrupted; {done}", 128 + interrupted.number)
    if os.environ.get(DEBUG):
        raise error
    if isinstance(error, LumitreeError):
        return _fail(str(error), 2)
    reason = " ".join(str(error).split()) or "no details"
    return _fail(
        f"unexpected {type(error).__name__}: {reason} (set {DEBUG}=1 for the traceback)", 1
    )


def _interruption(error: BaseException | None) -> Interrupted | None:
    """The signal behind an error; Dr.Jit wraps what is raised while it traces a loop."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error if error is None or isinstance(error, Interrupted) else Interrupted()


def _show_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    print(f"lumitree: warning: {shown(message, _LONGEST_LINE)}", file=sys.stderr)


def _fail(message: str, status: int) -> int:
    print(f"lumitree: error: {shown(message, _LONGEST_LINE)}", file=sys.stderr)
    return status


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        raise LumitreeError(f"{message}; see '{self.prog} --help'")


class _Formatter(argparse.ArgumentDefaultsHelpFormatter):
    """Shows defaults, except of flags and of options whose help says what happens without."""

    def _get_help_string(self, action: argparse.Action) -> str | None:
        if action.default in (None, False):
            return action.help
        return super()._get_help_string(action)


class _Place(argparse.Action):
    """`--place` starts a placement; `--at`, `--size` and `--rotate` describe the latest one."""

    def __call__(self, parser, namespace, values, option_string=None):
        if self.dest == "place":
            namespace.place = [*(namespace.place or []), {"source": values}]
        elif not namespace.place:
            parser.error(f"{option_string} comes before any --place")
        elif self.dest in namespace.place[-1]:
            parser.error(f"{option_string} is given twice for {namespace.place[-1]['source']}")
        else:
            namespace.place[-1][self.dest] = values


def _vector(count: int) -> Callable[[str], tuple[float, ...]]:
    def parse(text: str) -> tuple[float, ...]:
        try:
            values = tuple(float(part) for part in text.split(","))
        except ValueError:
            values = ()
        if len(values) != count or not all(math.isfinite(value) for value in values):
            raise argparse.ArgumentTypeError(f"{text!r} is not {count} numbers separated by commas")
        return values

    return parse


def _join_vectors(arguments: list[str]) -> list[str]:
    joined: list[str] = []
    for argument in arguments:
        if joined and joined[-1] in _VECTOR_OPTIONS:
            joined[-1] += f"={argument}"
        else:
            joined.append(argument)
    return joined


def _job(name: str, **options: Callable[[argparse.Namespace], Any]) -> Callable[..., Report]:
    """Function of the parsed arguments that runs `pipeline.<name>` with the options' values."""

    def run(args: argparse.Namespace) -> Report:
        pipeline = importlib.import_module("lumitree.pipeline")
        return getattr(pipeline, name)(**{key: value(args) for key, value in options.items()})

    return run


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="lumitree",
        description="Bake a complex luminaire once; light Mitsuba 3 scenes with it ever after.",
        epilog="LUMINAIRE is a built-in name (see 'lumitree list'), a Mitsuba 3 scene (.xml), or a "
        "model (.obj, .gltf, .glb) with an optional .toml of the same name beside it; see "
        "docs/bring-your-own-lamp.md.",
    )
    from lumitree import __version__

    parser.add_argument("--version", action="version", version=f"lumitree {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND", parser_class=_Parser)
    for add in (
        _add_list,
        _add_preview,
        _add_capture,
        _add_train,
        _add_extract,
        _add_bake,
        _add_refine,
        _add_info,
        _add_evaluate,
        _add_render,
        _add_demo,
    ):
        add(commands)
    return parser


def _command(
    commands: Any, name: str, text: str, run: Callable[..., Report], show: Callable[[Report], None]
) -> argparse.ArgumentParser:
    parser = commands.add_parser(
        name,
        help=text,
        description=text[0].upper() + text[1:] + ".",
        formatter_class=_Formatter,
    )
    parser.add_argument(
        "--json",
        metavar="FILE",
        help="also write the results as JSON to FILE",
    )
    parser.set_defaults(run=run, show=show)
    return parser


def _add_variant(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--variant",
        metavar="NAME",
        help="Mitsuba variant (default: cuda_ad_rgb where there is a GPU, else llvm_ad_rgb)",
    )


def _add_source_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--materials",
        metavar="FILE",
        help="TOML overrides of a model's materials, unit and up axis (default: the .toml beside "
        "the model, if there is one)",
    )
    parser.add_argument(
        "--keep",
        metavar="PATTERN",
        action="append",
        help="take only the shapes (.xml, by id) or parts (models, by part or material) whose name "
        "matches, with * and ?; may be repeated",
    )
    parser.add_argument(
        "--drop",
        metavar="PATTERN",
        action="append",
        help="leave out what matches; may be repeated",
    )


def _source(args: argparse.Namespace, name: str) -> Any:
    from lumitree.luminaires.source import LuminaireSource

    return LuminaireSource(name, args.materials, tuple(args.keep or ()), tuple(args.drop or ()))


def _add_output(parser: argparse.ArgumentParser, metavar: str, text: str) -> None:
    parser.add_argument("-o", dest="output", metavar=metavar, required=True, help=text)


def _add_list(commands: Any) -> None:
    _command(
        commands,
        "list",
        "list the built-in luminaires",
        _job("list_luminaires"),
        _show_luminaires,
    )


def _add_preview(commands: Any) -> None:
    parser = _command(
        commands,
        "preview",
        "look at a luminaire from six sides, and print its figures",
        _job(
            "preview",
            source=lambda a: _source(a, a.luminaire),
            sheet=lambda a: a.output,
            resolution=lambda a: a.resolution,
            samples_per_pixel=lambda a: a.spp,
            bounces=lambda a: a.bounces,
            variant=lambda a: a.variant,
        ),
        _show_preview,
    )
    parser.add_argument("luminaire", metavar="LUMINAIRE", help=_LUMINAIRE)
    _add_source_options(parser)
    _add_output(parser, "SHEET", "contact sheet (.png)")
    _add_picture_options(parser, 256, 64)
    parser.add_argument(
        "--bounces",
        action="store_true",
        help="also measure what paths of 32, 64 and 128 bounces miss",
    )
    _add_variant(parser)


def _add_capture(commands: Any) -> None:
    parser = _command(
        commands,
        "capture",
        "render views of a luminaire: radiance and opacity",
        _job(
            "capture",
            source=lambda a: _source(a, a.luminaire),
            output=lambda a: a.output,
            num_views=lambda a: a.views,
            resolution=lambda a: a.resolution,
            samples_per_pixel=lambda a: a.spp,
            split=lambda a: a.split,
            variant=lambda a: a.variant,
        ),
        _show_results,
    )
    parser.add_argument("luminaire", metavar="LUMINAIRE", help=_LUMINAIRE)
    _add_source_options(parser)
    _add_output(parser, "DATASET", "folder for the views; run again to continue")
    parser.add_argument(
        "--split", choices=("train", "test"), default="train", help="which directions"
    )
    _add_view_options(parser, 100, 256, 128)
    _add_variant(parser)


def _add_view_options(
    parser: argparse.ArgumentParser, views: int, resolution: int, samples: int
) -> None:
    parser.add_argument("--views", type=int, metavar="N", default=views, help="number of views")
    _add_picture_options(parser, resolution, samples)


def _add_picture_options(parser: argparse.ArgumentParser, resolution: int, samples: int) -> None:
    parser.add_argument(
        "--resolution", type=int, metavar="R", default=resolution, help="pixels a side"
    )
    parser.add_argument("--spp", type=int, metavar="S", default=samples, help="paths a pixel")


def _add_train(commands: Any) -> None:
    parser = _command(
        commands,
        "train",
        "train the radiance-field network on a dataset",
        _job(
            "train",
            dataset=lambda a: a.dataset,
            output=lambda a: a.output,
            preset=lambda a: a.preset,
            resume=lambda a: a.resume,
        ),
        _show_results,
    )
    parser.add_argument("dataset", metavar="DATASET", help="folder made by 'lumitree capture'")
    _add_output(parser, "RUN", "folder for checkpoints and history")
    _add_preset(parser)
    parser.add_argument("--resume", action="store_true", help="continue an interrupted run")


def _add_preset(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--preset",
        choices=("preview", "paper"),
        default="preview",
        help="preview: minutes on 2 CPU cores; paper: the paper's settings, days on a GPU",
    )


def _add_extract(commands: Any) -> None:
    parser = _command(
        commands,
        "extract",
        "distil a trained network into an octree asset",
        _job(
            "extract",
            run=lambda a: a.folder,
            output=lambda a: a.output,
            tree_depth=lambda a: a.depth,
        ),
        _show_results,
    )
    parser.add_argument("folder", metavar="RUN", help="folder made by 'lumitree train'")
    _add_output(parser, "ASSET", "the .lumitree file")
    parser.add_argument(
        "--depth",
        type=int,
        metavar="D",
        default=8,
        help="octree levels, 1 to 10: 2^D cells across the luminaire",
    )


def _add_bake(commands: Any) -> None:
    parser = _command(commands, "bake", "turn a luminaire into an asset", _bake, _show_results)
    parser.add_argument(
        "luminaire", metavar="LUMINAIRE", help=_LUMINAIRE + "; or the folder of a dataset"
    )
    _add_source_options(parser)
    _add_output(parser, "ASSET", "the .lumitree file; run again to continue")
    parser.add_argument(
        "--method",
        choices=("direct", "nerf"),
        default="direct",
        help="direct: from traced rays, in minutes; nerf: the paper's pictures and network",
    )
    parser.add_argument(
        "--quality",
        choices=("preview", "standard", "high"),
        help="of direct, on 2 CPU cores: 1 minute and depth 7, 5 and 8 (standard), or 30 and 10",
    )
    _add_budget(parser)
    _add_preset(parser)
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
    # So that what is given can be told from what is not.
    parser.set_defaults(preset=None, seed=None)
    _add_work(parser)
    _add_variant(parser)


# Options of `bake` that the other method does not know.
_DIRECT_ONLY = ("quality", "time", "rays", "seed", "l_max", "law")
_NERF_ONLY = ("preset",)


def _refuse_unused(args: argparse.Namespace) -> None:
    unused = _NERF_ONLY if args.method == "direct" else _DIRECT_ONLY
    given = [name for name in unused if getattr(args, name) is not None]
    if given:
        names = ", ".join("--" + name.replace("_", "-") for name in given)
        raise LumitreeError(f"{names}: unknown to --method {args.method}; leave it out")


def _bake(args: argparse.Namespace) -> Report:
    from lumitree import pipeline

    _refuse_unused(args)
    source = _source(args, args.luminaire)
    common = {"tree_depth": args.depth, "work": args.work, "variant": args.variant}
    if args.method == "nerf":
        preset = args.preset or "preview"
        return pipeline.bake_network(source, args.output, preset=preset, **common)
    return pipeline.bake(
        source,
        args.output,
        quality=args.quality or "standard",
        seconds=args.time,
        rays=args.rays,
        l_max=args.l_max,
        law=args.law,
        seed=args.seed or 0,
        **common,
    )


def _add_budget(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--time",
        type=_duration,
        metavar="T",
        help="budget such as 90s, 5m or 1h (default: the quality's); a first estimate, of some 20 "
        "seconds, is always made where there is none",
    )
    parser.add_argument(
        "--rays", type=int, metavar="N", help="budget of refinement rays, besides or without --time"
    )
    parser.add_argument(
        "--seed",
        type=int,
        metavar="S",
        default=0,
        help="root seed of all random numbers, 0 to 2147483647; with --rays alone, equal seeds and "
        "settings give equal files on one machine",
    )


def _duration(text: str) -> float:
    """Seconds of a text such as 90, 90s, 5m or 1.5h."""
    factor = {"s": 1, "m": 60, "h": 3600}.get(text[-1:])
    try:
        value = float(text if factor is None else text[:-1]) * (factor or 1)
    except ValueError:
        value = -1.0
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text!r} is not a duration; write 90s, 5m or 1h")
    return value


def _add_work(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--work",
        metavar="DIR",
        help="keep intermediate results in DIR (default: removed at the end)",
    )


def _add_refine(commands: Any) -> None:
    parser = _command(
        commands,
        "refine",
        "improve an asset with rays traced through its luminaire",
        _job(
            "refine",
            path=lambda a: a.asset,
            source=lambda a: _source(a, a.luminaire),
            output=lambda a: a.output,
            seconds=lambda a: a.time,
            rays=lambda a: a.rays,
            seed=lambda a: a.seed,
            work=lambda a: a.work,
            variant=lambda a: a.variant,
        ),
        _show_results,
    )
    parser.add_argument("asset", metavar="ASSET", help="a .lumitree file, from either method")
    parser.add_argument("luminaire", metavar="LUMINAIRE", help=_LUMINAIRE)
    _add_source_options(parser)
    _add_output(parser, "ASSET", "the improved .lumitree file; run again to continue")
    _add_budget(parser)
    _add_work(parser)
    _add_variant(parser)


def _add_info(commands: Any) -> None:
    parser = _command(
        commands, "info", "describe an asset", _job("info", path=lambda a: a.asset), _show_results
    )
    parser.add_argument("asset", metavar="ASSET", help="a .lumitree file")


def _add_evaluate(commands: Any) -> None:
    parser = _command(
        commands,
        "evaluate",
        "compare an asset with held-out views of its luminaire",
        _job(
            "evaluate",
            path=lambda a: a.asset,
            target=lambda a: _source(a, a.target),
            sheet=lambda a: a.output,
            num_views=lambda a: a.views,
            resolution=lambda a: a.resolution,
            samples_per_pixel=lambda a: a.spp,
            variant=lambda a: a.variant,
        ),
        _show_evaluation,
    )
    parser.add_argument("asset", metavar="ASSET", help="a .lumitree file")
    parser.add_argument(
        "target",
        metavar="LUMINAIRE|DATASET",
        help="what to compare with; views of a LUMINAIRE are captured first",
    )
    _add_source_options(parser)
    parser.add_argument(
        "-o",
        dest="output",
        metavar="SHEET",
        help="contact sheet (default: ASSET's name with -evaluation.png)",
    )
    _add_view_options(parser, 8, 256, 256)
    _add_variant(parser)


def _add_render(commands: Any) -> None:
    parser = _command(
        commands,
        "render",
        "render a Mitsuba scene with luminaires placed in it",
        _render,
        _show_results,
    )
    parser.add_argument("scene", metavar="SCENE.xml", help="a Mitsuba 3 scene with a camera")
    _add_output(parser, "IMAGE", ".exr (linear) or .png (tone-mapped)")
    parser.add_argument(
        "--place",
        action=_Place,
        metavar="ASSET",
        help="a .lumitree file, or a LUMINAIRE for its explicit geometry; "
        "may be repeated, each with its own --at, --size and --rotate",
    )
    parser.add_argument(
        "--at",
        action=_Place,
        type=_vector(3),
        metavar="X,Y,Z",
        help="centre of its bounding box, scene units (default: its own)",
    )
    parser.add_argument(
        "--size",
        action=_Place,
        type=float,
        metavar="S",
        help="largest side of its bounding box, scene units (default: its own)",
    )
    parser.add_argument(
        "--rotate",
        action=_Place,
        type=_vector(4),
        metavar="AX,AY,AZ,DEG",
        help="turn about its centre: axis, degrees",
    )
    parser.add_argument("--spp", type=int, metavar="N", default=64, help="samples a pixel")
    parser.add_argument(
        "--width",
        type=int,
        metavar="W",
        help="image width in pixels (default: the scene's)",
    )
    parser.add_argument(
        "--proxy", choices=("box", "sphere"), default="box", help="surface that carries the field"
    )
    _add_variant(parser)


def _render(args: argparse.Namespace) -> Report:
    from lumitree import pipeline

    return pipeline.render(
        args.scene,
        args.output,
        args.place or [],
        samples_per_pixel=args.spp,
        width=args.width,
        proxy=args.proxy,
        variant=args.variant,
    )


def _add_demo(commands: Any) -> None:
    parser = _command(
        commands, "demo", "bake the built-in lamp and hang it in a room", _demo, _show_demo
    )
    parser.add_argument(
        "-o",
        dest="output",
        metavar="DIR",
        default="demo-output",
        help="folder for pictures, report and asset",
    )
    _add_variant(parser)


def _demo(args: argparse.Namespace) -> Report:
    from lumitree import demo

    return demo.run(args.output, args.variant)


def _print_lines(values: Report) -> None:
    for name, value in values.items():
        print(f"{name:>20}  {shown(value, _LONGEST_LINE)}")


def _show_results(report: Report) -> None:
    flat: Report = {}
    for name, value in report.items():
        if name == "seconds":
            flat |= {f"{stage} (s)": round(seconds, 1) for stage, seconds in value.items()}
        elif name.endswith("_bytes"):
            flat[name.removesuffix("_bytes").replace("_", " ")] = _megabytes(value)
        elif isinstance(value, dict):
            flat |= {
                key: _megabytes(item) if key.endswith("_bytes") else _rounded(item)
                for key, item in value.items()
            }
        else:
            flat[name.replace("_", " ")] = _rounded(value)
    _print_lines(flat)


def _megabytes(value: int) -> str:
    return f"{value / 1e6:.1f} MB"


def _rounded(value: Any) -> Any:
    if isinstance(value, float):
        return float(f"{value:.5g}")
    if isinstance(value, list):
        return ", ".join(str(_rounded(item)) for item in value)
    return value


def _show_luminaires(report: Report) -> None:
    for name, item in report["luminaires"].items():
        size = " x ".join(f"{side:.3g}" for side in item["size"])
        print(f"{name:>20}  {item['description']}")
        print(
            f"{'':>20}  {item['triangles']:,} triangles, {item['emitters']} emitters of up to "
            f"{item['emitted_radiance']:.4g} W/(m² sr), {size} m, "
            f"{'media' if item['has_media'] else 'no media'}"
        )


def _show_preview(report: Report) -> None:
    from lumitree.pipeline import describe_lumens

    flux = report["flux"]
    watts = ", ".join(f"{value:.4g}" for value in flux["watts"])
    errors = ", ".join(f"{value:.2g}" for value in flux["watts_error"])
    shown = {
        "luminaire": report["luminaire"],
        "triangles": f"{report['triangles']:,}",
        "emitters": report["emitters"],
        "L_max": f"{report['max_radiance']:.4g} W/(m² sr)",
        "size": " x ".join(f"{side:.4g}" for side in report["size"]),
        "media": "yes" if report["has_media"] else "no",
        "flux": f"{describe_lumens(flux)} (lengths taken as metres)",
        "flux R, G, B": f"{watts} ± {errors} W",
        "paths a second": f"{report['paths_per_second']:,.0f}",
    }
    for item in report.get("bounces", ()):
        name = f"beyond {item['path_depth']} bounces"
        shown[name] = f"{100 * item['share']:.2g} ± {100 * item['error']:.1g} % of the flux"
    _print_lines(shown | {"sheet": report["sheet"]})


def _show_evaluation(report: Report) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    name = shown(report["asset"]["luminaire"])
    # Text: a name may hold what rich takes for markup.
    table = Table(title=Text(f"{name}: {len(report['views'])} held-out views"))
    table.add_column("metric")
    table.add_column("mean", justify="right")
    for name, value in report["metrics"].items():
        table.add_row(name, f"{value:.4f}")
    Console().print(table)
    print(f"contact sheet: {shown(report['sheet'], _LONGEST_LINE)}")


def _show_demo(report: Report) -> None:
    _show_evaluation(report["evaluate"])
    gain = {
        key: report["evaluate"]["metrics"][f"psnr_{key}"]
        - report["evaluate"]["metrics"][f"psnr_{key}_black"]
        for key in ("linear", "mulaw")
    }
    print(f"gain over black: {gain['linear']:.1f} dB linear, {gain['mulaw']:.1f} dB mu-law")
    _show_results(
        {
            "asset": report["evaluate"]["asset"],
            "seconds": report["seconds"],
            "peak_memory_bytes": report["peak_memory_bytes"],
        }
    )
    print(f"written: {', '.join(report['files'])}")


if __name__ == "__main__":
    sys.exit(main())
