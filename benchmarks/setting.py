"""Where and with what a benchmark ran, for the tables it writes."""

import importlib.metadata
import os
import platform
import subprocess
from pathlib import Path

import lumitree
from lumitree.core.backend import load_mitsuba


def setting(**details: object) -> dict[str, object]:
    """Commit, device and versions, followed by the benchmark's own details."""
    mi = load_mitsuba()
    describe = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty"]
    return {
        "commit": subprocess.run(describe, capture_output=True, text=True).stdout.strip(),
        "device": processor(),
        "variant": mi.variant(),
        "lumitree": lumitree.__version__,
        "mitsuba": mi.__version__,
        "drjit": importlib.metadata.version("drjit"),
        "python": platform.python_version(),
        **details,
    }


def processor() -> str:
    """Model of the processor, and the cores this process may use."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.is_file() else []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return f"{models[0] if models else platform.machine()}, {os.cpu_count()} cores"
