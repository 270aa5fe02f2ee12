"""Compile kernels with numba, run them on all threads, and prefetch memory in them.

Kernels are cached on disk (`numba_cache`) and compiled when they are first called. Division by zero gives infinity or
NaN. Without compilation (NUMBA_DISABLE_JIT) they are plain Python functions."""

import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import Any

from llvmlite import ir
from numba import config, njit, types
from numba.core import caching, cgutils
from numba.core.runtime import rtsys
from numba.extending import intrinsic

from ltm_core.base.numba_cache import kernel_level, use_own_cache


class _ByModule(caching.UserProvidedCacheLocator):  # type: ignore[misc]
    """Numba's place of a function in a cache folder of ours: by its module, not by where the package is installed."""

    def __init__(self, py_func: Callable[..., Any], py_file: str) -> None:
        super().__init__(py_func, py_file)
        self._cache_path = str(Path(config.CACHE_DIR) / py_func.__module__)


def use_cache(source: Path) -> None:
    """Let numba use the kernels compiled for this state of `source`, and compile others for the same processors."""
    folder = use_own_cache(source)
    if folder is not None and (level := kernel_level(folder)):
        config.CPU_NAME, config.CPU_FEATURES = level, ""


class _KernelCacheImpl(caching.CompileResultCacheImpl):  # type: ignore[misc]
    _locator_classes = (_ByModule, *caching.CacheImpl._locator_classes)


class _KernelCache(caching.FunctionCache):  # type: ignore[misc]
    """Compiled kernels on disk. Functions of other packages, or of a user, keep numba's own cache."""

    _impl_class = _KernelCacheImpl

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Load a compiled kernel; only if there is none, load all that numba compiles with (0.4 s), without SciPy's
        linear algebra (0.4 s): no kernel multiplies matrices."""
        rtsys.initialize(target_context)
        loaded = self._load_overload(sig, target_context)
        blas = "scipy.linalg.cython_blas"
        if loaded is None and blas not in sys.modules:
            sys.modules[blas] = None  # type: ignore[assignment]
            try:
                import numba.np.arraymath  # noqa: F401
            finally:
                del sys.modules[blas]
        return loaded


use_cache(Path(__file__).parents[1])

_Decorator = Callable[[Callable[..., Any]], Any]


def kernel(**options: Any) -> _Decorator:
    """Return a decorator for a kernel that Python calls; `options` of `numba.njit`."""
    decorator = njit(error_model="numpy", no_cfunc_wrapper=True, **options)

    def compiled(function: Callable[..., Any]) -> Any:
        dispatcher = decorator(function)
        if not config.DISABLE_JIT:
            dispatcher._cache = _KernelCache(function)  # as `cache=True` does with numba's own
        return dispatcher

    return compiled


def helper(**options: Any) -> _Decorator:
    """Return a decorator for a function that only kernels call: without a wrapper for Python, which would take a fifth
    of the time to compile. Without `fastmath` it takes that of the kernel that first calls it with these types."""
    return kernel(no_cpython_wrapper=True, **options)


_PARTS_PER_THREAD = 8
_threads = {"count": config.NUMBA_NUM_THREADS}


def kernel_threads() -> int:
    """Return the number of threads that `in_parallel` uses: NUMBA_NUM_THREADS, or that of `limit_kernel_threads`."""
    return int(_threads["count"])


def limit_kernel_threads(count: int) -> None:
    """Let kernels of this process use at most `count` threads, 1 or more."""
    _threads["count"] = min(count, config.NUMBA_NUM_THREADS)


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, thread_name_prefix="kernels")


def in_parallel(work: Callable[[int, int], object], count: int, least: int = 1) -> None:
    """Call `work(first, end)` for consecutive parts of range(count), in several threads. `work`: calls a kernel that
    releases the interpreter lock. `least`: minimum size of a part.

    Numba's own `parallel=True` takes seconds to compile, and its launches must not overlap in a process."""
    threads = kernel_threads()
    size = max(least, -(-count // (threads * _PARTS_PER_THREAD)))
    if threads == 1 or count <= size:
        work(0, count)
        return
    parts = [(first, min(first + size, count)) for first in range(0, count, size)]
    for _ in _pool(threads).map(lambda part: work(*part), parts):
        pass


def _prefetch(typing_context: Any, array: Any, index: Any) -> Any:
    """Fetch the cache line of array[index] into all cache levels. An index outside the array is harmless."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        address = builder.gep(data, [context.cast(builder, arguments[1], signature.args[1], types.intp)])
        flag = ir.IntType(32)
        byte = builder.bitcast(address, cgutils.voidptr_t)
        kind = ir.FunctionType(ir.VoidType(), [cgutils.voidptr_t, flag, flag, flag])
        function = builder.module.declare_intrinsic("llvm.prefetch", [cgutils.voidptr_t], kind)
        builder.call(function, [byte, flag(0), flag(3), flag(1)])  # read, keep in all levels, data
        return context.get_dummy_value()

    return types.none(array, index), generate


def _nothing(array: Any, index: Any) -> None:
    """Do nothing: the fallback in plain Python."""


prefetch: Any = _nothing if config.DISABLE_JIT else intrinsic(_prefetch)
