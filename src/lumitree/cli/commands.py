"""The commands: each is a public function, with what differs on a command line.

`Command.run` gets the arguments that were given. Without one, the function is called with them.
`Command.show` prints the result.
"""

import contextlib
import dataclasses
import glob
import json
import math
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Group, Parameter

from lumitree.cli.output import (
    check_outputs,
    image_report,
    print_design,
    print_exported,
    print_illuminance,
    print_lamps,
    print_list,
    print_metrics,
    print_open,
    print_photograph,
    print_photometry,
    print_preview,
    print_report,
    print_result,
)
from lumitree.cli.signatures import (
    NEEDED,
    TEXT,
    TEXTS,
    Option,
    convert,
    described,
    each_text,
    lamps,
    one,
    options_of,
    value_of,
    vector,
)
from lumitree.errors import LumitreeError, shown

if TYPE_CHECKING:
    from lumitree.asset.asset import Asset
    from lumitree.lamp.source import LuminaireSource
    from lumitree.measure.design import DesignResult
    from lumitree.measure.evaluate import EvaluateResult
    from lumitree.measure.illuminance import IlluminanceResult
    from lumitree.rendering.placement import Placement
    from lumitree.rendering.render import RenderResult
    from lumitree.viewer.view import ViewResult

Given = dict[str, Any]
_MAX_LIST_BYTES = 1 << 26
# Interval at which a server looks whether it is to end, s.
_LOOK_SECONDS = 0.2


@dataclasses.dataclass(frozen=True)
class Command:
    """A command of the program.

    Attributes:
        function: name of the public function, or `demo`, whose options it has; empty for none.
        run: called with the arguments; returns a `Result`, or a dictionary for `--json`. All files
            are written when it returns. Default: the function.
        show: prints the result; called with it and the arguments. Default: prints its figures, and
            its attribute `opens` as the file to open.
        options: further options, and those that differ from the parameters of the function.
        text: first sentence of the help. Default: of the docstring of the function.
        opens: see `show`.
        exclusive: two options only one of which can be given.
    """

    function: str = ""
    run: Callable[[Given], Any] | None = None
    show: Callable[[Any, Given], None] | None = None
    options: Callable[[], Mapping[str, Option]] = dict
    text: str = ""
    opens: str = ""
    exclusive: tuple[str, str] = ("workers", "scheduler")

    def help(self) -> tuple[str, str]:
        """First sentence and further text of the help."""
        summary, text = described(self.function) if self.function else (self.text, "")
        return self.text or summary, text

    def all_options(self) -> dict[str, Option]:
        """All options, by name."""
        found = options_of(self.function) if self.function else {}
        if found.keys() & {"luminaire", "source", "target"}:
            found |= _READING
        if self.function in ("bake", "capture", "render"):
            found |= _WORKERS
        return found | dict(self.options()) | {"json": _JSON}

    def __call__(self, given: Given) -> Any:
        if given.keys() >= {*self.exclusive}:
            raise LumitreeError(f"--{' and --'.join(self.exclusive)} are given; give one of them")
        return call(self.function, given) if self.run is None else self.run(given)

    def print(self, result: Any, given: Given) -> None:
        """Print the result."""
        if self.show is not None:
            self.show(result, given)
        else:
            print_result(result, getattr(result, self.opens) if self.opens else None)


def _file(help: str, alias: str | tuple[str, ...] = (), default: object = None) -> Option:
    return Option(Annotated[Path | None, Parameter(converter=one(str), alias=alias)], help, default)


