"""Choosing libLLVM and a variant of Mitsuba; calls of several threads wait for each other."""

import os
import subprocess
import sys
import time
import warnings
from concurrent.futures import ThreadPoolExecutor

import pytest

from lumitree.core import backend
from lumitree.core.backend import (
    check_llvm,
    in_turn,
    load_mitsuba,
    load_rgb,
    passed_on,
    warn_of_gpu,
)
from lumitree.core.executor import run_tasks
from lumitree.errors import LumitreeError, LumitreeWarning


@pytest.mark.parametrize("version", [(14, 0, 6), (15, 0, 7), (16, 0, 0)])
def test_versions_that_abort_are_refused(version):
    with pytest.raises(LumitreeError, match="import lumitree before mitsuba, and unset"):
        check_llvm(version, None)


def test_no_llvm_is_refused():
    with pytest.raises(LumitreeError, match="no usable libLLVM was found"):
        check_llvm((-1, -1, -1), "/x.so")


@pytest.mark.parametrize(
    ("files", "chosen"),
    [
        (["llvm-18/lib/libLLVM.so.1", "llvm-9/lib/libLLVM.so.1"], 0),
        (["libLLVMSPIRVLib.so.15", "libLLVM.so.19.1", "libLLVM-C.so", "libLLVMSupport.so"], 1),
        (["llvm15env/lib/libLLVM-19.so"], 0),
        (["libLLVM.so", "libLLVM-18.so.1", "libLLVM.20.1.dylib"], 2),
        (["libLLVM-14.so.1"], None),
        ([], None),
    ],
)
def test_the_newest_llvm_of_the_system_is_taken(tmp_path, monkeypatch, files, chosen):
    monkeypatch.setattr(backend, "_bundled_llvm", lambda: None)
    monkeypatch.setitem(backend._LLVM_PLACES, sys.platform, ("$ROOT/*LLVM*", "$ROOT/*/*/*LLVM*"))
    monkeypatch.setenv("ROOT", str(tmp_path))
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "")
    monkeypatch.delitem(sys.modules, "drjit", raising=False)
    for name in files:
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    backend.select_llvm()
    expected = "" if chosen is None else str(tmp_path / files[chosen])
    assert os.environ["DRJIT_LIBLLVM_PATH"] == expected


@pytest.mark.parametrize("version", [(19, 1, 0), (23, 1, 4)])
def test_good_versions_pass(version):
    check_llvm(version, None)


@pytest.mark.parametrize("variant", ["scalar_rgb", "scalar_spectral", "llvm_ad_mono", "nonsense"])
def test_other_variants_are_refused(mi, variant):
    with pytest.raises(LumitreeError, match="llvm_ad_rgb"):
        load_mitsuba(variant)


def test_spectral_variants_only_render(mi):
    before = mi.variant()
    with pytest.raises(LumitreeError, match="'; spectral variants only render scenes"):
        load_rgb("llvm_ad_spectral")
    assert mi.variant() == before


def run(code, **environment):
    return subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        env={**os.environ, **environment},
    )


@pytest.mark.parametrize("as_drjit", [True, False])
def test_a_library_that_the_system_lacks_is_one_line(monkeypatch, as_drjit):
    """As libatomic in small images of Debian; Dr.Jit raises a NameError after it."""

    def fail(name):
        try:
            raise ImportError("libatomic.so.1: cannot open shared object file")
        except ImportError:
            if as_drjit:
                raise NameError("name '_drjit_ext' is not defined")  # noqa: B904
            raise

    monkeypatch.setattr(backend.importlib, "import_module", fail)
    with pytest.raises(LumitreeError, match=r"loaded: libatomic\.so\.1: .*; install what"):
        load_mitsuba()


def test_a_missing_library_is_one_line():
    result = run(
        "from lumitree.cli import main; main(['capture', 'bulbs', '-o', 'x'])",
        DRJIT_LIBLLVM_PATH="/nowhere/libLLVM.so",
    )
    assert "names /nowhere/libLLVM.so, which is not a file; unset" in result.stderr
    assert result.stderr.count("\n") == 1


