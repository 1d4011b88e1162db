"""Radiance: conversion of photometric files, and illuminance at points.

Radiance has z up: (x, y, z) here is (x, -z, y) there. Its convention for the luminous efficacy is
179 lm/W, and its primaries have other luminances than sRGB's.
"""

import dataclasses
import importlib.util
import os
import resource
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lumitree.errors import LumitreeError

LUMENS_PER_WATT = 179.0
LUMA = (0.265074126, 0.670114631, 0.064811243)
# How far the samples of a part of a light source are from its centre, relative to its size.
_DIRECT = "-dj .9 -dt 0 -dc 1 -dp 0 -st 0"
# Largest parts of light sources over their distance: for direct light alone, and else.
_FINE, _COARSE = 0.02, 0.1
# No interpolation of indirect light. The limit of all reflections (-lr) has to be above the
# limit of diffuse ones.
_INDIRECT = "-aa 0 -as 0 -lw 1e-8 -u+"


@dataclasses.dataclass(frozen=True)
class TracedIlluminance:
    """Illuminance at points by `rtrace`.

    Attributes:
        lux: [N] illuminance, lx.
        error: [N] its standard error, by independent repetitions.
        cpu_seconds: of the process.
    """

    lux: NDArray[np.float64]
    error: NDArray[np.float64]
    cpu_seconds: float


class Radiance:
    """The programs of the package `pyradiance`, run in one folder.

    Args:
        folder: for the files of scenes; of its own.

    Raises:
        LumitreeError: `pyradiance` is not installed.
    """

    def __init__(self, folder: Path) -> None:
        spec = importlib.util.find_spec("pyradiance")
        if spec is None or spec.origin is None:
            raise LumitreeError(
                "Radiance is not installed; install it with `pip install 'lumitree[radiance]'`"
            )
        installed = Path(spec.origin).parent
        self._programs, self.folder = installed / "bin", folder
        path = os.pathsep.join([str(self._programs), os.environ.get("PATH", "")])
        library = os.pathsep.join([".", str(installed / "lib")])
        self._environment = {**os.environ, "PATH": path, "RAYPATH": library}

    def version(self) -> str:
        """As `rtrace` states it."""
        return self._run("rtrace", "-version").strip()

    def photometric_source(self, file: Path, at: ArrayLike) -> str:
        """Text of a light of an IES file whose luminous opening is centred at a point [3].

        The colour is white and the lamp depreciation factor 1, whatever lamp the file names. The
        opening is a surface that absorbs the light of others.
        """
        self._run("ies2rad", "-dm", "-t", "default", "-o", file.stem, os.path.abspath(file))
        return self.moved((self.folder / f"{file.stem}.rad").read_text(), at)

    def moved(self, text: str, at: ArrayLike) -> str:
        """Text of a scene that is moved from the origin to a point [3]."""
        x, y, z = _z_up(at)
        return self._run("xform", "-t", f"{x:.9g}", f"{y:.9g}", f"{z:.9g}", given=text)

    def illuminance(
        self,
        scene: str,
        points: ArrayLike,
        normals: ArrayLike,
        bounces: int,
        divisions: int = 256,
        repeats: int = 8,
    ) -> TracedIlluminance:
        """Illuminance at points of a scene.

        Args:
            scene: text of all its parts.
            points, normals: [N, 3], y up.
            bounces: largest number of diffuse reflections; 0 for light straight from the lamps.
            divisions: directions in which the indirect light of a point is sampled.
            repeats: independent estimates of each point, at least 2.
        """
        (self.folder / "scene.rad").write_text(scene)
        octree = self.folder / "scene.oct"
        octree.write_bytes(self._bytes("oconv", "scene.rad"))
        rays = np.concatenate([_z_up(points), _z_up(normals)], axis=1)
        lines = [" ".join(f"{each:.9g}" for each in ray) for ray in rays for _ in range(repeats)]
        parts = _COARSE if bounces else _FINE
        options = f"-h -I -ds {parts} {_DIRECT} -ab {bounces} -lr {bounces + 1} -ad {divisions}"
        start = resource.getrusage(resource.RUSAGE_CHILDREN)
        text = self._run(
            "rtrace",
            *options.split(),
            *_INDIRECT.split(),
            octree.name,
            given="\n".join(lines) + "\n",
        )
        end = resource.getrusage(resource.RUSAGE_CHILDREN)
        rgb = np.array(text.split(), np.float64).reshape(-1, repeats, 3)
        lux = LUMENS_PER_WATT * (rgb @ np.array(LUMA))
        return TracedIlluminance(
            lux.mean(axis=1),
            lux.std(axis=1, ddof=1) / np.sqrt(repeats),
            end.ru_utime + end.ru_stime - start.ru_utime - start.ru_stime,
        )

    def image(self, scene: str, camera: dict[str, Any], width: int, height: int) -> bytes:
        """Image (.hdr) of a scene by `rpict`, with three diffuse reflections.

        Args:
            scene: text of all its parts.
            camera: `origin`, `target`, y up, and `fov` (horizontal, degrees).
            width, height: pixels.
        """
        (self.folder / "scene.rad").write_text(scene)
        octree = self.folder / "scene.oct"
        octree.write_bytes(self._bytes("oconv", "scene.rad"))
        eye, target = (_z_up(camera[name]) for name in ("origin", "target"))
        angle = np.radians(camera["fov"])
        vertical = np.degrees(2 * np.arctan(np.tan(angle / 2) * height / width))
        place, direction = (" ".join(f"{each:.9g}" for each in v) for v in (eye, target - eye))
        view = f"-vtv -vp {place} -vd {direction} -vu 0 0 1 -vh {camera['fov']} -vv {vertical:.9g}"
        quality = "-ab 3 -ad 1024 -as 0 -aa .12 -ar 64 -dt 0 -ps 1"
        size = f"-x {width} -y {height} -pa 1"
        return self._bytes("rpict", *f"{view} {quality} {size}".split(), octree.name)

    def _run(self, program: str, *options: str, given: str = "") -> str:
        return self._bytes(program, *options, given=given).decode()

    def _bytes(self, program: str, *options: str, given: str = "") -> bytes:
        run = subprocess.run(
            [str(self._programs / program), *options],
            input=given.encode(),
            capture_output=True,
            cwd=self.folder,
            env=self._environment,
        )
        if run.returncode != 0:
            raise LumitreeError(f"{program} of Radiance failed: {run.stderr.decode()[-300:]}")
        return run.stdout


def _z_up(vectors: ArrayLike) -> NDArray[np.float64]:
    """Points or directions [..., 3] in the frame of Radiance."""
    x, y, z = np.moveaxis(np.asarray(vectors, np.float64), -1, 0)
    return np.stack([x, -z, y], axis=-1)
