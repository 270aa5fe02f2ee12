"""Which kernels a process has compiled, or loaded, so far."""

import sys

from numba.core.dispatcher import Dispatcher


def compiled() -> dict[str, int]:
    """For how many signatures each kernel of ours is, by its name."""
    modules = [module for name, module in sys.modules.items() if name.startswith("ltm_")]
    kernels = {kernel for module in modules for kernel in vars(module).values() if isinstance(kernel, Dispatcher)}
    return {f"{kernel.py_func.__module__}.{kernel.py_func.__name__}": len(kernel.signatures) for kernel in kernels}
