"""Eight values that go through the same instructions: vectors for numba kernels, which numba itself does not have.

`Lanes` hold eight float64, int64 or truth values as one LLVM vector, so that arithmetic on them is one instruction
where the processor has 512-bit vectors, and several where it has not: LLVM splits them to what there is. The usual
operators work between lanes, and between lanes and a scalar, which is spread over all of them; a comparison gives
lanes of truth. Instead of branches there are `select`, `any_of` and masks.

What each operation becomes: the LLVM Language Reference, under "Vector Operations" and "Masked Gather".
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

import llvmlite.binding
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typeconv import Conversion
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, lower_cast, models, register_model

WIDTH = 8
"""Lanes of a vector: 512 bits of float64."""

_CONTRACT = ("contract", "nsz")  # as the scalar kernels have it: FMA is safe, NaN and infinity keep their meaning


def fast_here() -> bool:
    """Whether this processor has vectors of 512 bits with gathers, for which lanes beat one ray at a time."""
    features = llvmlite.binding.get_host_cpu_features()
    return bool(features.get("avx512f") and features.get("avx512dq") and features.get("avx512vl"))


class LanesType(types.Type):  # type: ignore[misc]
    """Numba's type of `WIDTH` values of a scalar type."""

    def __init__(self, scalar: types.Type) -> None:
        self.scalar = scalar
        super().__init__(name=f"Lanes({scalar})")

    def can_convert_from(self, context: Any, other: types.Type) -> Conversion | None:
        """Scalars are spread over all lanes."""
        if self.scalar == types.float64 and isinstance(other, types.Float | types.Integer):
            return Conversion.safe
        if self.scalar == types.int64 and isinstance(other, types.Integer):
            return Conversion.safe
        return None


FLOATS, INTS, TRUTHS = LanesType(types.float64), LanesType(types.int64), LanesType(types.boolean)
_DOUBLE, _INT, _BIT, _SINGLE = ir.DoubleType(), ir.IntType(64), ir.IntType(1), ir.FloatType()
_ELEMENT = {FLOATS: _DOUBLE, INTS: _INT, TRUTHS: _BIT}


def _vector(element: ir.Type) -> ir.VectorType:
    return ir.VectorType(element, WIDTH)


@register_model(LanesType)
class _LanesModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, kind: LanesType) -> None:
        super().__init__(manager, kind, _vector(_ELEMENT[kind]))


def _spread(builder: ir.IRBuilder, value: ir.Value) -> ir.Value:
    vector = _vector(value.type)
    first = builder.insert_element(ir.Constant(vector, ir.Undefined), value, ir.IntType(32)(0))
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), WIDTH), [0] * WIDTH)
    return builder.shuffle_vector(first, ir.Constant(vector, ir.Undefined), zeros)


@lower_cast(types.Float, LanesType)  # type: ignore[untyped-decorator]
@lower_cast(types.Integer, LanesType)  # type: ignore[untyped-decorator]
def _cast_scalar(context: Any, builder: ir.IRBuilder, given: types.Type, wanted: LanesType, value: ir.Value) -> Any:
    return _spread(builder, context.cast(builder, value, given, wanted.scalar))


def _common(a: types.Type, b: types.Type) -> LanesType | None:
    """The lanes that two operands, of which one at least is lanes, meet in."""
    lanes = [t for t in (a, b) if isinstance(t, LanesType)]
    if not lanes or any(t != lanes[0] for t in lanes):
        return None
    other = a if b == lanes[0] else b
    if other != lanes[0] and lanes[0].can_convert_from(None, other) is None:
        return None
    return lanes[0]


_Emit = Callable[[ir.IRBuilder, LanesType, ir.Value, ir.Value], ir.Value]


def _define(operation: Any, kinds: tuple[LanesType, ...], truth: bool, emit: _Emit) -> None:
    """Give a binary operator a meaning for lanes of `kinds`."""

    @infer_global(operation)
    class _Template(AbstractTemplate):  # type: ignore[misc]
        def generic(self, args: tuple[types.Type, ...], kws: Any) -> Any:
            kind = _common(*args) if len(args) == 2 else None
            return signature(TRUTHS if truth else kind, kind, kind) if kind in kinds else None

    def lower(context: Any, builder: ir.IRBuilder, sig: Any, args: tuple[ir.Value, ir.Value]) -> ir.Value:
        return emit(builder, sig.args[0], *args)

    lower_builtin(operation, LanesType, LanesType)(lower)


