"""LLVM instructions that Numba does not offer: one name each, in one place.

`multiply_and_add` and `tiles` fix the rounding of every product, so all processors give the same bits. `control_word`
makes the processor take subnormal numbers for zero. The others save time: docs/decisions.md says how much.
"""

from __future__ import annotations

import platform
from typing import Any

import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic
from numba.np.arrayobj import populate_array

lowered: Any = intrinsic  # to LLVM's own instructions

ROWS, LANES, SIZE = 6, 16, 4  # of a large tile; bytes of a number
X86 = platform.machine().lower() in ("x86_64", "amd64")
ZEROED = np.uint32(0x8040)  # bits of its control word: subnormal numbers, read or computed, are zero


@lowered
def borrow(_, group):  # type: ignore[no-untyped-def]
    """Return a tuple with its arrays as views that count no references.

    The count is an atomic operation, for which a core waits until all memory that it has asked for is there;
    there would be hundreds per agent. Only for arguments of a kernel, which its caller keeps alive, and for arrays of
    its own with `keep_alive` at its end.
    """

    def without(context, builder, _, args):  # type: ignore[no-untyped-def]
        found = args[0]
        for i, kind in enumerate(group.types):
            if isinstance(kind, types.Array):
                array = context.make_array(kind)(context, builder, builder.extract_value(found, i))
                array.meminfo = cgutils.get_null_value(array.meminfo.type)
                found = builder.insert_value(found, array._getvalue(), i)
        return found

    return group(group), without


@lowered
def replace_last(_, group, numbers):  # type: ignore[no-untyped-def]
    """Return a tuple whose last elements are those of the tuple `numbers`, of the same types."""

    def replace(_, builder, __, args):  # type: ignore[no-untyped-def]
        found, start = args[0], len(group.types) - len(numbers)
        for i in range(len(numbers)):
            found = builder.insert_value(found, builder.extract_value(args[1], i), start + i)
        return found

    return group(group, numbers), replace


@lowered
def keep_alive(_, group):  # type: ignore[no-untyped-def]
    """Do nothing; the arrays of a tuple live until here, and views of them that count no references are valid."""

    def nothing(context, _builder, _, _args):  # type: ignore[no-untyped-def]
        return context.get_dummy_value()

    return types.void(group), nothing


@lowered
def fetch(_, array, index):  # type: ignore[no-untyped-def]
    """Ask for array[index] to be brought into the cache, without waiting for it."""

    def ask(context, builder, signature, args):  # type: ignore[no-untyped-def]
        here = context.make_array(signature.args[0])(context, builder, args[0])
        at = builder.bitcast(builder.gep(here.data, [args[1]]), cgutils.voidptr_t)
        number = ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [cgutils.voidptr_t, number, number, number])
        known = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0i8")
        builder.call(known, [at, number(0), number(2), number(1)])  # to read, into the second level, data
        return context.get_dummy_value()

    return types.void(array, index), ask


@lowered
def matrix(_, flat, start, rows, columns):  # type: ignore[no-untyped-def]
    """Return what a flat array holds from `start` on as (rows, columns), a view that counts no references.

    A reshape would first call a function that finds out whether it is possible. Only for arrays that someone else
    keeps alive: an array made in the same function is gone after its last use there, whatever views there are.
    """

    def view(context, builder, signature, args):  # type: ignore[no-untyped-def]
        source = context.make_array(signature.args[0])(context, builder, args[0])
        found = context.make_array(signature.return_type)(context, builder)
        size = source.itemsize
        populate_array(
            found,
            data=builder.gep(source.data, [args[1]]),
            shape=(args[2], args[3]),
            strides=(builder.mul(args[3], size), size),
            itemsize=size,
            meminfo=None,
        )
        return found._getvalue()

    whole = (types.unliteral(number) for number in (start, rows, columns))
    return types.Array(flat.dtype, 2, "C")(flat, *whole), view


@lowered
def control_word(_):  # type: ignore[no-untyped-def]
    """Return the control word of this thread's floating-point unit, 0 where it need not be changed."""

    def read(_context, builder, _, _args):  # type: ignore[no-untyped-def]
        return _transfer(builder, "llvm.x86.sse.stmxcsr") if X86 else ir.IntType(32)(0)

    return types.uint32(), read


@lowered
def set_control_word(_, _word):  # type: ignore[no-untyped-def]
    """Set the control word of this thread's floating-point unit, where there is one to be changed."""

    def write(context, builder, _, args):  # type: ignore[no-untyped-def]
        if X86:
            _transfer(builder, "llvm.x86.sse.ldmxcsr", args[0])
        return context.get_dummy_value()

    return types.void(types.uint32), write


def _transfer(builder: Any, instruction: str, word: Any = None) -> Any:
    """Emit an instruction that moves the control word from or to memory; return what lies there then."""
    place = cgutils.alloca_once(builder, ir.IntType(32))
    if word is not None:
        builder.store(word, place)
    kind = ir.FunctionType(ir.VoidType(), [cgutils.voidptr_t])
    move = cgutils.get_or_insert_function(builder.module, kind, instruction)
    builder.call(move, [builder.bitcast(place, cgutils.voidptr_t)])
    return builder.load(place)


@lowered
def multiply_and_add(_, a, b, c):  # type: ignore[no-untyped-def]
    """Return a b + c, rounded once, for float32: the same on every processor."""

    def multiply_add(_context, builder, _, args):  # type: ignore[no-untyped-def]
        return _fma(builder, *args)

    return types.float32(types.float32, types.float32, types.float32), multiply_add


