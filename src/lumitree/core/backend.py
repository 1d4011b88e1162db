"""Mitsuba in this process: its libLLVM, its variant, one thread at a time; and optional packages.

Mitsuba's CPU variants compile kernels with libLLVM, and load it when `mitsuba` is first imported.
Debian's versions 14 to 16 abort the process on machines with AVX-512. On Linux x86-64 lumitree
therefore depends on a tested library (the package `karellen-llvm-core`), and passes its path to
Dr.Jit before that import. On other systems it passes the newest one where installers put them. A
value of DRJIT_LIBLLVM_PATH that the user has set is kept. No other module loads Mitsuba.

Calls of several threads wait for each other (`in_turn`): the state of Mitsuba belongs to a process,
and Dr.Jit traces the methods of all objects of the process, also of objects that another thread is
just creating, in any scene.
"""

import contextlib
import functools
import glob
import importlib
import importlib.util
import os
import re
import sys
import threading
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeVar, cast

from lumitree.errors import LumitreeError, LumitreeWarning, explained, shown

CPU_VARIANT = "llvm_ad_rgb"
GPU_VARIANT = "cuda_ad_rgb"
# Endings of the names of variants.
_RGB, _SPECTRAL = "_ad_rgb", "_ad_spectral"
# The AVX-512 back end of older versions cannot compile the `fminimum` that Dr.Jit emits.
MIN_LLVM = 17
# Where installers put libLLVM, by `sys.platform` (MACHINE: see `platform.machine`), and how it is
# installed there.
_LLVM_PLACES = {
    "darwin": (
        "/opt/homebrew/opt/llvm*/lib/libLLVM.dylib",
        "/usr/local/opt/llvm*/lib/libLLVM.dylib",
        "$CONDA_PREFIX/lib/libLLVM*.dylib",
    ),
    "linux": (
        "/usr/lib/MACHINE-linux-gnu/libLLVM*.so*",
        "/usr/lib/llvm-*/lib/libLLVM*.so*",
        "/usr/lib64/libLLVM*.so*",
        "$CONDA_PREFIX/lib/libLLVM*.so*",
    ),
    "win32": (
        r"%ProgramFiles%\LLVM\bin\LLVM-C.dll",
        r"%CONDA_PREFIX%\Library\bin\LLVM-C.dll",
    ),
}
_LLVM_INSTALLERS = {
    "darwin": " (brew install llvm)",
    "linux": f" (on Debian and Ubuntu: apt install libllvm{MIN_LLVM + 2})",
    "win32": " (winget install LLVM.LLVM)",
}
# The library of LLVM by its name; its major version, in this name or in its folder's name.
_LLVM_NAME = re.compile(r"libLLVM([-.]?\d[\d.]*)?\.(so|dylib)[\d.]*|LLVM-C\.dll", re.IGNORECASE)
_LLVM_VERSION = re.compile(r"libLLVM(?:-|\.so\.|\.)?(\d+)", re.IGNORECASE)
_LLVM_FOLDER = re.compile(r"[/\\]llvm[-@](\d+)[^/\\]*[/\\]", re.IGNORECASE)
# Whether `quieten` was called, and whether `warn_of_gpu` has warned.
_quiet = _warned_of_gpu = False
# Threads of CPU variants; None for as many as there are cores.
_threads: int | None = None


def num_cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def select_llvm() -> None:
    """Set the libLLVM that Dr.Jit loads, unless Dr.Jit is loaded or the user has set one."""
    if "drjit" in sys.modules or os.environ.get("DRJIT_LIBLLVM_PATH"):
        return
    found = _bundled_llvm() or _installed_llvm()
    if found is not None:
        os.environ["DRJIT_LIBLLVM_PATH"] = str(found)


def load_rgb(variant: str | None = None) -> Any:
    """As `load_mitsuba`, with an RGB variant: for all that traces lamps.

    Raises:
        LumitreeError: as for `load_mitsuba`, or the variant renders spectra.
    """
    return _load(variant, (_RGB,))


def load_mitsuba(variant: str | None = None) -> Any:
    """Import Mitsuba with a working libLLVM and a variant set; returns the module.

    Args:
        variant: Mitsuba variant, RGB or spectral; by default the one already set, else
            `llvm_ad_rgb`. One for GPUs is never the default, since few tests have run there.

    Raises:
        LumitreeError: unusable libLLVM, or a variant that is unknown, not vectorised, monochrome or
            polarised.
    """
    return _load(variant, (_RGB, _SPECTRAL))


