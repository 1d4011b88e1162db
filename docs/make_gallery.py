"""Make the pages of the gallery: `make gallery`, or `python docs/make_gallery.py`.

Each built-in lamp is baked with few leaves, harmonics and cells, so that its asset has less than
2 MB. Its page is one HTML file, which loads nothing. `make docs` then copies the pages and links to
them. A second call bakes only what is missing.
"""

import dataclasses
import io
from pathlib import Path

from PIL import Image

import lumitree
from lumitree.core.files import write_bytes
from lumitree.lamp.builtin.registry import BUILTIN

DOCS = Path(__file__).parent
BAKES = DOCS / "generated" / "lamps"
PAGES = DOCS / "generated" / "extra" / "gallery"
THUMBNAILS = DOCS / "images" / "gallery"
LARGEST_ASSET = 2_000_000
# Cells of twice the side: the light of a field of a preview takes 1.0 to 1.5 MB.
LIGHT_FIELD = lumitree.LightFieldConfig(paths=1 << 21, depth=4)


def main() -> None:
    result = lumitree.bake_many(
        list(BUILTIN),
        BAKES,
        dataclasses.replace(
            lumitree.BakeConfig.preview(),
            tree_depth=6,
            l_max=1,
            parts=("light", "field"),
            irradiance_paths=0,
            light_field=LIGHT_FIELD,
        ),
    )
    PAGES.mkdir(parents=True, exist_ok=True)
    THUMBNAILS.mkdir(parents=True, exist_ok=True)
    for lamp in result.lamps:
        if lamp.path is None:
            raise SystemExit(f"{lamp.name}: {lamp.error or lamp.state}")
        if (size := lamp.path.stat().st_size) > LARGEST_ASSET:
            raise SystemExit(f"{lamp.name}: {size:,} bytes; expected at most {LARGEST_ASSET:,}")
        page = lumitree.view(lamp.path, PAGES / f"{lamp.name}.html")
        stream = io.BytesIO()
        with Image.open(BAKES / "index-files" / f"{lamp.name}.png") as image:
            image.convert("RGB").save(stream, "JPEG", quality=85)
        write_bytes(THUMBNAILS / f"{lamp.name}.jpg", stream.getvalue())
        print(f"{lamp.name}: asset {size / 1e6:.2f} MB, page {page.page_bytes / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