def _fma(builder: Any, a: Any, b: Any, c: Any) -> Any:
    """Emit a b + c of numbers or vectors, rounded once."""
    kind = c.type
    name = f"llvm.fma.v{kind.count}f32" if isinstance(kind, ir.VectorType) else "llvm.fma.f32"
    function = cgutils.get_or_insert_function(builder.module, ir.FunctionType(kind, [kind] * 3), name)
    return builder.call(function, [a, b, c])


def strips(rows):  # type: ignore[no-untyped-def]
    """Return a function that fills `rows` rows of a product of matrices."""

    @lowered
    def strip(_, a, b, out, row):  # type: ignore[no-untyped-def]
        """Fill the rows of out (R, C) from `row` on with a (R, K) times b (K, C); rows of b and out are without gaps.

        Every element is a chain of fused multiplications and additions in the order of K, however wide the tile that
        it is computed in: so the result depends neither on the width of vectors nor on where a tile begins.
        """

        def fill(context, builder, signature, args):  # type: ignore[no-untyped-def]
            a_, b_, out_ = (context.make_array(signature.args[i])(context, builder, args[i]) for i in range(3))
            whole, number, byte = args[3].type, ir.FloatType(), ir.IntType(8)
            a_row, a_column = cgutils.unpack_tuple(builder, a_.strides, 2)
            b_row, _ = cgutils.unpack_tuple(builder, b_.strides, 2)
            out_row, _ = cgutils.unpack_tuple(builder, out_.strides, 2)
            _, depth = cgutils.unpack_tuple(builder, a_.shape, 2)
            _, columns = cgutils.unpack_tuple(builder, out_.shape, 2)

            def at(data, *offsets):  # type: ignore[no-untyped-def]
                pointer = builder.bitcast(data, byte.as_pointer())
                for index, stride in offsets:
                    index = ir.Constant(whole, index) if isinstance(index, int) else index
                    pointer = builder.gep(pointer, [builder.mul(index, stride)])
                return pointer

            def tile(column, lanes):  # type: ignore[no-untyped-def]
                kind = ir.VectorType(number, lanes) if lanes > 1 else number
                along = column, ir.Constant(whole, SIZE)
                sums = [cgutils.alloca_once_value(builder, ir.Constant(kind, None)) for _ in range(rows)]
                with cgutils.for_range(builder, depth, intp=whole) as loop:
                    many = at(b_.data, (loop.index, b_row), along)
                    many = builder.load(builder.bitcast(many, kind.as_pointer()), align=SIZE)
                    for i, total in enumerate(sums):
                        one = at(a_.data, (args[3], a_row), (i, a_row), (loop.index, a_column))
                        one = builder.load(builder.bitcast(one, number.as_pointer()), align=SIZE)
                        if lanes > 1:
                            nothing = ir.Constant(kind, ir.Undefined)
                            one = builder.insert_element(nothing, one, ir.Constant(ir.IntType(32), 0))
                            one = builder.shuffle_vector(
                                one, nothing, ir.Constant(ir.VectorType(ir.IntType(32), lanes), None)
                            )
                        builder.store(_fma(builder, one, many, builder.load(total)), total)
                for i, total in enumerate(sums):
                    place = at(out_.data, (args[3], out_row), (i, out_row), along)
                    builder.store(builder.load(total), builder.bitcast(place, kind.as_pointer()), align=SIZE)

            done = ir.Constant(whole, 0)
            for lanes in (LANES, 4, 1):
                width = ir.Constant(whole, lanes)
                count = builder.udiv(builder.sub(columns, done), width)
                with cgutils.for_range(builder, count, intp=whole) as loop:
                    tile(builder.add(done, builder.mul(loop.index, width)), lanes)
                done = builder.add(done, builder.mul(count, width))
            return context.get_dummy_value()

        return types.void(a, b, out, types.intp), fill

    return strip


strip_of_rows, strip_of_one = strips(ROWS), strips(1)


@lowered
def dot(_, a, b):  # type: ignore[no-untyped-def]
    """Return the product of two rows (k,) without gaps, k a multiple of 16: 16 chains, added as a tree."""

    def work(context, builder, signature, args):  # type: ignore[no-untyped-def]
        a_, b_ = (context.make_array(signature.args[i])(context, builder, args[i]) for i in range(2))
        vector = ir.VectorType(ir.FloatType(), LANES)
        (length,) = cgutils.unpack_tuple(builder, a_.shape, 1)
        total = cgutils.alloca_once_value(builder, ir.Constant(vector, None))
        blocks = builder.udiv(length, ir.Constant(length.type, LANES))
        with cgutils.for_range(builder, blocks, intp=length.type) as loop:
            at = builder.mul(loop.index, ir.Constant(length.type, LANES))
            left, right = (
                builder.load(builder.bitcast(builder.gep(each.data, [at]), vector.as_pointer()), align=4)
                for each in (a_, b_)
            )
            builder.store(_fma(builder, left, right, builder.load(total)), total)
        sums, width = builder.load(total), LANES
        while width > 1:
            width //= 2
            halves = [
                builder.shuffle_vector(
                    sums, sums, ir.Constant(ir.VectorType(ir.IntType(32), width), list(range(start, start + width)))
                )
                for start in (0, width)
            ]
            sums = builder.fadd(*halves)
        return builder.extract_element(sums, ir.Constant(ir.IntType(32), 0))

    return types.float32(a, b), work
