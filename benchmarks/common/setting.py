"""Where and with what a benchmark ran."""

import importlib.metadata
import os
import platform
import shlex
import subprocess
from collections.abc import Sequence
from pathlib import Path

import lumitree
from lumitree.core.backend import load_mitsuba


def setting(command: str, **details: object) -> dict[str, object]:
    """Command, commit, device and versions, followed by the benchmark's own details.

    Args:
        command: that repeats the run, see `command_line`.
        details: JSON values by name.
    """
    mi = load_mitsuba()
    return {
        "command": command,
        "commit": commit(),
        "device": processor(),
        "accelerator": gpu() if mi.variant().startswith("cuda") else "none",
        "variant": mi.variant(),
        "lumitree": lumitree.__version__,
        "mitsuba": mi.__version__,
        "drjit": importlib.metadata.version("drjit"),
        "jax": version("jax"),
        "python": platform.python_version(),
        **details,
    }


def version(package: str) -> str:
    """Version of a package that may not be installed."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"


def command_line(argv: Sequence[str]) -> str:
    """The command as a shell takes it, without the machine's folders.

    Absolute paths, and paths that leave the current folder, keep their last name only.
    """
    return "python -m benchmarks " + shlex.join(_portable(each) for each in argv)


def _portable(argument: str) -> str:
    option, sign, value = argument.rpartition("=")
    path = Path(value)
    outside = path.is_absolute() or os.pardir in path.parts
    return option + sign + (path.name if outside else value)


def commit() -> str:
    """The commit that is checked out, "-dirty" where anything but results was changed since.

    In a copy without its history, the value of LUMITREE_COMMIT, or "unknown".
    """
    found = git("describe", "--always")
    if not found:
        return os.environ.get("LUMITREE_COMMIT") or "unknown"
    changed = git("status", "--porcelain", "--untracked-files=no", "--", ":/", ":!results")
    return found + ("-dirty" if changed else "")


def git(*command: str) -> str:
    """Output of git, run in the folder of the benchmarks; empty where that fails."""
    folder = str(Path(__file__).parents[1])
    try:
        run = subprocess.run(["git", "-C", folder, *command], capture_output=True, text=True)
    except FileNotFoundError:
        return ""
    return run.stdout.strip()


def gpu() -> str:
    """Models of the NVIDIA GPUs."""
    return ", ".join(nvidia("name")) or "unknown"


def nvidia(*properties: str) -> list[str]:
    """Properties of each NVIDIA GPU, by their driver's tool; empty where there is none.

    Args:
        properties: as `nvidia-smi --help-query-gpu` lists them.
    """
    query = f"--query-gpu={','.join(properties)}"
    command = ["nvidia-smi", query, "--format=csv,noheader,nounits"]
    try:
        run = subprocess.run(command, capture_output=True, text=True, timeout=10)
    except (FileNotFoundError, subprocess.TimeoutExpired):
        return []
    return run.stdout.splitlines() if run.returncode == 0 else []


def processor() -> str:
    """Model of the processor, and the cores this process may use."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.is_file() else []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return f"{models[0] if models else platform.machine()}, {os.cpu_count()} cores"