def _arithmetic(of_floats: str, of_ints: str) -> _Emit:
    def emit(builder: ir.IRBuilder, kind: LanesType, a: ir.Value, b: ir.Value) -> ir.Value:
        if kind == FLOATS:
            return getattr(builder, of_floats)(a, b, flags=_CONTRACT)
        return getattr(builder, of_ints)(a, b)

    return emit


def _comparison(sign: str) -> _Emit:
    def emit(builder: ir.IRBuilder, kind: LanesType, a: ir.Value, b: ir.Value) -> ir.Value:
        if kind == INTS:
            return builder.icmp_signed(sign, a, b)
        # NaN is unequal to everything, itself too.
        return builder.fcmp_unordered(sign, a, b) if sign == "!=" else builder.fcmp_ordered(sign, a, b)

    return emit


_define(operator.add, (FLOATS, INTS), False, _arithmetic("fadd", "add"))
_define(operator.sub, (FLOATS, INTS), False, _arithmetic("fsub", "sub"))
_define(operator.mul, (FLOATS, INTS), False, _arithmetic("fmul", "mul"))
_define(operator.truediv, (FLOATS,), False, _arithmetic("fdiv", ""))
for _operation, _sign in (
    (operator.lt, "<"),
    (operator.le, "<="),
    (operator.gt, ">"),
    (operator.ge, ">="),
    (operator.eq, "=="),
    (operator.ne, "!="),
):
    _define(_operation, (FLOATS, INTS), True, _comparison(_sign))
_define(operator.and_, (TRUTHS,), False, lambda builder, kind, a, b: builder.and_(a, b))
_define(operator.or_, (TRUTHS,), False, lambda builder, kind, a, b: builder.or_(a, b))


@infer_global(operator.neg)
class _Negative(AbstractTemplate):  # type: ignore[misc]
    def generic(self, args: tuple[types.Type, ...], kws: Any) -> Any:
        return signature(FLOATS, FLOATS) if args == (FLOATS,) else None


@lower_builtin(operator.neg, LanesType)  # type: ignore[untyped-decorator]
def _lower_negative(context: Any, builder: ir.IRBuilder, sig: Any, args: tuple[ir.Value]) -> ir.Value:
    return builder.fneg(args[0])


@infer_global(operator.invert)
class _Not(AbstractTemplate):  # type: ignore[misc]
    def generic(self, args: tuple[types.Type, ...], kws: Any) -> Any:
        return signature(TRUTHS, TRUTHS) if args == (TRUTHS,) else None


@lower_builtin(operator.invert, LanesType)  # type: ignore[untyped-decorator]
def _lower_not(context: Any, builder: ir.IRBuilder, sig: Any, args: tuple[ir.Value]) -> ir.Value:
    return builder.not_(args[0])