_JSON = _file("Also write the results as JSON to this file.")
_READING = {
    "materials": _file(
        "TOML file that overrides materials, unit and up axis of a model. Default: the .toml file "
        "with the name of the model, if there is one."
    ),
    "keep": Option(
        TEXTS,
        "Take only the shapes (.xml, by id, by the id of the BSDF, or by number such as #3) or "
        "parts (models, by name or material) that match the pattern, with * and ?; may be "
        "repeated. 'preview' lists them.",
    ),
    "drop": Option(
        TEXTS, "Leave the shapes or parts that match the pattern away; may be repeated."
    ),
}
# Options that may be given several times for one lamp.
_REPEATED = ("keep", "drop")
_WORKERS = {
    "workers": Option(int, "Number of processes that share the work. Default: this one."),
    "scheduler": Option(
        TEXT,
        "Address of a Dask scheduler whose workers share the work, such as "
        "tcp://192.168.0.2:8786 (`pip install 'lumitree[cluster]'`).",
    ),
}


def call(function: str, given: Given, *positional: Any) -> Any:
    """Call a public function with arguments of a command line."""
    import lumitree
    from lumitree.core.executor import dask_executor, process_pool
    from lumitree.lamp.source import LuminaireSource

    given = dict(given)
    given.pop("json", None)
    reading = {name: given.pop(name) for name in _READING if name in given}
    for name in ("source", "luminaire", "target"):
        if name in given and isinstance(given[name], str):
            given[name] = LuminaireSource(given[name], **reading)
    with contextlib.ExitStack() as stack:
        if (count := given.pop("workers", None)) is not None:
            given["executor"] = stack.enter_context(process_pool(count))
        if (address := given.pop("scheduler", None)) is not None:
            given["executor"] = stack.enter_context(dask_executor(address))
        return getattr(lumitree, function)(*positional, **given)


# Options that begin a group: `--at` belongs to the `--place` before it. A group is an object of a
# public dataclass; the option that begins it is one of the fields.
GROUPS = {
    "place": ("Placement", "source"),
    "plane": ("Plane", "centre"),
    "surface": ("Surface", "shape"),
}
# Groups of commands; their planes are of another class in `design`.
_GROUPS_OF = {
    "render": ("place",),
    "illuminance": ("place", "plane", "surface"),
    "design": ("place", "plane"),
}


def _kind(command: str, begin: str) -> tuple[str, str]:
    """The class of a group, and the field whose option begins it."""
    kind, first = GROUPS[begin]
    return ("TaskPlane" if (command, begin) == ("design", "plane") else kind), first


def group_options(command: str, begin: str) -> dict[str, Option]:
    """The option that begins a group, and the options for the other fields, for the help."""
    kind, first = _kind(command, begin)
    group = Parameter(group=Group(f"For each --{begin}"))
    found = {
        name: dataclasses.replace(each, type=Annotated[each.type, group], default=None)
        for name, each in options_of(kind).items()
    }
    begins = Parameter(converter=each_text, completer=lamps if begin == "place" else None)
    option = Option(Annotated[list[Path], begins, group], found.pop(first).help)
    if begin == "place":
        found |= {
            name: dataclasses.replace(each, type=Annotated[each.type, group])
            for name, each in _READING.items()
        }
    return {begin: option, **found}


def join_groups(command: str, arguments: Sequence[str]) -> list[str]:
    """Arguments with each group as one: `--place a --at 1,2,3` is `--place '{"source": "a", ...}'`.

    cyclopts has no options that depend on their order.
    """
    groups = _GROUPS_OF.get(command, ())
    kinds = {begin: _kind(command, begin) for begin in groups}
    fields = {begin: options_of(kind).keys() - {first} for begin, (kind, first) in kinds.items()}
    if "place" in fields:
        fields["place"] |= _READING.keys()
    joined: list[str | Given] = []
    # The group to which an option belongs that comes now.
    latest: dict[str, Given] = {}
    rest = iter(arguments)
    for argument in rest:
        name, equals, value = argument.removeprefix("--").partition("=")
        owners = [f"--{begin}" for begin in groups if name in fields[begin]]
        if not argument.startswith("--") or not (owners or name in groups):
            joined.append(argument)
            continue
        value = value_of(f"--{name}", value if equals else next(rest, ""))
        if name in groups:
            group = {GROUPS[name][1]: value}
            joined += [f"--{name}", group]
            latest |= dict.fromkeys(fields[name], group)
        elif name not in latest:
            raise LumitreeError(f"--{name} comes before any {' or '.join(owners)}")
        elif name in _REPEATED:
            latest[name].setdefault(name, []).append(value)
        elif name in latest[name]:
            first = next(iter(latest[name].values()))
            raise LumitreeError(f"--{name} is given twice for {shown(first)}")
        else:
            latest[name][name] = value
    return [each if isinstance(each, str) else json.dumps(each) for each in joined]


