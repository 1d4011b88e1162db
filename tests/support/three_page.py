"""A page with three.js, for a browser."""

import base64
import json


def three_page(packages):
    """A page with three.js and its loader of glTF, as modules without a server."""
    root = packages / "three"
    files = {
        "three-core": root / "build" / "three.core.js",
        "three": root / "build" / "three.module.js",
        "buffers": root / "examples" / "jsm" / "utils" / "BufferGeometryUtils.js",
        "skeletons": root / "examples" / "jsm" / "utils" / "SkeletonUtils.js",
        "loader": root / "examples" / "jsm" / "loaders" / "GLTFLoader.js",
    }
    relative = {
        "./three.core.js": "three-core",
        "../utils/BufferGeometryUtils.js": "buffers",
        "../utils/SkeletonUtils.js": "skeletons",
    }
    imports = {}
    for name, path in files.items():
        text = path.read_text(encoding="utf-8")
        for given, wanted in relative.items():
            text = text.replace(f"'{given}'", f"'{wanted}'")
        coded = base64.b64encode(text.encode()).decode()
        imports[name] = f"data:text/javascript;base64,{coded}"
    table = json.dumps({"imports": imports})
    return f'<html><head><script type="importmap">{table}</script></head><body></body></html>'
