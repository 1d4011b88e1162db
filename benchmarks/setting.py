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
    return {
        "commit": commit(),
        "device": processor(),
        "variant": mi.variant(),
        "lumitree": lumitree.__version__,
        "mitsuba": mi.__version__,
        "drjit": importlib.metadata.version("drjit"),
        "python": platform.python_version(),
        **details,
    }


def commit() -> str:
    """The commit that is checked out, "-dirty" where anything but results was changed since."""
    changed = git("status", "--porcelain", "--untracked-files=no", "--", ":/", ":!results")
    return git("describe", "--always") + ("-dirty" if changed else "")


def git(*command: str) -> str:
    """What git prints, run in this folder."""
    folder = str(Path(__file__).parent)
    run = subprocess.run(["git", "-C", folder, *command], capture_output=True, text=True)
    return run.stdout.strip()


def processor() -> str:
    """Model of the processor, and the cores this process may use."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.is_file() else []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return f"{models[0] if models else platform.machine()}, {os.cpu_count()} cores"