def _grouped(command: str, begin: str, given: Given) -> list[Any]:
    """The objects of the groups of one kind, which it takes from the arguments."""
    import lumitree
    from lumitree.lamp.source import LuminaireSource

    (kind, first), found = _kind(command, begin), []
    for text in given.pop(begin, ()):
        values = json.loads(text)
        reading = {
            name: values.pop(name) for name in _READING if begin == "place" and name in values
        }
        values = {
            name: convert(name, options_of(kind)[name], value) for name, value in values.items()
        }
        if reading:
            values[first] = LuminaireSource(values[first], **reading)
        found.append(getattr(lumitree, kind)(**values))
    return found


def _places(given: Given) -> "list[Placement]":
    """The placements of `--placements` and `--place`, which it takes from the arguments."""
    import lumitree

    file = given.pop("placements", None)
    return (lumitree.read_placements(file) if file else []) + _grouped("", "place", given)


# Arguments of `bake` that are settings.
_SETTINGS = (
    "config",
    "quality",
    "method",
    "parts",
    "time",
    "rays",
    "lumens",
    "temperature",
    "seed",
)


def _bake(given: Given) -> Any:
    from lumitree.cli.config_file import read_config, write_config
    from lumitree.fit.config import chosen_config, refuse_unused

    given = dict(given)
    names = given.pop("source", ())
    if (written := given.get("write_config")) is not None:
        further = given.keys() - {"write_config", "quality", "method", "output", "json"}
        if further:
            raise LumitreeError(
                f"{', '.join(sorted(further))}: not written by --write-config; leave it out"
            )
        return write_config(written, given.get("quality"), given.get("method"))
    output = given.get("output")
    if not names or output is None:
        missing = "--output" if names else "SOURCE"
        raise LumitreeError(f"{missing} is needed; see 'lumitree bake --help'")
    task, keys = given.pop("task", None), []
    if (file := given.pop("config", None)) is not None:
        chosen = {name: given.pop(name) for name in ("quality", "method") if name in given}
        given["config"], further, keys = read_config(file, **chosen)
        given, keys = further | given, [*chosen, *keys]
    reading = {name: given.pop(name) for name in _READING if name in given}
    sources = [_titled(name, reading) for name in listed(names)]
    config = chosen_config(**{name: given[name] for name in _SETTINGS if name in given})
    if len(sources) == 1 and not output.endswith(("/", os.sep)):
        (source,) = sources
        for extra, name in ((task, "--task"), (source.title, f"{shown(source.title)}=")):
            if extra is not None:
                raise LumitreeError(
                    f"{name}: for several luminaires; leave it out, or give a folder with / at its "
                    "end after -o"
                )
        refuse_unused([*keys, *given], config, sources)
        return call("bake", given, source)
    if output.endswith(".lumitree"):
        raise LumitreeError(
            f"{shown(output, 300)} is the name of one asset, but there are {len(sources)} "
            "luminaires; give a folder"
        )
    if "work" in given:
        raise LumitreeError("work: for one luminaire at a time; leave it out")
    refuse_unused(keys, config, sources)
    del given["output"]
    return call("bake_many", given | {"task": task}, sources, output)


def _titled(text: str, reading: Given) -> "LuminaireSource":
    """The `LuminaireSource` of LUMINAIRE or NAME=LUMINAIRE; a file may have such a name."""
    from lumitree.lamp.source import LuminaireSource

    title, equals, name = text.partition("=")
    if not (title and equals and name) or os.path.exists(text) or os.path.basename(title) != title:
        return LuminaireSource(text, **reading)
    return LuminaireSource(name, **reading, title=title)


