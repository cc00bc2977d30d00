"""Vectors of eight float32 inside numba kernels, so that what is a vector does not depend on a compiler's mood.

numba has no vector type, and LLVM's own vectorizer gives up on short loops over arrays that might overlap (five times
slower here). `lanes` and `mask` are LLVM vectors with the few operations the renderer needs; LLVM lowers them to what
the machine has (two halves without AVX). They exist only inside compiled functions. Nothing checks a bound.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typing import signature
from numba.core.typing.templates import ConcreteTemplate, infer_global
from numba.extending import intrinsic, lower_builtin, models, register_model

WIDTH = 8
"""Lanes of a vector: one AVX register."""
FLOAT, INT, BIT, LONG = ir.FloatType(), ir.IntType(32), ir.IntType(1), ir.IntType(64)
VECTOR, INTS, BITS = (ir.VectorType(t, WIDTH) for t in (FLOAT, INT, BIT))
EXP2 = (1.0, 0.6931470036506653, 0.24022242426872253, 0.05550733581185341, 0.009671512991189957, 0.001326472731307149)
"""2^f on [-1/2, 1/2]: minimax under the condition that it is 1 at 0, relative error 9e-8."""
SQRT_HALF = 0x3F3504F3
"""Bits of sqrt(1/2)."""


class _Lanes(types.Type):
    def __init__(self) -> None:
        super().__init__(name=f"float32x{WIDTH}")


class _Mask(types.Type):
    def __init__(self) -> None:
        super().__init__(name=f"boolx{WIDTH}")


lanes, mask = _Lanes(), _Mask()


@register_model(_Lanes)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, VECTOR)


@register_model(_Mask)
class _MaskModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, BITS)


def _constant(value: float) -> ir.Constant:
    return ir.Constant(VECTOR, [float(np.float32(value))] * WIDTH)


def _ints(value: int) -> ir.Constant:
    return ir.Constant(INTS, [value] * WIDTH)


def _splat(builder: ir.IRBuilder, value: Any) -> Any:
    first = builder.insert_element(ir.Constant(VECTOR, ir.Undefined), value, ir.Constant(INT, 0))
    return builder.shuffle_vector(first, ir.Constant(VECTOR, ir.Undefined), _ints(0))


def _call(builder: ir.IRBuilder, name: str, *args: Any) -> Any:
    kind = ir.FunctionType(VECTOR, [VECTOR] * len(args))
    return builder.call(cgutils.get_or_insert_function(builder.module, kind, f"llvm.{name}.v{WIDTH}f32"), args)


def _smaller(builder: ir.IRBuilder, a: Any, b: Any) -> Any:
    return builder.select(builder.fcmp_ordered("<", a, b), a, b)


def _exp2_minus(builder: ir.IRBuilder, e: Any) -> Any:
    magic = _constant(1.5 * 2**23)
    shifted = builder.fsub(magic, e)  # its low bits hold -e, rounded
    f = builder.fsub(builder.fsub(magic, shifted), e)
    value = _constant(EXP2[-1])
    for c in EXP2[-2::-1]:
        value = _call(builder, "fmuladd", value, f, _constant(c))
    return builder.bitcast(
        builder.add(builder.bitcast(value, INTS), builder.shl(builder.bitcast(shifted, INTS), _ints(23))), VECTOR
    )


def _log2(builder: ir.IRBuilder, x: Any) -> Any:
    above = builder.sub(builder.bitcast(x, INTS), _ints(SQRT_HALF))
    exponent = builder.sitofp(builder.ashr(above, _ints(23)), VECTOR)
    # in [sqrt(1/2), sqrt(2))
    mantissa = builder.bitcast(builder.add(builder.and_(above, _ints(0x7FFFFF)), _ints(SQRT_HALF)), VECTOR)
    one = _constant(1.0)
    s = builder.fdiv(builder.fsub(mantissa, one), builder.fadd(mantissa, one))
    s2, series = builder.fmul(s, s), _constant(2 / np.log(2) / 9)
    for k in (7, 5, 3, 1):
        series = _call(builder, "fmuladd", series, s2, _constant(2 / np.log(2) / k))
    return _call(builder, "fmuladd", series, s, exponent)


def _minus_magnitude(builder: ir.IRBuilder, a: Any) -> Any:
    return builder.bitcast(builder.or_(builder.bitcast(a, INTS), _ints(-(2**31))), VECTOR)


def _all_negative(builder: ir.IRBuilder, a: Any) -> Any:
    signs = builder.icmp_signed("<", builder.bitcast(a, INTS), _ints(0))
    return builder.icmp_unsigned(
        "==", builder.bitcast(signs, ir.IntType(WIDTH)), ir.Constant(ir.IntType(WIDTH), 2**WIDTH - 1)
    )


def _packed(builder: ir.IRBuilder, low: Any, high: Any) -> Any:
    return builder.bitcast(
        builder.or_(builder.fptosi(low, INTS), builder.shl(builder.fptosi(high, INTS), _ints(16))), VECTOR
    )


def _transposed(builder: ir.IRBuilder, *rows: Any) -> list[Any]:
    """Rows and columns of an 8x8 matrix exchanged, in three rounds of swapping blocks of 1, 2 and 4."""
    matrix = list(rows)
    for size in (1, 2, 4):
        for i in range(WIDTH):
            if i & size:
                continue
            a, b = matrix[i], matrix[i + size]
            low = [j if not j & size else WIDTH + j - size for j in range(WIDTH)]
            high = [j + size if not j & size else WIDTH + j for j in range(WIDTH)]
            matrix[i], matrix[i + size] = (
                builder.shuffle_vector(a, b, ir.Constant(INTS, pick)) for pick in (low, high)
            )
    return matrix


def _sums(builder: ir.IRBuilder, *rows: Any) -> Any:
    """Lane i: the sum of row i, in a fixed order."""
    level, size = list(rows), 1
    while len(level) > 1:
        low = [j if not j & size else WIDTH + j - size for j in range(WIDTH)]
        high = [j + size if not j & size else WIDTH + j for j in range(WIDTH)]
        level = [
            builder.fadd(*(builder.shuffle_vector(a, b, ir.Constant(INTS, pick)) for pick in (low, high)))
            for a, b in zip(level[::2], level[1::2], strict=True)
        ]
        size *= 2
    return level[0]


def _pure(result: Any, kinds: tuple[Any, ...], build: Callable[..., Any], doc: str) -> Any:
    """An intrinsic that touches no memory."""
    kind = result(*kinds)

    def code(context: Any, builder: ir.IRBuilder, signature: Any, args: Any) -> Any:
        return build(builder, *args)

    makers: dict[int, Callable[..., Any]] = {
        1: lambda typing, a: (kind, code),
        2: lambda typing, a, b: (kind, code),
        3: lambda typing, a, b, c: (kind, code),
        8: lambda typing, a, b, c, d, e, f, g, h: (kind, code),
    }
    maker = makers[len(kinds)]
    maker.__doc__ = doc
    return intrinsic(maker)


fma = _pure(lanes, (lanes,) * 3, lambda b, *v: _call(b, "fmuladd", *v), "x y + z, rounded once where the machine can.")
least = _pure(lanes, (lanes,) * 2, _smaller, "The smaller of two; the second where one is not a number.")
greatest = _pure(
    lanes,
    (lanes,) * 2,
    lambda b, x, y: b.select(b.fcmp_ordered(">", x, y), x, y),
    "The larger of two; the second where one is not a number.",
)
root = _pure(lanes, (lanes,), lambda b, x: _call(b, "sqrt", x), "Square root.")
floor = _pure(lanes, (lanes,), lambda b, x: _call(b, "floor", x), "Largest integer that is not above.")
exp2_minus = _pure(
    lanes, (lanes,), _exp2_minus, "2^-e for |e| <= 120, within 1.5 ulp, exactly 1 at 0. Elsewhere any bits: mask them."
)
log2 = _pure(
    lanes, (lanes,), _log2, "log2 of normal positive numbers, within 2 ulp of the larger of it and 1, exactly 0 at 1."
)
minus_magnitude = _pure(lanes, (lanes,), _minus_magnitude, "-|a|.")
all_negative = _pure(types.boolean, (lanes,), _all_negative, "Whether every lane has its sign bit set.")
packed = _pure(lanes, (lanes,) * 2, _packed, "Bits of two integers of 0..32767: the first in the low half.")
sums = _pure(lanes, (lanes,) * 8, _sums, "Lane i is the sum of the lanes of argument i.")
choose = _pure(
    lanes,
    (mask, lanes, lanes),
    lambda b, k, x, y: b.select(k, x, y),
    "Lanes of the first where the condition holds, else of the second.",
)
both = _pure(mask, (mask,) * 2, lambda b, x, y: b.and_(x, y), "Where both conditions hold.")
some = _pure(
    types.boolean,
    (mask,),
    lambda b, k: b.icmp_unsigned("!=", b.bitcast(k, ir.IntType(WIDTH)), ir.Constant(ir.IntType(WIDTH), 0)),
    "Whether the condition holds in any lane.",
)
count = _pure(
    types.int64,
    (mask,),
    lambda b, k: b.zext(b.ctpop(b.bitcast(k, ir.IntType(WIDTH))), LONG),
    "In how many lanes the condition holds.",
)
lowest = _pure(
    types.intp,
    (types.uint64,),
    lambda b, x: b.cttz(x, ir.Constant(BIT, 1)),
    "Index of the lowest set bit of a number that is not 0.",
)


def _operator(symbol: Any, result: Any, build: Callable[[ir.IRBuilder, Any, Any], Any]) -> None:
    """Give two lanes a Python operator."""

    class Template(ConcreteTemplate):
        cases: ClassVar = [signature(result, lanes, lanes)]

    infer_global(symbol)(Template)

    @lower_builtin(symbol, lanes, lanes)
    def lower(context: Any, builder: ir.IRBuilder, signature: Any, args: Any) -> Any:
        return build(builder, *args)


_operator(operator.add, lanes, lambda b, x, y: b.fadd(x, y))
_operator(operator.sub, lanes, lambda b, x, y: b.fsub(x, y))
_operator(operator.mul, lanes, lambda b, x, y: b.fmul(x, y))
_operator(operator.truediv, lanes, lambda b, x, y: b.fdiv(x, y))
_operator(operator.gt, mask, lambda b, x, y: b.fcmp_ordered(">", x, y))
_operator(operator.ge, mask, lambda b, x, y: b.fcmp_ordered(">=", x, y))
_operator(operator.le, mask, lambda b, x, y: b.fcmp_ordered("<=", x, y))
_operator(operator.lt, mask, lambda b, x, y: b.fcmp_ordered("<", x, y))
_operator(operator.ne, mask, lambda b, x, y: b.fcmp_unordered("!=", x, y))
_operator(operator.eq, mask, lambda b, x, y: b.fcmp_ordered("==", x, y))


@intrinsic
def splat(typing: Any, value: Any) -> Any:
    """All lanes = value, rounded to float32."""

    def code(context: Any, builder: ir.IRBuilder, signature: Any, args: Any) -> Any:
        return _splat(builder, context.cast(builder, args[0], signature.args[0], types.float32))

    return lanes(value), code


def _pointer(context: Any, builder: ir.IRBuilder, kind: Any, array: Any, index: Any) -> Any:
    return builder.gep(context.make_array(kind)(context, builder, array).data, [index])


def _vector_pointer(context: Any, builder: ir.IRBuilder, kind: Any, array: Any, index: Any) -> Any:
    return builder.bitcast(_pointer(context, builder, kind, array, index), VECTOR.as_pointer())


@intrinsic
def spread(typing: Any, array: Any, index: Any) -> Any:
    """All lanes = array[index]."""

    def code(context: Any, builder: ir.IRBuilder, signature: Any, args: Any) -> Any:
        return _splat(builder, builder.load(_pointer(context, builder, signature.args[0], *args)))

    return lanes(array, types.intp), code


@intrinsic
def load(typing: Any, array: Any, index: Any) -> Any:
    """array[index : index + WIDTH] of a contiguous float32 array."""

    def code(context: Any, builder: ir.IRBuilder, signature: Any, args: Any) -> Any:
        return builder.load(_vector_pointer(context, builder, signature.args[0], *args), align=4)

    return lanes(array, types.intp), code


@intrinsic
def store(typing: Any, array: Any, index: Any, value: Any) -> Any:
    """array[index : index + WIDTH] = value."""

    def code(context: Any, builder: ir.IRBuilder, signature: Any, args: Any) -> Any:
        builder.store(args[2], _vector_pointer(context, builder, signature.args[0], *args[:2]), align=4)
        return context.get_dummy_value()

    return types.none(array, types.intp, lanes), code


@intrinsic
def gather(typing: Any, array: Any, index: Any, stride: Any) -> Any:
    """array[index], array[index + stride], ..."""

    def code(context: Any, builder: ir.IRBuilder, signature: Any, args: Any) -> Any:
        value = ir.Constant(VECTOR, ir.Undefined)
        for i in range(WIDTH):
            at = builder.add(args[1], builder.mul(args[2], ir.Constant(LONG, i)))
            value = builder.insert_element(
                value, builder.load(_pointer(context, builder, signature.args[0], args[0], at)), ir.Constant(INT, i)
            )
        return value

    return lanes(array, types.intp, types.intp), code


@intrinsic
def scatter(typing: Any, array: Any, index: Any, stride: Any, value: Any) -> Any:
    """array[index], array[index + stride], ... = value."""

    def code(context: Any, builder: ir.IRBuilder, signature: Any, args: Any) -> Any:
        for i in range(WIDTH):
            at = builder.add(args[1], builder.mul(args[2], ir.Constant(LONG, i)))
            builder.store(
                builder.extract_element(args[3], ir.Constant(INT, i)),
                _pointer(context, builder, signature.args[0], args[0], at),
            )
        return context.get_dummy_value()

    return types.none(array, types.intp, types.intp, lanes), code


@intrinsic
def store_rows(
    typing: Any, array: Any, index: Any, stride: Any, a: Any, b: Any, c: Any, d: Any, e: Any, f: Any, g: Any, h: Any
) -> Any:
    """array[index + i stride + j] = lane i of column j, for 8 rows of 8 columns."""

    def code(context: Any, builder: ir.IRBuilder, signature: Any, args: Any) -> Any:
        for i, row in enumerate(_transposed(builder, *args[3:])):
            at = builder.add(args[1], builder.mul(args[2], ir.Constant(LONG, i)))
            builder.store(row, _vector_pointer(context, builder, signature.args[0], args[0], at), align=4)
        return context.get_dummy_value()

    return types.none(array, types.intp, types.intp, *[lanes] * 8), code


@intrinsic
def load_rows(typing: Any, array: Any, index: Any, stride: Any) -> Any:
    """Eight lanes: column j of 8 rows of 8, array[index + i stride + j]."""
    kind = types.UniTuple(lanes, WIDTH)

    def code(context: Any, builder: ir.IRBuilder, signature: Any, args: Any) -> Any:
        places = [builder.add(args[1], builder.mul(args[2], ir.Constant(LONG, i))) for i in range(WIDTH)]
        rows = [
            builder.load(_vector_pointer(context, builder, signature.args[0], args[0], at), align=4) for at in places
        ]
        return context.make_tuple(builder, kind, _transposed(builder, *rows))

    return kind(array, types.intp, types.intp), code


@intrinsic
def prefetch(typing: Any, array: Any, index: Any) -> Any:
    """Ask for the cache line of array[index]."""

    def code(context: Any, builder: ir.IRBuilder, signature: Any, args: Any) -> Any:
        byte = ir.IntType(8).as_pointer()
        function = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(ir.VoidType(), [byte, INT, INT, INT]), "llvm.prefetch.p0i8"
        )
        flags = [ir.Constant(INT, n) for n in (0, 3, 1)]
        builder.call(function, [builder.bitcast(_pointer(context, builder, signature.args[0], *args), byte), *flags])
        return context.get_dummy_value()

    return types.none(array, types.intp), code
