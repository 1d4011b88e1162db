"""The light field of an unfinished bake, which the same bake does not trace again."""

import hashlib
import json
import warnings
from dataclasses import asdict
from pathlib import Path

from lumitree._version import __version__
from lumitree.asset.asset import light_field_asset
from lumitree.asset.file import load, save
from lumitree.asset.light_field import LightField
from lumitree.core.files import WriteError
from lumitree.errors import LumitreeError, LumitreeWarning
from lumitree.lamp.luminaire import Luminaire
from lumitree.trace.light_field_config import LightFieldConfig

LIGHT_FIELD_STATE = "light.lumitree"


class SavedLightField:
    """The asset file in a folder that holds the light field of one luminaire and one setting.

    In place of the luminaire's name it has a digest of the luminaire and of the setting.
    """

    def __init__(
        self, folder: Path, luminaire: Luminaire, config: LightFieldConfig, seed: int
    ) -> None:
        members = [__version__, luminaire.fingerprint, asdict(config), seed]
        record = json.dumps(members, sort_keys=True)
        self._digest = hashlib.sha256(record.encode()).hexdigest()
        self._path, self._frame = folder / LIGHT_FIELD_STATE, luminaire.frame

    def load(self) -> LightField | None:
        """The field; None if there is none, or it is another luminaire's or damaged."""
        if not self._path.exists():
            return None
        try:
            asset = load(self._path)
        except LumitreeError:
            return None
        field = asset.light_field
        if field is None or asset.luminaire != self._digest:
            return None
        return field

    def save(self, field: LightField) -> None:
        """Write the field; warns where it cannot be written, since the bake does not need it."""
        try:
            save(light_field_asset(field, self._frame, self._digest), self._path)
        except WriteError as error:
            warnings.warn(
                f"cannot save the light field in {self._path.parent}: {error.reason}; the "
                "bake goes on, and would trace it again if it were stopped",
                LumitreeWarning,
                stacklevel=2,
            )
