"""Settings that images state: the comment of a PNG or OpenEXR file."""

import json
from typing import Any

from lumitree.core.results import plain


def image_settings(command: str, **settings: Any) -> str:
    """JSON text for an image: the command, the version of lumitree, and settings.

    Args:
        command: what made the image, such as "render".
        settings: values by name, as for `plain`; those that are None are left out.
    """
    # Imported here, because the package itself imports this module.
    from lumitree._version import __version__

    given = {name: plain(value) for name, value in settings.items() if value is not None}
    return json.dumps({"lumitree": __version__, "command": command, **given}, ensure_ascii=False)
