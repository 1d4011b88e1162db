"""Reads the lights of a lamp that was exported as a binary glTF file."""

import json
import struct
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from benchmarks.exported_files.lights import ReadLight
from lumitree.core.photometry import LUMA
from lumitree.errors import LumitreeError, shown
from lumitree.formats.ies import read_ies
from lumitree.formats.type_c import IntensityDistribution, y_up

_NUMPY = {5123: np.uint16, 5125: np.uint32, 5126: np.float32}
_COLUMNS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3}


class GltfFile:
    """The JSON object of a file, and the bytes of its views.

    Raises:
        LumitreeError: it is not a binary glTF 2.0 file of the length that it states.
    """

    def __init__(self, path: Path) -> None:
        content = path.read_bytes()
        magic, version, length = struct.unpack_from("<4sII", content)
        size, kind = struct.unpack_from("<I4s", content, 12)
        if (magic, version, length, kind) != (b"glTF", 2, len(content), b"JSON"):
            raise LumitreeError(f"{path} is not a binary glTF 2.0 file")
        self.json: dict[str, Any] = json.loads(content[20 : 20 + size])
        self._data = content[28 + size :]

    def view(self, index: int) -> bytes:
        """Bytes of a view."""
        view = self.json["bufferViews"][index]
        return self._data[view["byteOffset"] :][: view["byteLength"]]

    def array(self, index: int) -> NDArray[Any]:
        """Values [N, columns] of an accessor."""
        accessor = self.json["accessors"][index]
        found = np.frombuffer(self.view(accessor["bufferView"]), _NUMPY[accessor["componentType"]])
        return found.reshape(-1, _COLUMNS[accessor["type"]])

    def nodes(self, key: str) -> list[dict[str, Any]]:
        """Nodes that have an entry, in the order of the file."""
        return [each for each in self.json["nodes"] if key in each]

    def lights(self) -> Iterator[tuple[dict[str, Any], dict[str, Any], dict[str, Any]]]:
        """Node, punctual light and profile of each light."""
        extensions = self.json["extensions"]
        for node in self.nodes("extensions"):
            used = node["extensions"]
            point = extensions["KHR_lights_punctual"]["lights"][
                used["KHR_lights_punctual"]["light"]
            ]
            profile = extensions["EXT_lights_ies"]["lights"][used["EXT_lights_ies"]["light"]]
            yield node, point, profile

    def profile(self, profile: dict[str, Any]) -> IntensityDistribution:
        """Distribution of a profile of `lights`.

        Raises:
            LumitreeError: its content is of another type.
        """
        if profile["mimeType"] != "application/x-ies-lm-63":
            raise LumitreeError(f"a profile has the type {shown(profile['mimeType'])}")
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "profile.ies"
            path.write_bytes(self.view(profile["bufferView"]))
            return read_ies(path)


def read_lights(path: Path) -> list[ReadLight]:
    """The lights of a file by their profiles of `EXT_lights_ies`.

    γ is the angle from the node's -z, and C that from its +x towards its +y.
    """
    file = GltfFile(path)
    lights = []
    for node, _, profile in file.lights():
        used = node["extensions"]["EXT_lights_ies"]
        factor = used["multiplier"] * (np.array(used["color"]) @ LUMA)
        turn = Rotation.from_quat(node["rotation"]).as_matrix()
        found = file.profile(profile)
        lights.append(
            ReadLight(
                np.array(node["translation"]),
                lambda direction, turn=turn, found=found, factor=factor: (
                    factor * found.at(y_up(direction @ turn))
                ),
            )
        )
    return lights
