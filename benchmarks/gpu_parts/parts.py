"""All parts, in order of worth: what is measured first if the time is short."""

import dataclasses
import functools
from typing import Any

from benchmarks.gpu_parts import comparisons, learning, suite
from benchmarks.gpu_parts.part import Context, Part, show_tables
from benchmarks.gpu_parts.sizes import Sizes


def all_parts(sizes: Sizes) -> list[Part]:
    """The parts; the sizes determine the parts of tests."""
    first, *others = (
        Part(
            f"tests-{group}",
            f"Tests: {group}",
            180,
            functools.partial(suite.run_tests, paths=paths),
            suite.show,
        )
        for group, paths in sizes.tests.items()
    )
    parts = [
        first,
        _compared("images", "Images of lamps", 120),
        _compared("irradiance", "Irradiance around lamps", 90),
        _compared("light-field", "Bakes of light fields", 90),
        Part("illumination", "Costs of samples", 120, _illumination, show_tables),
        *others,
        Part(
            "network",
            "The network with the paper's settings",
            420,
            learning.learn,
            learning.show_learning,
        ),
    ]
    return [dataclasses.replace(part, seconds=sizes.patience * part.seconds) for part in parts]


def _compared(name: str, title: str, seconds: float) -> Part:
    measure = functools.partial(comparisons.compare, name=name)
    return Part(name, title, seconds, measure, comparisons.show)


def _illumination(context: Context) -> dict[str, Any]:
    width, spp = context.sizes.illumination
    arguments = [*context.sizes.lamps, "--width", width, "--spp", spp]
    return context.benchmark("illumination", *arguments)