def test_a_gpu_is_not_used_by_default():
    code = (
        "import lumitree, drjit; drjit.has_backend = lambda backend: True;"
        "from lumitree.core.backend import load_mitsuba; print(load_mitsuba().variant())"
    )
    assert succeeds(code) == ["llvm_ad_rgb"]


@pytest.mark.parametrize(
    ("variant", "tested"), [("cuda_ad_rgb", "little tested"), ("metal_ad_rgb", "untested")]
)
def test_variants_for_gpus_are_said_to_be_little_tested_once(monkeypatch, variant, tested):
    monkeypatch.setattr(backend, "_warned_of_gpu", False)
    with pytest.warns(LumitreeWarning, match=f"^{variant} is {tested}; compare .* llvm"):
        warn_of_gpu(variant)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warn_of_gpu(variant)


def test_variants_of_metal_are_accepted_where_mitsuba_has_them(monkeypatch, mi):
    """As its packages for macOS have, which have none of CUDA."""
    names, chosen = ["scalar_rgb", "llvm_ad_rgb", "metal_ad_rgb", "metal_ad_spectral"], []
    monkeypatch.setattr(mi, "variants", lambda: names)
    monkeypatch.setattr(mi, "set_variant", chosen.append)
    monkeypatch.setattr(backend, "_warned_of_gpu", True)
    load_rgb("metal_ad_rgb")
    load_mitsuba("metal_ad_spectral")
    assert chosen == ["metal_ad_rgb", "metal_ad_spectral"]
    for name in ("cuda_ad_rgb", "scalar_rgb"):
        with pytest.raises(LumitreeError, match=r"; choose llvm_ad_rgb or metal_ad_rgb$"):
            load_mitsuba(name)


def test_users_choice_is_respected():
    result = run(
        "import lumitree, os; print(os.environ['DRJIT_LIBLLVM_PATH'])",
        DRJIT_LIBLLVM_PATH="/mine.so",
    )
    assert result.stdout.strip() == "/mine.so"


def succeeds(code):
    result = run(code)
    assert result.returncode == 0, result.stderr
    return result.stdout.split()


def test_the_log_is_left_as_it_is():
    code = (
        "import lumitree, mitsuba as mi; mi.set_variant('llvm_ad_rgb');"
        "mi.set_log_level(mi.LogLevel.Info); lumitree.register(); print(mi.log_level().name)"
    )
    assert succeeds(code) == ["Info"]


def test_a_program_may_let_errors_alone_be_logged():
    code = (
        "from lumitree.core import backend; backend.quieten();"
        "mi = backend.load_mitsuba('llvm_ad_rgb'); print(mi.log_level().name)"
    )
    assert succeeds(code) == ["Error"]


running = []


@in_turn
def counted(value):
    """Says how many calls there are at once; 0 within another call."""
    running.append(value)
    count = len(running)
    time.sleep(0.01)
    running.pop()
    return count, value


@in_turn
def nested(value):
    return counted(value)


@in_turn
def with_tasks(executor):
    with run_tasks(executor, counted, [(n,) for n in range(4)], what="numbers") as results:
        return sorted(result for _, result in results)


@in_turn
def failing():
    raise MemoryError


def test_one_thread_at_a_time():
    with ThreadPoolExecutor(4) as threads:
        found = list(threads.map(nested, range(8)))
    assert found == [(1, n) for n in range(8)]


def test_tasks_in_threads_of_the_process_get_the_turn():
    """The call that waits for them holds it otherwise."""
    with ThreadPoolExecutor(2) as threads, ThreadPoolExecutor(2) as callers:
        for found in callers.map(with_tasks, [threads] * 4):
            assert found == [(1, n) for n in range(4)]


def test_an_error_ends_the_turn():
    """It is explained as by `explained`."""
    with ThreadPoolExecutor(1) as threads:
        with pytest.raises(LumitreeError, match="not enough memory"):
            threads.submit(failing).result()
        assert counted(3) == (1, 3)
        assert threads.submit(counted, 4).result(timeout=10) == (1, 4)


def test_without_a_turn_there_is_none_to_pass_on():
    with passed_on():
        assert counted(5) == (1, 5)
