"""The optional dependencies of the network: the extra `network` of lumitree."""

import importlib.util

from lumitree.errors import LumitreeError

# Packages by the name of the module that is imported.
NETWORK = {
    "jax": "jax",
    "flax": "flax",
    "optax": "optax",
    "orbax.checkpoint": "orbax-checkpoint",
}


def check_network() -> None:
    """Refuse to use the network without its packages, before any work is done.

    It imports none of them.

    Raises:
        LumitreeError: a package is not installed.
    """
    missing = [package for module, package in NETWORK.items() if not _is_installed(module)]
    if missing:
        raise LumitreeError(
            f"the network needs packages that are not installed ({', '.join(missing)}); install "
            "them with `pip install 'lumitree[network]'`"
        )


def _is_installed(module: str) -> bool:
    try:
        return importlib.util.find_spec(module) is not None
    except ModuleNotFoundError:
        # The package that contains the module is missing.
        return False
