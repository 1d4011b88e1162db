"""Optional dependencies, for the network and for clusters."""

import importlib.util

from lumitree.errors import LumitreeError

# Packages by the name of the module that is imported.
NETWORK = {
    "jax": "jax",
    "flax": "flax",
    "optax": "optax",
    "orbax.checkpoint": "orbax-checkpoint",
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
