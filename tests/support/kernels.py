"""Kernels that a computation runs."""

from collections.abc import Callable


def kernels_of(compute: Callable[[], object]) -> set[str]:
    """Hashes of the kernels that Dr.Jit runs in a computation."""
    import drjit as dr

    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        compute()
        history = dr.kernel_history([dr.KernelType.JIT])
    return {str(kernel["hash"]) for kernel in history}
