"""Make the pages of the gallery: `make gallery`, or `python docs/make_gallery.py`.

Each built-in lamp is baked with the quality of a preview. Its page, one HTML file of less than
4 MB, shows its geometry and loads nothing. `make docs` then copies the pages and links to them. A
second call bakes only what is missing.
"""

import dataclasses
import io
from pathlib import Path

from PIL import Image

import lumitree
from lumitree.core.files import write_bytes
from lumitree.lamp.builtin import BUILTIN

DOCS = Path(__file__).parent
BAKES = DOCS / "generated" / "lamps"
PAGES = DOCS / "generated" / "extra" / "gallery"
THUMBNAILS = DOCS / "images" / "gallery"
LARGEST_PAGE = 4_000_000
# Width of the images, and samples per pixel.
PIXELS, SAMPLES = 320, 128


def main() -> None:
    result = lumitree.bake_many(
        list(BUILTIN),
        BAKES,
        dataclasses.replace(lumitree.BakeConfig.of("preview"), irradiance_paths=0),
    )
    PAGES.mkdir(parents=True, exist_ok=True)
    THUMBNAILS.mkdir(parents=True, exist_ok=True)
    # Needs a variant of Mitsuba, which a bake chooses.
    from lumitree.rendering.studio import portrait

    for lamp in result.lamps:
        if lamp.path is None:
            raise SystemExit(f"{lamp.name}: {lamp.error or lamp.state}")
        page = lumitree.view(lamp.path, PAGES / f"{lamp.name}.html")
        if (size := page.page_bytes) > LARGEST_PAGE:
            raise SystemExit(f"{lamp.name}: {size:,} bytes; expected at most {LARGEST_PAGE:,}")
        stream = io.BytesIO()
        image = portrait(lumitree.load(lamp.path), PIXELS, SAMPLES).pixels
        Image.fromarray(image).save(stream, "JPEG", quality=85)
        write_bytes(THUMBNAILS / f"{lamp.name}.jpg", stream.getvalue())
        print(
            f"{lamp.name}: asset {lamp.path.stat().st_size / 1e6:.2f} MB, page {size / 1e6:.2f} MB"
        )


if __name__ == "__main__":
    main()
