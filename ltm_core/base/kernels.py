"""Prefetch memory into the cache in compiled kernels; do nothing if compilation is off."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import config, types
from numba.core import cgutils
from numba.extending import intrinsic


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
