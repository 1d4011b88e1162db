"""The small image of a lamp on the page of a folder."""

import io
import json
from typing import Any

from PIL import Image, features

from lumitree.asset.asset import Asset
from lumitree.core.image_settings import image_settings
from lumitree.core.images import encode_png

# Pixels per side, and paths per pixel. On a CPU these are two equal passes of `rendering.passes`:
# passes of two sizes would compile two kernels for each lamp, which takes as long as the bake of a
# small one.
_PIXELS, _SAMPLES = 192, 28
# A PNG file has up to 50 kB because of the noise, a WebP file of this quality 2 to 5 kB.
_QUALITY = 80
# Tag of EXIF: ImageDescription.
_DESCRIPTION = 0x010E


def thumbnail_kind() -> str:
    """Suffix of the files that `thumbnail` makes: "webp" where Pillow has it, else "png"."""
    return "webp" if features.check("webp") else "png"


def thumbnail(asset: Asset, settings: Any) -> bytes:
    """An image file of an asset, which states the settings of its bake."""
    from lumitree.rendering.studio import portrait

    pixels = portrait(asset, _PIXELS, _SAMPLES)
    described = image_settings("bake", lamp=asset.luminaire, settings=settings)
    if thumbnail_kind() == "png":
        return encode_png(pixels, described)
    image, stream, exif = Image.fromarray(pixels), io.BytesIO(), Image.Exif()
    # EXIF has ASCII characters only.
    exif[_DESCRIPTION] = json.dumps(json.loads(described))
    image.save(stream, format="WEBP", quality=_QUALITY, method=4, exif=exif)
    return stream.getvalue()
