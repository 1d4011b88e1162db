"""All parts, in order of worth: what is measured first if the time is short."""

import dataclasses
from typing import Any

from benchmarks.gpu_parts.comparisons import compare, shared_asset
from benchmarks.gpu_parts.learning import extract_octree, measure_paper, train_network
from benchmarks.gpu_parts.part import ROOT, Context, Part
from benchmarks.gpu_parts.sizes import Sizes
from benchmarks.gpu_parts.suite import run_tests
from lumitree.core.backend import CPU_VARIANT

# A room with a camera, and where the lamp hangs in it.
ROOM = ROOT / "examples" / "office.xml"
_LAMP_CENTRE, _LAMP_SIZE = ("-0.3", "1.9", "-0.4"), "0.6"


def all_parts(sizes: Sizes) -> list[Part]:
    """The parts; those of the tests as the sizes have them."""
    first, *others = (_tests(group, paths) for group, paths in sizes.tests.items())
    parts = [
        first,
        _compared("images", "Images of lamps", 180),
        _compared("irradiance", "Irradiance around lamps", 120),
        _compared("light field", "Bakes of light fields", 120),
        *others[:1],
        Part("devices", "Bakes and images", 180, 60, _devices),
        Part("query", "Queries of the radiance field", 90, 40, _query),
        Part("equal-error", "Time at equal error", 180, 90, _equal_error),
        _of_paper("step", "A step of the network", 120, 40, "step"),
        Part("training", "The network with the paper's settings", 240, 60, train_network),
        Part("extraction", "The octree of the network", 300, 60, extract_octree),
        Part("luminaires", "Captures", 120, 60, _luminaires),
        *others[1:],
        Part("devices-cpu", "The CPU's bakes and images beside them", 420, 120, _devices_of_cpu),
        _of_paper(
            "lamp-of-paper",
            "A lamp by the network, from views to errors",
            420,
            240,
            f"1-{sizes.network_lamp}-network",
        ),
    ]
    return [dataclasses.replace(part, seconds=sizes.patience * part.seconds) for part in parts]


def _compared(name: str, title: str, seconds: float) -> Part:
    file = name.replace(" ", "-")
    return Part(file, title, seconds, 60, lambda context: compare(context, name))


def _tests(group: str, paths: tuple[str, ...]) -> Part:
    title, parameters = f"Tests: {group}", {"paths": paths}
    name = f"tests-{group}"
    return Part(name, title, 180, 40, lambda context: run_tests(context, group), parameters)


def _of_paper(name: str, title: str, seconds: float, least: float, cell: str) -> Part:
    def measure(context: Context) -> dict[str, Any]:
        return measure_paper(context, cell)

    return Part(name, title, seconds, least, measure, {"cell": cell})


def _devices(context: Context, variant: str | None = None) -> dict[str, Any]:
    rays, width, spp = context.sizes.devices
    arguments = [context.sizes.lamps[0], "--rays", rays, "--width", width, "--spp", spp]
    return context.benchmark("devices", *arguments, variant=variant)


def _devices_of_cpu(context: Context) -> dict[str, Any]:
    """The file then has a row for each variant, on one machine."""
    return _devices(context, CPU_VARIANT)


def _query(context: Context) -> dict[str, Any]:
    rays, depth = context.sizes.query
    asset = shared_asset(context, context.sizes.lamps[0])
    return context.benchmark("query", asset, "--rays", rays, "--depth", depth)


def _luminaires(context: Context) -> dict[str, Any]:
    resolution, spp = context.sizes.luminaires
    lamps = context.sizes.lamps
    return context.benchmark("luminaires", *lamps, "--resolution", resolution, "--spp", spp)


def _equal_error(context: Context) -> dict[str, Any]:
    lamp = context.sizes.lamps[0]
    seconds, width = context.sizes.equal
    what = ["--luminaire", lamp, "--asset", shared_asset(context, lamp), "--room", ROOM]
    what += ["--at", *_LAMP_CENTRE, "--size", _LAMP_SIZE]
    cache = context.work / "equal-error"
    return context.benchmark(
        "equal_quality", *what, "--time", seconds, "--width", width, "--cache", cache
    )
