"""Explicit SIMD vector of 16 floats for Numba.

LLVM's auto-vectorizer produces code that is 3 to 6 times slower for loops over lanes, and does not vectorize
reductions at all; here, each operator on `Vec` values is one vector instruction (or two, or four). Available
inside `@njit` code: `pointer`, `load`, `store`, `splat`, the operators + - * /, `vmin`, `vmax`, `vabs`,
`vsqrt`, `fma`, `vround`, `select_lt`, `any_lt`, `mask_lt`, `hmin`, `hmax`, `pick`.
"""

# pyright: reportCallIssue=false
# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.
from __future__ import annotations

import operator

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, models, overload, register_model

L = 16
"""Lanes. 16 was the best on AVX-512 and on AVX2 (8 within 5 %, 32 worse)."""

_FLOAT = ir.FloatType()
_VEC = ir.VectorType(_FLOAT, L)
_FASTMATH = ("nnan", "ninf", "nsz", "arcp", "contract", "afn", "reassoc")


class VecType(types.Type):
    """Numba type of a SIMD vector that has `L` float32 numbers."""

    def __init__(self) -> None:
        super().__init__(name=f"Vec{L}f")


vec = VecType()


@register_model(VecType)
class _VecModel(models.PrimitiveModel):
    def __init__(self, dmm, fe_type):
        super().__init__(dmm, fe_type, _VEC)


class PointerType(types.Type):
    """Numba type of a bare pointer to numbers, without length or ownership, for SIMD code.

    Numba counts the references of an array with atomic instructions whenever a function receives the array;
    in the kernel, this cost more time than the arithmetic. A pointer supports only `p[i]`: the caller of
    `pointer(array)` must keep the array alive.
    """

    def __init__(self, dtype: types.Type) -> None:
        self.dtype = dtype
        super().__init__(name=f"Pointer({dtype})")


@register_model(PointerType)
class _PointerModel(models.PrimitiveModel):
    def __init__(self, dmm, fe_type):
        super().__init__(dmm, fe_type, dmm.lookup(fe_type.dtype).get_data_type().as_pointer())


@intrinsic
def pointer(typingctx, array):
    """Return a pointer to the first element of a contiguous array, for Numba SIMD code."""

    def codegen(context, builder, signature, args):
        return context.make_array(signature.args[0])(context, builder, args[0]).data

    return PointerType(array.dtype)(array), codegen


@intrinsic
def at_address(typingctx, dtype, address):
    """Convert a memory address (int64) to a pointer with a given element type, for Numba SIMD code."""
    kind = dtype.instance_type

    def codegen(context, builder, signature, args):
        return builder.inttoptr(args[1], context.get_data_type(kind).as_pointer())

    return PointerType(kind)(dtype, types.int64), codegen


@intrinsic
def call(typingctx, function, a, b, c):
    """Call a compiled function at a memory address, as a Numba intrinsic for SIMD kernels. The function takes
    three int64 and returns one.
    """

    def codegen(context, builder, signature, args):
        number = ir.IntType(64)
        kind = ir.FunctionType(number, [number] * 3).as_pointer()
        return builder.call(builder.inttoptr(args[0], kind), args[1:])

    return types.int64(types.int64, types.int64, types.int64, types.int64), codegen


@intrinsic
def _get(typingctx, at, index):
    # Widen short integers; otherwise every function would be compiled for int32 and int64 arguments.
    wide = types.int64 if isinstance(at.dtype, types.Integer) else at.dtype

    def codegen(context, builder, signature, args):
        return context.cast(builder, builder.load(builder.gep(args[0], [args[1]])), at.dtype, wide)

    return wide(at, types.intp), codegen


@intrinsic
def _set(typingctx, at, index, value):
    def codegen(context, builder, signature, args):
        builder.store(args[2], builder.gep(args[0], [args[1]]))
        return context.get_dummy_value()

    return types.void(at, types.intp, at.dtype), codegen


@overload(operator.getitem)
def _getitem(at, index):
    if isinstance(at, PointerType):
        return lambda at, index: _get(at, index)
    return None


@overload(operator.setitem)
def _setitem(at, index, value):
    if isinstance(at, PointerType):
        return lambda at, index, value: _set(at, index, value)
    return None


@intrinsic
def load(typingctx, at, index):
    """Load a SIMD vector of `L` floats from a float32 pointer, starting at `index`."""

    def codegen(context, builder, signature, args):
        value = builder.load(builder.bitcast(builder.gep(args[0], [args[1]]), _VEC.as_pointer()))
        value.align = 4
        return value

    return vec(at, types.intp), codegen


@intrinsic
def store(typingctx, at, index, value):
    """Store a SIMD vector of `L` floats to a float32 pointer, starting at `index`."""

    def codegen(context, builder, signature, args):
        target = builder.bitcast(builder.gep(args[0], [args[1]]), _VEC.as_pointer())
        builder.store(args[2], target, align=4)
        return context.get_dummy_value()

    return types.void(at, types.intp, vec), codegen