def listed(names: Iterable[str]) -> list[str]:
    """The names, with those that the file of a name @FILE lists in its place."""
    from lumitree.core.file_kinds import in_utf8
    from lumitree.core.reading import read_bytes

    found: list[str] = []
    for name in names:
        if not name.startswith("@"):
            # Where the shell leaves patterns such as *.ies to the program.
            expands = os.name == "nt" and glob.has_magic(name) and not os.path.exists(name)
            found += (sorted(glob.glob(name)) if expands else []) or [name]
            continue
        content = in_utf8(read_bytes(name[1:], "a list of luminaires", _MAX_LIST_BYTES))
        # Names of files may be bytes of any kind.
        text = content.decode("utf-8", "surrogateescape")
        found += [line.strip() for line in text.split("\n") if line.strip()]
    return found


def task(text: str) -> tuple[int, int]:
    """K and N of K/N."""
    number, sign, count = text.partition("/")
    if not (sign and number.isdecimal() and count.isdecimal() and 1 <= int(number) <= int(count)):
        raise LumitreeError(f"{text!r} is not a task; write K/N, such as 1/4 for the first of four")
    return int(number), int(count)


def _show_bake(result: Any, given: Given) -> None:
    import lumitree

    if isinstance(result, dict):
        print_open(None if result["config"] == "-" else result["config"])
    elif isinstance(result, lumitree.BakeManyResult):
        print_lamps(result.lamps)
        print_open(result.index if "task" not in given else result.folder)
    else:
        print_report(result.to_json())
        print(_shown_part(result.asset))
        print_open(result.path)


def _shown_part(asset: "Asset") -> str:
    """Part of an asset that images show, and the part that it lacks for more."""
    info = asset.info
    if info.appearance == "field":
        return "Images show the radiance field."
    if info.appearance == "geometry":
        line = "Images show the geometry of the lamp."
        more = " Other integrators than lumitree_path need a radiance field: --parts all adds it."
        return line if asset.num_leaves else line + more
    if asset.light_field is not None and asset.light_field.outline is not None:
        return "Images show the luminous opening, evenly bright."
    line = "Images show the light field, blurred."
    # Files have no light paths, and no geometry to add.
    more = " --parts light,geometry adds what sharp ones need."
    return line if info.light_field_paths is None else line + more


def _evaluate(given: Given) -> "EvaluateResult":
    asset = os.fspath(given["asset"])
    return call("evaluate", {"output": f"{Path(asset).with_suffix('')}-evaluation.png"} | given)


def _show_evaluation(result: "EvaluateResult", _: Given) -> None:
    print_metrics(result.to_json())
    print_open(result.sheet or result.irradiance_sheet)


def _render(given: Given) -> Given:
    from lumitree.core.arguments import check_sheet_output
    from lumitree.core.backend import load_rgb
    from lumitree.rendering.render_job import forget_passes

    given = dict(given)
    output, places = given.pop("output"), _places(given)
    files = {name: given.pop(name, None) for name in ("layers", "aov", "luminance")}
    check_outputs(output, files["layers"], files["aov"])
    if files["luminance"] is not None:
        check_sheet_output(files["luminance"], "luminance image")
    glare = given.pop("glare", False)
    if glare:
        # For the illuminance at the camera.
        load_rgb(given.get("variant"))
    if given.pop("progressive", False):
        given["so_far"] = lambda image: image.save(output)
    for name in ("layers", "aov"):
        given[name] = files[name] is not None
    kept = {"work": given.get("work", f"{output}.work")}
    result = call("render", given | kept | {"placements": places})
    for name, path in files.items():
        if path is not None:
            getattr(result, f"save_{name}")(path)
    result.save(output)
    if "work" not in given:
        forget_passes(kept["work"])
    if glare:
        files["glare"] = _glare(given, places, result)
    layers = {"layers": sorted(result.layers) or None, "layers_file": files.pop("layers")}
    return image_report(result, output) | layers | files