def _load(variant: str | None, kinds: tuple[str, ...]) -> Any:
    select_llvm()
    chosen = os.environ.get("DRJIT_LIBLLVM_PATH")
    if chosen and not Path(chosen).is_file():
        raise LumitreeError(f"DRJIT_LIBLLVM_PATH names {chosen}, which is not a file; {_remedy()}")
    mi = _import_mitsuba()
    variant = str(variant or mi.variant() or CPU_VARIANT)
    choose = "choose " + " or ".join(each for each in mi.variants() if each.endswith(_RGB))
    if variant not in mi.variants():
        raise LumitreeError(f"this Mitsuba has no variant {variant!r}; {choose}")
    if not variant.endswith(kinds):
        only = "; spectral variants only render scenes" if variant.endswith(_SPECTRAL) else ""
        raise LumitreeError(
            f"lumitree needs a vectorised RGB variant of Mitsuba, not {variant!r}{only}; {choose}"
        )
    if variant.startswith("llvm"):
        check_llvm(importlib.import_module("drjit").detail.llvm_version(), chosen)
    if mi.variant() != variant:
        try:
            mi.set_variant(variant)
        except ImportError as error:
            raise LumitreeError(
                f"Mitsuba variant {variant} cannot start: {str(error).splitlines()[0]}"
            ) from error
    if _threads is not None:
        importlib.import_module("drjit").set_thread_count(_threads)
    if _quiet:
        mi.set_log_level(mi.LogLevel.Error)
    warn_of_gpu(variant)
    return mi


def quieten() -> None:
    """Make Mitsuba log only errors once it is loaded; called by the command line.

    In Python, Mitsuba's log level is the user's.
    """
    global _quiet
    _quiet = True


def is_quiet() -> bool:
    """Whether `quieten` was called."""
    return _quiet


def use_threads(count: int) -> None:
    """Make CPU variants compute in so many threads once Mitsuba is loaded."""
    global _threads
    _threads = count


@contextlib.contextmanager
def second_thread() -> Iterator[None]:
    """Context in which CPU variants have a second thread, also on a single core.

    Without one Mitsuba 3.9 waits for ever when it reads or writes an OpenEXR image, whose blocks
    are tasks for other threads.
    """
    global _threads
    dr = importlib.import_module("drjit")
    before, count = _threads, dr.thread_count()
    if count >= 2:
        yield
        return
    # Plugins that are created meanwhile may call `load_mitsuba`, which sets the number, too.
    _threads = 2
    dr.set_thread_count(2)
    try:
        yield
    finally:
        _threads = before
        dr.set_thread_count(count)


def warn_of_gpu(variant: str) -> None:
    """Warn, once in a process, that a variant for GPUs is little tested, or untested (Metal's)."""
    global _warned_of_gpu
    if not variant.startswith("llvm") and not _warned_of_gpu:
        _warned_of_gpu = True
        tested = "little tested" if variant.startswith("cuda") else "untested"
        warnings.warn(
            f"{variant} is {tested}; compare what it computes with {CPU_VARIANT}",
            LumitreeWarning,
            stacklevel=4,
        )


def check_llvm(version: tuple[int, ...] | None, path: str | None) -> None:
    """Refuse a libLLVM that cannot be used, instead of letting it abort the process."""
    source = f" ({path})" if path else ""
    if not version or version[0] <= 0:
        raise LumitreeError(f"no usable libLLVM was found{source}; {_remedy()}")
    if version[0] < MIN_LLVM:
        text = ".".join(map(str, version))
        raise LumitreeError(
            f"libLLVM {text}{source} is loaded, which aborts on many machines; need {MIN_LLVM} or "
            f"newer: import lumitree before mitsuba, and {_remedy()}"
        )


def _import_mitsuba() -> Any:
    try:
        return importlib.import_module("mitsuba")
    except (ImportError, NameError) as error:
        # Dr.Jit raises a NameError while it handles why its library cannot be loaded.
        reason = error if isinstance(error, ImportError) else error.__context__
        if not isinstance(reason, ImportError):
            raise
        raise LumitreeError(
            f"Mitsuba cannot be loaded: {shown(reason, 200)}; install what is missing (for "
            "libatomic.so.1 on Debian and Ubuntu: apt install libatomic1; on Windows it is often "
            "the Visual C++ Redistributable of Microsoft)"
        ) from error