@intrinsic  # type: ignore[untyped-decorator]
def select(typing_context: Any, mask: Any, chosen: Any, otherwise: Any) -> Any:
    """`chosen` where `mask`, else `otherwise`, by lane, of lanes or scalars; with a single truth value, of floats."""
    if mask == TRUTHS:
        whole = isinstance(chosen, types.Integer) and isinstance(otherwise, types.Integer)
        kind = _common(chosen, otherwise) or (INTS if whole else FLOATS)
    elif mask == types.boolean:
        kind = types.float64
    else:
        return None

    def generate(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
        return builder.select(*args)

    return kind(mask, kind, kind), generate


@intrinsic  # type: ignore[untyped-decorator]
def any_of(typing_context: Any, mask: Any) -> Any:
    """Whether a lane of `mask` is true."""
    if mask != TRUTHS:
        return None

    def generate(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
        bits = builder.bitcast(args[0], ir.IntType(WIDTH))
        return builder.icmp_unsigned("!=", bits, ir.IntType(WIDTH)(0))

    return types.boolean(TRUTHS), generate


@intrinsic  # type: ignore[untyped-decorator]
def is_set(typing_context: Any, mask: Any, lane: Any) -> Any:
    """Whether one lane of `mask` is true."""
    if mask != TRUTHS:
        return None

    def generate(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
        return builder.extract_element(*args)

    return types.boolean(TRUTHS, types.int64), generate


@intrinsic  # type: ignore[untyped-decorator]
def count_of(typing_context: Any, mask: Any) -> Any:
    """How many lanes of `mask` are true."""
    if mask != TRUTHS:
        return None

    def generate(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
        return builder.zext(builder.ctpop(builder.bitcast(args[0], ir.IntType(WIDTH))), _INT)

    return types.int64(TRUTHS), generate


@intrinsic  # type: ignore[untyped-decorator]
def compressed(typing_context: Any, values: Any, mask: Any) -> Any:
    """The lanes where `mask` is true, moved to the front in their order; anything in the others."""
    if values != FLOATS or mask != TRUTHS:
        return None

    def generate(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
        kind = _vector(_DOUBLE)
        of = ir.FunctionType(kind, [kind, _vector(_BIT), kind])
        name = f"llvm.experimental.vector.compress.v{WIDTH}f64"
        called = cgutils.get_or_insert_function(builder.module, of, name)
        return builder.call(called, [*args, ir.Constant(kind, ir.Undefined)])

    return FLOATS(FLOATS, TRUTHS), generate


@intrinsic  # type: ignore[untyped-decorator]
def lane_numbers(typing_context: Any) -> Any:
    """0, 1, 2 ... WIDTH - 1."""

    def generate(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
        return ir.Constant(_vector(_INT), list(range(WIDTH)))

    return INTS(), generate


def _of_one(name: str) -> Any:
    """An LLVM function of one float64, or of lanes of them."""

    @intrinsic  # type: ignore[untyped-decorator]
    def function(typing_context: Any, value: Any) -> Any:
        if value not in (FLOATS, types.float64):
            return None
        form, suffix = (_vector(_DOUBLE), f"v{WIDTH}f64") if value == FLOATS else (_DOUBLE, "f64")

        def generate(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
            of = ir.FunctionType(form, [form])
            return builder.call(cgutils.get_or_insert_function(builder.module, of, f"llvm.{name}.{suffix}"), args)

        return value(value), generate

    return function


root_of = _of_one("sqrt")
floor_of = _of_one("floor")
size_of = _of_one("fabs")


@intrinsic  # type: ignore[untyped-decorator]
def to_ints(typing_context: Any, values: Any) -> Any:
    """Whole parts as int64, towards zero; of values beyond int64 and NaN anything."""
    if values != FLOATS:
        return None

    def generate(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
        return builder.fptosi(args[0], _vector(_INT))

    return INTS(FLOATS), generate


@intrinsic  # type: ignore[untyped-decorator]
def to_floats(typing_context: Any, values: Any) -> Any:
    """Ints as float64."""
    if values != INTS:
        return None

    def generate(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
        return builder.sitofp(args[0], _vector(_DOUBLE))

    return FLOATS(INTS), generate


def _start(context: Any, builder: ir.IRBuilder, kind: types.Array, array: ir.Value, at: ir.Value) -> ir.Value:
    """Address of array[at]."""
    return builder.gep(context.make_array(kind)(context, builder, array).data, [at])


@intrinsic  # type: ignore[untyped-decorator]
def load(typing_context: Any, array: Any, at: Any) -> Any:
    """array[at : at + WIDTH] of a contiguous float64, float32 or int64 array."""
    kind = {types.float64: FLOATS, types.float32: FLOATS, types.int64: INTS}.get(getattr(array, "dtype", None))
    if kind is None:
        return None
    element = _SINGLE if array.dtype == types.float32 else _ELEMENT[kind]

    def generate(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
        address = _start(context, builder, sig.args[0], *args)
        values = builder.load(builder.bitcast(address, _vector(element).as_pointer()), align=4)
        return builder.fpext(values, _vector(_DOUBLE)) if element == _SINGLE else values

    return kind(array, types.intp), generate


@intrinsic  # type: ignore[untyped-decorator]
def load_triples(typing_context: Any, array: Any, at: Any) -> Any:
    """Of a contiguous float64 array, from index `at` on, x, y and z of WIDTH triples x, y, z, x, y, z ..."""
    if array.dtype != types.float64:
        return None

    def generate(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
        address = _start(context, builder, sig.args[0], *args)
        three = ir.VectorType(_DOUBLE, 3 * WIDTH)
        both = builder.load(builder.bitcast(address, three.as_pointer()), align=8)
        index = ir.VectorType(ir.IntType(32), WIDTH)
        places = [ir.Constant(index, list(range(k, 3 * WIDTH, 3))) for k in range(3)]
        parts = [builder.shuffle_vector(both, ir.Constant(three, ir.Undefined), place) for place in places]
        return context.make_tuple(builder, sig.return_type, parts)

    return types.UniTuple(FLOATS, 3)(array, types.intp), generate


@intrinsic  # type: ignore[untyped-decorator]
def store(typing_context: Any, array: Any, at: Any, values: Any) -> Any:
    """Write array[at : at + WIDTH] of a contiguous array of the lanes' kind, or of float32."""
    if (array.dtype, values) not in ((types.float64, FLOATS), (types.float32, FLOATS), (types.int64, INTS)):
        return None

    def generate(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> Any:
        address = _start(context, builder, sig.args[0], *args[:2])
        written = builder.fptrunc(args[2], _vector(_SINGLE)) if array.dtype == types.float32 else args[2]
        builder.store(written, builder.bitcast(address, written.type.as_pointer()), align=4)
        return context.get_dummy_value()

    return types.none(array, types.intp, values), generate


def _gathered(
    context: Any, builder: ir.IRBuilder, kind: types.Array, args: Any, element: ir.Type, suffix: str
) -> ir.Value:
    """`element` at array[at] by lane, where the mask is true; 0 elsewhere, where memory is not looked at."""
    array, at, mask = args
    scale = context.get_abi_sizeof(context.get_data_type(kind.dtype))
    base = builder.ptrtoint(context.make_array(kind)(context, builder, array).data, _INT)
    offsets = builder.mul(at, ir.Constant(_vector(_INT), [scale] * WIDTH))
    pointers = ir.VectorType(ir.PointerType(element), WIDTH)
    addresses = builder.inttoptr(builder.add(_spread(builder, base), offsets), pointers)
    vector = _vector(element)
    of = ir.FunctionType(vector, [pointers, ir.IntType(32), _vector(_BIT), vector])
    name = f"llvm.masked.gather.v{WIDTH}{suffix}.v{WIDTH}p0"
    called = cgutils.get_or_insert_function(builder.module, of, name)
    return builder.call(called, [addresses, ir.IntType(32)(scale), mask, ir.Constant(vector, None)])


_GATHERED = {types.float32: (_SINGLE, "f32"), types.int32: (ir.IntType(32), "i32"), types.int64: (_INT, "i64")}


@intrinsic  # type: ignore[untyped-decorator]
def gather(typing_context: Any, array: Any, at: Any, mask: Any) -> Any:
    """array[at] by lane, where `mask` is true, else 0; of a contiguous float32, int32 or int64 array."""
    if at != INTS or mask != TRUTHS or array.dtype not in _GATHERED:
        return None
    element, suffix = _GATHERED[array.dtype]
    kind = FLOATS if array.dtype == types.float32 else INTS

    def generate(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
        values = _gathered(context, builder, sig.args[0], args, element, suffix)
        if kind == FLOATS:
            return builder.fpext(values, _vector(_DOUBLE))
        return values if element == _INT else builder.sext(values, _vector(_INT))

    return kind(array, INTS, TRUTHS), generate


@intrinsic  # type: ignore[untyped-decorator]
def gather_pair(typing_context: Any, array: Any, at: Any, mask: Any) -> Any:
    """array[at] and array[at + 1] of a contiguous float32 array by lane, with one gather; else as `gather`."""
    if at != INTS or mask != TRUTHS or array.dtype != types.float32:
        return None
    pair = types.UniTuple(FLOATS, 2)

    def generate(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
        both = _gathered(context, builder, sig.args[0], args, _INT, "i64")
        halves = []
        # x86 and every other machine that numba knows is little-endian: the first of two is the lower half.
        for value in (both, builder.lshr(both, ir.Constant(_vector(_INT), [32] * WIDTH))):
            bits = builder.trunc(value, _vector(ir.IntType(32)))
            halves.append(builder.fpext(builder.bitcast(bits, _vector(_SINGLE)), _vector(_DOUBLE)))
        return context.make_tuple(builder, sig.return_type, halves)

    return pair(array, INTS, TRUTHS), generate