def _glare(given: Given, places: "list[Placement]", result: "RenderResult") -> Given:
    """Glare of an image and of its lamps, with the illuminance at the camera."""
    import lumitree
    from lumitree.core.results import plain

    camera = result.camera
    if camera is None:
        return plain(lumitree.glare(result, 0))
    options = {"unit": given.get("unit", "m"), "variant": given.get("variant")}
    eye = lumitree.illuminance(
        given["scene"], places, points=[camera.origin], normals=[camera.direction], **options
    )
    background = float(eye.total[0] - eye.direct[0]) / math.pi
    lamps = lumitree.lamp_glare(
        places, camera.origin, camera.direction, background, up=camera.up, **options
    )
    of_image = lumitree.glare(result, float(eye.total[0]))
    return plain(of_image) | {"ugr_of_lamps": plain(lamps.ugr)}


def _show_image(result: Given, given: Given) -> None:
    print_photograph(result)
    print_open(given["output"])


def _illuminance(given: Given) -> "IlluminanceResult":
    from lumitree.measure.illuminance import check_illuminance_output
    from lumitree.measure.receivers import read_points

    given = dict(given)
    outputs = given.pop("output", ())
    for path in outputs:
        check_illuminance_output(path)
    given["placements"] = _places(given)
    for name in ("plane", "surface"):
        given[f"{name}s"] = _grouped("illuminance", name, given)
    if "points" in given:
        given["points"], given["normals"] = read_points(given["points"])
    result = call("illuminance", given)
    for path in outputs:
        result.save(path)
    return result


def _design(given: Given) -> "DesignResult":
    from lumitree.measure.design import OUTPUTS
    from lumitree.measure.illuminance import check_illuminance_output

    given = dict(given)
    outputs = given.pop("output", ())
    for path in outputs:
        check_illuminance_output(path, OUTPUTS)
    given["placements"] = _places(given)
    given["planes"] = _grouped("design", "plane", given)
    if "watts" in given:
        given["watts"] = _named("watts", given["watts"], vector(1))
    if "move" in given:
        axes = _named("move", given["move"], TEXT)
        given["move"] = {name: text.replace(",", "") for name, text in axes.items()}
    result = call("design", given)
    for path in outputs:
        result.save(path)
    return result


def _named(option: str, texts: Iterable[str], kind: object) -> dict[str, Any]:
    """Values by name, of texts NAME=VALUE."""
    found = {}
    for text in texts:
        name, equals, value = text.rpartition("=")
        if not equals or not name:
            raise LumitreeError(f"--{option}: {text!r} is not NAME=VALUE, such as lamp=0.5")
        if name in found:
            raise LumitreeError(f"--{option} is given twice for {shown(repr(name), 100)}")
        found[name] = convert(option, Option(kind, ""), value)
    return found


def _mix(given: Given) -> Given:
    given = dict(given)
    output = given.pop("output")
    check_outputs(output, page=True)
    gains = _named("gain", given.pop("gain", ()), vector(1, 3))
    result = call("mix", given | {"gain": gains})
    result.save(output)
    return image_report(result, output)


def _view(given: Given) -> "ViewResult":
    from lumitree.core.interruption import deferred_interrupt
    from lumitree.viewer.view import address, open_server

    given = dict(given)
    port = given.pop("port", 0)
    result = call("view", given)
    if result.page is not None:
        return result
    with (
        open_server(result.html, port) as server,
        deferred_interrupt("the page is no longer served") as stop,
    ):
        print(f"open {address(server)} in a browser; Ctrl-C ends", flush=True)
        server.timeout = _LOOK_SECONDS
        while not stop:
            server.handle_request()
    return result