def _remedy() -> str:
    """Advice about a libLLVM that cannot be used."""
    if _bundled_llvm() is not None:
        return "unset DRJIT_LIBLLVM_PATH to use the one that comes with lumitree"
    how = _LLVM_INSTALLERS.get(sys.platform, "")
    return f"install LLVM {MIN_LLVM} or newer{how}, or name its library with DRJIT_LIBLLVM_PATH"


def _bundled_llvm() -> Path | None:
    # Takes as long as all else that `import lumitree` needs.
    import importlib.metadata

    try:
        files = importlib.metadata.distribution("karellen-llvm-core").files or []
    except importlib.metadata.PackageNotFoundError:
        return None
    libraries = [file for file in files if file.name.startswith("libLLVM.so.")]
    return Path(str(libraries[0].locate())).resolve() if libraries else None


def _installed_llvm() -> Path | None:
    """The newest libLLVM among those where installers put them; None if none can be used."""
    import platform

    # A system may have the libraries of another architecture too.
    places = [
        each.replace("MACHINE", platform.machine()) for each in _LLVM_PLACES.get(sys.platform, ())
    ]
    patterns = map(os.path.expandvars, places)
    names = [name for pattern in patterns for name in glob.glob(pattern)]
    found = [(_version_in(name), name) for name in names if _LLVM_NAME.fullmatch(Path(name).name)]
    # A library of unknown version is taken if there is no other.
    usable = [each for each in found if each[0] == 0 or each[0] >= MIN_LLVM]
    return Path(max(usable)[1]) if usable else None


def _version_in(path: str) -> int:
    """Major version of a libLLVM by its name or its folder's name; 0 if neither states it."""
    name = _LLVM_VERSION.match(Path(os.path.realpath(path)).name)
    folders = _LLVM_FOLDER.findall(path)
    if name is None or (int(name[1]) < 4 and folders):
        # libLLVM.so.1 is in a folder with the version of LLVM.
        return int(folders[-1]) if folders else 0
    return int(name[1])


F = TypeVar("F", bound=Callable[..., Any])

_lock = threading.Lock()
# The thread that holds the lock.
_holder: int | None = None


@contextlib.contextmanager
def turn() -> Iterator[None]:
    """Context that only one thread of the process is in; a thread may enter it again."""
    global _holder
    if _holder == threading.get_ident():
        yield
        return
    _lock.acquire()
    _holder = threading.get_ident()
    try:
        yield
    finally:
        # A signal may have ended `passed_on` while it waited.
        if _holder == threading.get_ident():
            _holder = None
            _lock.release()


@contextlib.contextmanager
def passed_on() -> Iterator[None]:
    """Context in which other threads may have the turn of this one, which waits for them."""
    global _holder
    if _holder != threading.get_ident():
        yield
        return
    _holder = None
    _lock.release()
    try:
        yield
    finally:
        _lock.acquire()
        _holder = threading.get_ident()


def in_turn(function: F) -> F:
    """Decorator of public functions that compute with Mitsuba: `explained`, and by `turn`."""

    @functools.wraps(function)
    def run(*args: Any, **kwargs: Any) -> Any:
        with turn():
            return function(*args, **kwargs)

    return cast(F, explained(run))


# Packages by the name of the module that is imported.
NETWORK = {
    "jax": "jax",
    "flax": "flax",
    "optax": "optax",
}


# Packages for work on several machines.
CLUSTER = {"distributed": "distributed"}


def check_network() -> None:
    """Refuse to use the network without its packages, before any work is done.

    It imports none of them.

    Raises:
        LumitreeError: a package is not installed.
    """
    _check("the network needs", NETWORK, "network")


def check_cluster() -> None:
    """Refuse to use a Dask scheduler without its package; imports nothing."""
    _check("a Dask scheduler needs", CLUSTER, "cluster")


def _check(what: str, packages: dict[str, str], extra: str) -> None:
    """Refuse what needs packages, by module, of which one is not installed."""
    missing = [package for module, package in packages.items() if not _is_installed(module)]
    if missing:
        raise LumitreeError(
            f"{what} packages that are not installed ({', '.join(missing)}); install "
            f"them with `pip install 'lumitree[{extra}]'`"
        )


def _is_installed(module: str) -> bool:
    try:
        return importlib.util.find_spec(module) is not None
    except ModuleNotFoundError:
        # The package that contains the module is missing.
        return False