@intrinsic
def splat(typingctx, value):
    """Return a SIMD vector that has the same number in every lane."""

    def codegen(context, builder, signature, args):
        number = context.cast(builder, args[0], signature.args[0], types.float32)
        one = builder.insert_element(ir.Constant(_VEC, ir.Undefined), number, ir.Constant(ir.IntType(32), 0))
        zeros = ir.Constant(ir.VectorType(ir.IntType(32), L), [0] * L)
        return builder.shuffle_vector(one, ir.Constant(_VEC, ir.Undefined), zeros)

    return vec(value), codegen


@intrinsic
def iota(typingctx):
    """Return a SIMD vector that holds the lane numbers 0, 1, 2, ..."""

    def codegen(context, builder, signature, args):
        return ir.Constant(_VEC, [float(k) for k in range(L)])

    return vec(), codegen


def _binary(instruction):
    @intrinsic
    def op(typingctx, a, b):
        def codegen(context, builder, signature, args):
            return getattr(builder, instruction)(args[0], args[1], flags=_FASTMATH)

        return vec(vec, vec), codegen

    return op


_add, _sub, _mul, _div = (_binary(name) for name in ("fadd", "fsub", "fmul", "fdiv"))


def _overload(function, implementation):
    @overload(function)
    def generic(a, b):
        if isinstance(a, VecType) and isinstance(b, VecType):
            return lambda a, b: implementation(a, b)
        return None


for _function, _implementation in (
    (operator.add, _add),
    (operator.sub, _sub),
    (operator.mul, _mul),
    (operator.truediv, _div),
):
    _overload(_function, _implementation)


@overload(operator.neg)
def _negate(a):
    if isinstance(a, VecType):
        return lambda a: splat(0.0) - a
    return None


def _compare(builder, a, b):
    return builder.fcmp_ordered("<", a, b)


@intrinsic
def vmin(typingctx, a, b):
    """Return the lane-wise minimum of two SIMD vectors."""

    def codegen(context, builder, signature, args):
        return builder.select(_compare(builder, args[0], args[1]), args[0], args[1])

    return vec(vec, vec), codegen


@intrinsic
def vmax(typingctx, a, b):
    """Return the lane-wise maximum of two SIMD vectors."""

    def codegen(context, builder, signature, args):
        return builder.select(_compare(builder, args[0], args[1]), args[1], args[0])

    return vec(vec, vec), codegen


@intrinsic
def select_lt(typingctx, a, b, x, y):
    """Select `x` or `y` in each lane of SIMD vectors: the result is `x if a < b else y`."""

    def codegen(context, builder, signature, args):
        return builder.select(_compare(builder, args[0], args[1]), args[2], args[3])

    return vec(vec, vec, vec, vec), codegen


def _bits(builder, a, b):
    return builder.bitcast(_compare(builder, a, b), ir.IntType(L))


@intrinsic
def any_lt(typingctx, a, b):
    """Return whether `a < b` holds in any lane of two SIMD vectors."""

    def codegen(context, builder, signature, args):
        bits = _bits(builder, args[0], args[1])
        return builder.icmp_unsigned("!=", bits, ir.Constant(bits.type, 0))

    return types.boolean(vec, vec), codegen


@intrinsic
def mask_lt(typingctx, a, b):
    """Compare two SIMD vectors. Return an integer in which bit k is set if `a < b` in lane k."""

    def codegen(context, builder, signature, args):
        return builder.zext(_bits(builder, args[0], args[1]), ir.IntType(64))

    return types.int64(vec, vec), codegen


def _unary(name):
    @intrinsic
    def op(typingctx, a):
        def codegen(context, builder, signature, args):
            function = cgutils.get_or_insert_function(
                builder.module, ir.FunctionType(_VEC, [_VEC]), f"{name}.v{L}f32"
            )
            return builder.call(function, args)

        return vec(vec), codegen

    return op


vabs, vsqrt, vround = _unary("llvm.fabs"), _unary("llvm.sqrt"), _unary("llvm.rint")


@intrinsic
def fma(typingctx, a, b, c):
    """Return the SIMD vector `a * b + c` with a single rounding (fused multiply-add)."""

    def codegen(context, builder, signature, args):
        function = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(_VEC, [_VEC] * 3), f"llvm.fma.v{L}f32"
        )
        return builder.call(function, args)

    return vec(vec, vec, vec), codegen


def _reduction(name):
    @intrinsic
    def op(typingctx, a):
        def codegen(context, builder, signature, args):
            function = cgutils.get_or_insert_function(
                builder.module, ir.FunctionType(_FLOAT, [_VEC]), f"llvm.vector.reduce.{name}.v{L}f32"
            )
            return builder.call(function, args, fastmath=_FASTMATH)

        return types.float32(vec), codegen

    return op


hmin, hmax = _reduction("fmin"), _reduction("fmax")


@intrinsic
def pick(typingctx, a, lane):
    """Return the number in a given lane of a SIMD vector."""

    def codegen(context, builder, signature, args):
        return builder.extract_element(args[0], builder.trunc(args[1], ir.IntType(32)))

    return types.float32(vec, types.int64), codegen


@intrinsic
def trailing_zeros(typingctx, mask):
    """Return the index of the lowest set bit of a nonzero int64, which is the first lane in a SIMD mask."""

    def codegen(context, builder, signature, args):
        return builder.cttz(args[0], ir.Constant(ir.IntType(1), 1))

    return types.int64(types.int64), codegen