def _info(given: Given) -> Given:
    import lumitree
    from lumitree.rendering.asset_cache import asset_report

    return {"asset": asset_report(lumitree.load(given["asset"]), given["asset"])}


def _list(_: Given) -> Given:
    import lumitree

    return {"luminaires": lumitree.builtin_luminaires()}


def _demo(given: Given) -> Given:
    from lumitree.demo import demo
    from lumitree.rendering.photograph import PhotoSettings

    settings = PhotoSettings(**{name: given[name] for name in _SHOWN if name in given})
    others = {name: given[name] for name in ("output", "full", "variant") if name in given}
    return demo(**others, settings=settings)


def _show_demo(result: Given, given: Given) -> None:
    if "evaluate" in result:
        print_metrics(result["evaluate"])
    else:
        print_report({"irradiance": result["bake"]["irradiance"]})
    print_report({name: result[name] for name in ("seconds", "peak_memory_bytes")})
    print(f"written: {', '.join(result['files'])}")
    print_open(Path(given.get("output", "demo-output")) / "comparison.png")


# Options of how a photograph is taken.
_SHOWN = ("exposure", "white_balance", "view", "bloom")
_IMAGE = _file("Image to write: .exr, linear radiance; or .png, as --view shows it.", "-o", NEEDED)


def _placements() -> Option:
    return _file(
        "TOML file with a table [lamps.NAME] for each lamp; its lamps come before the lamps of "
        "--place."
    )


def _needed(function: str, name: str = "output") -> dict[str, Option]:
    """An option that only Python has a default for: there the result is not lost without it."""
    option = options_of(function)[name]
    described = option.help.removesuffix(" Default: no file is written.")
    return {name: dataclasses.replace(option, help=described, default=NEEDED)}


COMMANDS: dict[str, Command] = {
    "list": Command("builtin_luminaires", _list, lambda result, _: print_list(result)),
    "preview": Command("preview", show=lambda result, _: print_preview(result)),
    "capture": Command("capture", opens="dataset"),
    "train": Command("train", opens="run"),
    "extract": Command("extract", opens="path", options=lambda: _needed("extract")),
    "bake": Command(
        "bake",
        _bake,
        _show_bake,
        lambda: {
            "source": Option(
                Annotated[Path, Parameter(converter=one(str), completer=lamps)],
                f"{options_of('bake')['source'].help} Several are baked into a "
                "folder, NAME=LUMINAIRE under that name; @FILE stands for the luminaires that a "
                "text file lists, one a line.",
                (),
                positional=True,
                several=True,
            ),
            "output": _file(
                "The .lumitree file to write; for several luminaires, or with / at its end, a "
                "folder for the assets and an index page. The same command continues an "
                "interrupted bake.",
                "-o",
            ),
            "config": _file(
                "TOML file of all settings, such as irradiance_paths or [octree] tree_depth; "
                "options replace its values, and it replaces the values of the quality."
            ),
            "write_config": Option(
                Annotated[str, Parameter(converter=one(str), allow_leading_hyphen=True)],
                "Write the settings of the quality, with comments, to this file, or with - to the "
                "terminal, and end.",
            ),
            "task": Option(
                Annotated[str | None, Parameter(converter=one(task))],
                "K/N: of several luminaires bake only those at positions K, K + N, K + 2 N and so "
                "on, counted from 1; 'collect' then writes the index page.",
                None,
            ),
        },
        text="Bake a luminaire, the views of a dataset or a photometric file into an asset.",
    ),
    "collect": Command("collect", show=_show_bake),
    "refine": Command("refine", opens="path", options=lambda: _needed("refine")),
    "mix": Command(
        "mix",
        _mix,
        _show_image,
        lambda: {
            "layers": dataclasses.replace(
                _file("A file of `render --layers`."), default=NEEDED, positional=True
            ),
            "gain": Option(
                TEXTS,
                "LAYER=R,G,B: factors on the red, green and blue light of a layer, or of all that "
                "match a pattern such as 'hall*', or one number for all; may be repeated.",
            ),
            "output": dataclasses.replace(
                _IMAGE,
                help="File to write: .exr, linear radiance; .png, as --view shows it; or .html, a "
                "web page with a dimmer for each layer, which begins as this image.",
            ),
        },
    ),
    "info": Command(
        "",
        _info,
        lambda result, _: print_report(result),
        lambda: {"asset": options_of("view")["asset"]},
        text="Describe an asset.",
    ),
    "evaluate": Command("evaluate", _evaluate, _show_evaluation),
    "photometry": Command("photometry", show=lambda result, _: print_photometry(result)),
    "illuminance": Command(
        "illuminance",
        _illuminance,
        lambda result, given: print_illuminance(result, given.get("output", ())),
        lambda: {
            "output": dataclasses.replace(
                options_of("photometry")["output"],
                help="File to write: .csv or .json (each point), .png (plan in false colours with "
                "isolux lines) or .pdf (plan and table); may be repeated.",
            ),
            "points": _file("Further points: a CSV file with the columns x, y, z, nx, ny, nz."),
            "placements": _placements(),
            **group_options("illuminance", "place"),
            **group_options("illuminance", "surface"),
            **group_options("illuminance", "plane"),
        },
    ),
    "design": Command(
        "design",
        _design,
        lambda result, given: print_design(result, given.get("output", ())),
        lambda: {
            "output": dataclasses.replace(
                options_of("photometry")["output"],
                help="File to write: .toml (placements with the dim levels), .png or .pdf (plans "
                "before and after) or .json (figures); may be repeated.",
            ),
            "group": Option(
                TEXTS,
                "Lamps whose names match the pattern, with * and ?, have one level; may be "
                "repeated.",
            ),
            "move": Option(
                TEXTS,
                "LAMP=AXES: lamps that match may move along these axes of the scene, such as x,z; "
                "may be repeated.",
            ),
            "turn": Option(TEXTS, "Lamps that match may turn; may be repeated."),
            "free": Option(TEXTS, "Lamps that match may move and turn; may be repeated."),
            "watts": Option(
                TEXTS,
                "LAMP=WATTS: electric power at level 1 of the lamps that match; may be repeated. "
                "The power is then minimised, and not the luminous flux.",
            ),
            "placements": _placements(),
            **group_options("design", "place"),
            **group_options("design", "plane"),
        },
    ),
    "render": Command(
        "render",
        _render,
        _show_image,
        lambda: {
            "output": _IMAGE,
            "placements": _placements(),
            **group_options("render", "place"),
            "progressive": Option(
                bool,
                "Write the image again and again while it is rendered, before denoising.",
                False,
            ),
            "layers": _file("Also write the light of each luminaire as a layer, .exr, for `mix`."),
            "aov": _file("Also write the image before denoising, albedo and normal, .exr."),
            "luminance": _file(
                "Also write the luminance in false colours, .png, with a legend in cd/m²."
            ),
            "glare": Option(
                bool,
                "Also compute the glare of the view: UGR of the image and of the lamps, and DGP "
                "for daylight.",
                False,
            ),
            "work": _file(
                "Folder for the passes so far, which is kept. Default: the name of the image "
                "followed by .work, removed at the end."
            ),
        },
    ),
    "view": Command(
        "view",
        _view,
        lambda result, _: print_open(result.page),
        lambda: {
            "output": _file(
                "HTML file to write, which needs no other file and no network. Default: the page "
                "is served on this computer until Ctrl-C.",
                "-o",
            ),
            "port": Option(int, "Port to serve on. Default: a free one.", 0),
        },
        exclusive=("output", "port"),
    ),
    "export": Command("export", show=lambda result, _: print_exported(result)),
    "blender-extension": Command("blender_extension", opens="file"),
    "demo": Command(
        "demo",
        _demo,
        _show_demo,
        lambda: {name: options_of("render")[name] for name in _SHOWN},
    ),
}
