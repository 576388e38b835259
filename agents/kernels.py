"""Compiled kernels of the f/J learner: scores, losses, gradients and Adam, one agent after another.

Every agent's weights lie in one row, and all that an update needs of them is done while the row is in
the cache. An agent's numbers depend on no other's, so any split of the agents over threads gives
the same result. Gradients are written out by hand; tests compare them with automatic ones.

Shapes: n agents, b states, D components of zeta, M movements, I inputs, H hidden units, C place cells.
"""

from __future__ import annotations

import math
import platform
from typing import Any, NamedTuple

import numba
import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic
from numba.np.arrayobj import populate_array

from ecology import elementary
from ecology.compiler_cache import use_cache
from ecology.elementary import cosine_and_sine, power

use_cache(__file__, elementary.__file__)

F = np.float32
ZERO, HALF, ONE, TWO = F(0), F(0.5), F(1), F(2)
BIAS, LOG2E, LN2_HIGH, LN2_LOW = F(127), F(1.44269504), F(0.693359375), F(-2.12194440e-4)
E6, E5, E4 = F(1.9875691500e-4), F(1.3981999507e-3), F(8.3334519073e-3)  # exp, after Cephes' expf
E3, E2, E1 = F(4.1665795894e-2), F(1.6666665459e-1), F(5.0000001201e-1)
BETA1, BETA2, TINY = F(0.9), F(0.999), F(1e-8)  # of Adam
FAR = F(-30.0)  # exponent of a place cell below which it is silent; keeps subnormal numbers out
FEW = 2  # rows up to which gradients are worked out on the way of Adam, without matrices of their own
LINE = 16  # numbers in a line of the cache
SOON = 512  # numbers by which Adam's moments are asked for ahead of their use
X86 = platform.machine().lower() in ("x86_64", "amd64")
ZEROED = np.uint32(0x8040)  # bits of its control word: subnormal numbers, read or computed, are zero
LONGEST = F(300.0)  # units of time, of a predicted duration
TURN = F(2 * math.pi)
PRIOR = F(0.3)  # weight of "no error" among the remembered errors of f
FADING = F(2000.0)  # units of time, over which a remembered error fades
STALE = F(1e-4)  # squared distance by which a decision counts as farther per decision since

Array = Any  # of NumPy, or as another device holds it

FLAGS: dict[str, Any] = {"nogil": True, "cache": True, "error_model": "numpy", "no_cfunc_wrapper": True}
# no fast mathematics: every operation is rounded as it is written, so all processors give the same bits
compiled = numba.njit(**FLAGS)  # called by Python, which takes long to compile where arguments are tuples of arrays
within = numba.njit(**FLAGS, no_cpython_wrapper=True)  # type: ignore[call-overload]  # called by other kernels alone
lowered: Any = intrinsic  # to LLVM's own instructions


class Senses(NamedTuple):
    """What all agents of one learner share: how zeta becomes inputs and drive, and the equation's constants."""

    centre: Array  # (D,)
    inverse: Array  # (D,) 1 / scale
    scale: Array  # (D,)
    low: Array  # (D,)
    high: Array  # (D,)
    unit: Array  # (D + 1,) of f's outputs
    plain: Array  # int, components that are inputs as they are
    angle: Array  # int, components that are inputs by cosine and sine
    place: Array  # int (2,)
    need: Array  # bool (D,)
    deprivable: Array  # int, needs that can be deprived
    mix_from: Array  # int: |zeta mix|^2 of the drive, entry by entry
    mix_to: Array
    mix_weight: Array
    felt: Array  # (D,)
    epsilon: np.float32  # of the drive
    exponent: np.float32
    root: np.float32  # exponent / power
    power: np.float32  # n of the drive
    above: Array  # (D,) factor of what lies above its set point
    bent: bool  # whether power or any factor is another than the paper's, 2 and 1
    sharp: np.float32  # 1 / width^2 of a place cell
    log_gamma: np.float32
    dt: np.float32
    centre_j: np.float32  # Jn = centre_j + spread_j x output
    spread_j: np.float32
    ceiling: np.float32  # of targets of Jn
    weight_top: np.float32  # of the relative loss weight, 0: none
    weight_floor: np.float32
    deprived: np.float32  # imagined deviations lie between these, times the scale
    sated: np.float32
    width: int  # H
    movements: int  # M
    finite: bool  # the score over a whole movement
    minimum: bool  # the min in L_J
    polyak: np.float32  # share by which the slow copy of J follows it per update
    anchored: bool  # J is the drive plus what the network says
    slow: bool  # whether there is a target network
    lazy: bool  # heads of f that no decision of the batch trains rest
    where: Array  # int (W,) components of zeta that say where the agent is: neither needs nor what is felt
    nearness: Array  # (W,) 1 / sd of each in the kernel by which states are alike
    turning: Array  # bool (W,) which of them are angles
    length: Array  # (M,) ordinary length of a movement in ticks
    explored: np.float32  # share of exploration that the target of J assumes
    depth: int  # movements that a decision looks ahead
    beam: int  # predicted states kept per depth
    searched: int  # newest decisions among which the one nearest to a predicted state is looked up


class Brains(NamedTuple):
    """What the n agents have become: a row of weights each."""

    f: Array  # (n, P) w1 (I, H), b1, w2 (H, H), b2, w3 (M (D + 1), H), b3
    f_first: Array  # Adam's moments
    f_second: Array
    f_steps: Array  # int (n, 1 + M) of the hidden layers, and of every head
    J: Array  # (n, Q) the same with one output
    J_first: Array
    J_second: Array
    J_steps: Array  # int (n, 2)
    target: Array  # (n, Q) J itself without a target network
    cell_centre: Array  # (n, 2, C)
    cell_count: Array  # int (n,)
    hope: Array  # (n, 2) by which J of unknown places is taken to be lower: a share of it, and drive units
    marks: Array  # (n, 2, K) places visited or aimed at
    marked: Array  # int (n,) how many


class Ring(NamedTuple):
    """The memory of decisions, see `agents.memory`."""

    zeta: Array
    after: Array
    duration: Array
    movement: Array
    open: Array
    lived: Array  # (n,) decisions so far


class Trace(NamedTuple):
    """The working memory of the latest errors of f: a ring per agent of L decisions."""

    where: Array  # (n, L, W) where the decision was made
    movement: Array  # int16 (n, L)
    error: Array  # (n, L, D + 1) true change and duration, less what f predicted
    time: Array  # (n, L) age of the agent at the decision, units of time
    count: Array  # int (n,) decisions so far


class Draws(NamedTuple):
    """How a batch is drawn, and the random numbers for it."""

    uniform: Array  # (n, >= batch + batch_f + m D + m + m // 2)
    normal: Array  # (n, m // 2, D)
    batch: int
    batch_f: int
    recent: int
    late: int  # of the batch on J, those from the `recent` decisions
    late_f: int
    imagined: int  # m, of the batch on J, those whose needs are redrawn


class Batch(NamedTuple):
    """Room for what an update draws from memory, and for its gradients, for one agent at a time."""

    g_f: np.ndarray  # (P,)
    g_j: np.ndarray  # (Q,)
    at: np.ndarray  # int (b,)
    at_f: np.ndarray  # int (b',)
    zeta_f: np.ndarray  # (b', D)
    after_f: np.ndarray  # (b', D)
    time_f: np.ndarray  # (b',)
    done_f: np.ndarray  # int (b',)
    zeta: np.ndarray  # (b, D)
    pace: np.ndarray  # (b, D)
    done: np.ndarray  # int (b,)
    open: np.ndarray  # bool (b, M)
    table: np.ndarray  # (b, M)
    goal: np.ndarray  # (b,)
    trained: np.ndarray  # bool (M,) heads of f that are moved


class Ahead(NamedTuple):
    """What will be decided on next, scored in the pass of an update, while weights are in the cache."""

    zeta: np.ndarray  # (n, D)
    open: np.ndarray  # bool (n, M); nothing is open where nothing is to be decided
    score: np.ndarray  # (n, M)


class Beam(NamedTuple):
    """Room for a lookahead: B states to look ahead from, and their B M successors."""

    state: np.ndarray  # (B, D)
    cost: np.ndarray  # (B,) discounted drive on the way here
    keep: np.ndarray  # (B,) discount here
    root: np.ndarray  # int (B,) first movement on the way here
    open: np.ndarray  # bool (B, M)
    next_state: np.ndarray  # (B M, D)
    next_cost: np.ndarray
    next_keep: np.ndarray
    next_root: np.ndarray
    score: np.ndarray  # (B M,)
    taken: np.ndarray  # bool (B M,)
    bias: np.ndarray  # (M, D + 1) correction of f
    support: np.ndarray  # (M,) weight of the errors behind it


class Way(NamedTuple):
    """The movements under way."""

    movement: Array  # int (n,), -1: none
    stage: Array  # int (n,)
    left: Array  # int (n,) ticks of the stage that are left
    elapsed: Array  # int (n,) ticks since the decision
    trail: Array  # (n, T, D) zeta on the way, by ticks elapsed
    trail_open: Array  # bool (n, T, M)


class Room(NamedTuple):
    """Room to work in, for one agent at a time."""

    inputs: np.ndarray  # flat
    first: np.ndarray
    second: np.ndarray
    third: np.ndarray
    fourth: np.ndarray
    outputs: np.ndarray
    ahead: np.ndarray  # (R, D) states predicted
    keep: np.ndarray  # (R,) gamma^tau
    which: np.ndarray  # int (R,)
    own: np.ndarray  # (D,)
    slope: np.ndarray  # (b, D)


@lowered
def borrowed(_, group):  # type: ignore[no-untyped-def]
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
def fused(_, a, b, c):  # type: ignore[no-untyped-def]
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


ROWS, LANES, SIZE = 6, 16, 4  # of a large tile; bytes of a number
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


@within
def multiply(a, b, out):
    """Fill out (R, C) with a (R, K) times b (K, C), whose rows are without gaps; the same bits on every processor."""
    r = 0
    while len(out) - r >= ROWS:
        strip_of_rows(a, b, out, r)
        r += ROWS
    while r < len(out):
        strip_of_one(a, b, out, r)
        r += 1


@within
def turned_over(w):
    """Return w (k, H) as (H, k), rows without gaps."""
    found = np.empty((w.shape[1], w.shape[0]), F)
    for k in range(w.shape[0]):
        for h in range(w.shape[1]):
            found[h, k] = w[k, h]
    return found


@within
def exp32(x):
    """Return e^x for x > -87 within 3e-7 of itself, in instructions that vectorise."""
    biased = np.int32(fused(x, LOG2E, HALF) + BIAS)  # the exponent of the result, as float32 holds it
    n = F(biased) - BIAS
    r = fused(-n, LN2_LOW, fused(-n, LN2_HIGH, x))
    p = fused(fused(fused(fused(fused(E6, r, E5), r, E4), r, E3), r, E2), r, E1)
    return (fused(p, r * r, r) + ONE) * np.int32(biased << np.int32(23)).view(F)


@within
def sigmoid(x):
    """Return 1 / (1 + e^-x)."""
    return ONE / (ONE + exp32(min(max(-x, F(-80)), F(80))))


@within
def copy(source, target):
    """Copy an array (k,) to another; an assignment would first compile the message for arrays of unequal lengths."""
    for k in range(len(target)):
        target[k] = source[k]


@within
def shaped(flat, rows, columns):
    """Return the beginning of a flat array as (rows, columns)."""
    return matrix(flat, 0, rows, columns)


@within
def layers(row, inputs, width):
    """Return w1, b1, w2, b2, w3, b3 as views of one agent's weights."""
    a = inputs * width
    b = a + width
    c = b + width * width
    d = c + width
    outputs = (len(row) - d) // (width + 1)
    e = d + outputs * width
    return (
        matrix(row, 0, inputs, width),
        row[a:b],
        matrix(row, b, width, width),
        row[c:d],
        matrix(row, d, outputs, width),
        row[e:],
    )


@within
def features(s, zeta, centres, x):
    """Fill the network inputs x (b, k) of zeta (b, D): plain, cosine and sine, place cells."""
    base = len(s.plain) + 2 * len(s.angle)
    cells = x.shape[1] - base
    for r in range(len(x)):
        row = x[r]
        at = 0
        for p in s.plain:
            row[at] = (zeta[r, p] - s.centre[p]) * s.inverse[p]
            at += 1
        for p in s.angle:
            cosine, sine = cosine_and_sine(np.float64(zeta[r, p]))
            row[at], row[at + len(s.angle)] = F(cosine), F(sine)
            at += 1
        if cells:
            here_x, here_y, sharp = zeta[r, s.place[0]], zeta[r, s.place[1]], s.sharp * HALF
            bumps, centre_x, centre_y = row[base:], centres[0], centres[1]
            for c in range(cells):
                gap_x, gap_y = here_x - centre_x[c], here_y - centre_y[c]
                bumps[c] = exp32(max(-sharp * (gap_x * gap_x + gap_y * gap_y), FAR))


@within
def raised(x, exponent):
    """Return x^exponent of x > 0."""
    if exponent == HALF:
        return math.sqrt(x)
    return ONE / math.sqrt(x) if exponent == -HALF else F(power(np.float64(x), np.float64(exponent)))


@within
def bent_square(s, y, v):
    """Return |b y|^n, the part of a deviation y of component v in the drive."""
    size = y * s.above[v] if y > ZERO else -y
    return raised(size, s.power) if size > ZERO else ZERO


@within
def bent_slope(s, y, v):
    """Return 1/n of the slope of `bent_square` along y."""
    size = y * s.above[v] if y > ZERO else -y
    if size <= ZERO:
        return ZERO
    steep = raised(size, s.power - ONE)
    return steep * s.above[v] if y > ZERO else -steep


@within
def drive(s, zeta, own):
    """Return d(zeta) for one zeta (D,); `own` (D,) is room to work in."""
    own[:] = ZERO
    for e in range(len(s.mix_from)):
        own[s.mix_to[e]] += s.mix_weight[e] * zeta[s.mix_from[e]]
    total, felt = s.epsilon, ZERO
    for v in range(len(own)):
        total += bent_square(s, own[v], v) if s.bent else own[v] * own[v]
        felt += s.felt[v] * zeta[v]
    return raised(total, s.root) + felt


@within
def add_drive_slope(s, zeta, own, slope):
    """Add dd/dzeta at one zeta (D,) to slope (D,); `own` (D,) is room to work in."""
    drive(s, zeta, own)
    total = s.epsilon
    for v in range(len(own)):
        total += bent_square(s, own[v], v) if s.bent else own[v] * own[v]
        slope[v] += s.felt[v]
    factor = s.exponent * raised(total, s.root - ONE)
    if s.bent:
        for v in range(len(own)):
            own[v] = bent_slope(s, own[v], v)
    for e in range(len(s.mix_from)):
        slope[s.mix_from[e]] += factor * own[s.mix_to[e]] * s.mix_weight[e]


@within
def output(row, w, b):
    """Return w . row + b, a single output."""
    if len(row) % LANES == 0:
        return dot(w, row) + b
    total = ZERO
    for h in range(len(row)):
        total = fused(w[h], row[h], total)
    return total + b


@within
def product_back(g, w, out):
    """Fill out (b, k) with g (b, H) times the transpose of w (k, H)."""
    if len(g) > FEW:
        multiply(g, turned_over(w), out)
        return
    for r in range(len(g)):
        for k in range(len(w)):
            out[r, k] = output(g[r], w[k], ZERO)


@within
def relu_layer(x, w, b, out):
    """Fill out (b, H) with max(x w + b, 0)."""
    multiply(x, w, out)
    for r in range(len(out)):
        row = out[r]
        for h in range(len(row)):
            row[h] = max(row[h] + b[h], ZERO)


@within
def silu_layer(x, w, b, out):
    """Fill out (b, H) with silu(x w + b)."""
    multiply(x, w, out)
    for r in range(len(out)):
        row = out[r]
        for h in range(len(row)):
            z = row[h] + b[h]
            row[h] = z * sigmoid(z)


@within
def scores(s, zeta, open_, f_row, j_row, centres, cells, hope, marks, marked, room, out):
    """Fill out (b, M) with the HJB score of the open movements, drive units; infinity for the others.

    Over a whole movement, (1 - gamma^tau) (d + d') / 2 + gamma^tau Jn(zeta'); or d + dJ/dzeta . f. With `hope`, Jn
    of a place unknown is lower by that share, as long as there are place cells to be given.
    """
    hopes = hope[0] > ZERO and 0 < marked < marks.shape[1]
    base, width, parts = len(s.plain) + 2 * len(s.angle), s.width, zeta.shape[1]
    k = base + cells
    inputs = base + centres.shape[1]
    w1, b1, w2, b2, w3, b3 = layers(f_row, inputs, width)
    rows = len(zeta)
    x = shaped(room.inputs, rows, k)
    if s.finite:
        features(s, zeta, centres, x)
    else:
        slopes(s, zeta, j_row, centres, cells, room)  # leaves x there
    hidden, hidden2 = shaped(room.first, rows, width), shaped(room.second, rows, width)
    relu_layer(x, w1[:k], b1, hidden)
    relu_layer(hidden, w2, b2, hidden2)
    raw = shaped(room.outputs, rows, len(w3))
    if rows > FEW:  # else only what is open, below
        product_back(hidden2, w3, raw)
    count = 0
    for r in range(rows):
        d = drive(s, zeta[r], room.own)
        for m in range(s.movements):
            out[r, m] = np.inf
            if not open_[r, m]:
                continue
            o = m * (parts + 1)
            if rows <= FEW:
                for v in range(o, o + parts + 1):
                    raw[r, v] = output(hidden2[r], w3[v], ZERO)
            tau = (raw[r, o + parts] + b3[o + parts]) * s.unit[parts]
            tau = min(max(tau, s.dt), LONGEST)
            ahead = room.ahead[count]
            if s.finite:
                for v in range(parts):
                    change = (raw[r, o + v] + b3[o + v]) * s.unit[v]
                    ahead[v] = min(max(zeta[r, v] + change, s.low[v]), s.high[v])
                keep = exp32(max(tau * s.log_gamma, F(-80.0)))
                out[r, m] = (ONE - keep) * HALF * (d + drive(s, ahead, room.own))
                room.keep[count] = keep
                room.which[count] = r * s.movements + m
                count += 1
            else:
                climb = ZERO
                for v in range(parts):
                    rate = (raw[r, o + v] + b3[o + v]) * s.unit[v] / tau
                    ahead[v] = zeta[r, v] + rate * s.dt
                    climb += room.slope[r, v] * rate
                out[r, m] = drive(s, ahead, room.own) - climb / s.log_gamma
    if count:
        deviations(s, room.ahead[:count], j_row, centres, cells, room)
        flat = out.ravel()
        for r in range(count):
            value = room.outputs[r]
            if hopes and unknown(s, room.ahead[r], marks, marked):
                value -= hope[0] * value + hope[1]
            flat[room.which[r]] += room.keep[r] * value


@within
def alike(s, zeta, where):
    """Return the squared distance between zeta (D,) and a place `where` (W,), in standard deviations."""
    total = ZERO
    for w in range(len(where)):
        gap = zeta[s.where[w]] - where[w]
        if s.turning[w]:
            gap -= TURN * F(math.floor(gap / TURN + HALF))
        gap *= s.nearness[w]
        total += gap * gap
    return total


@within
def recall(s, zeta, now, where, movement, error, time, count, bias, support):
    """Fill `bias` (M, D + 1) with the error of f to be expected at zeta (D,) by movement, from those remembered.

    A mean weighted by how near and how recent they are, with a prior of no error: Nadaraya-Watson regression.
    """
    bias[:], support[:] = ZERO, PRIOR
    for k in range(min(count, len(movement))):
        exponent = -HALF * alike(s, zeta, where[k]) - (now - time[k]) / FADING
        if exponent > F(-8.0):
            weight, m = exp32(exponent), movement[k]
            support[m] += weight
            for v in range(bias.shape[1]):
                bias[m, v] += weight * error[k, v]
    for m in range(len(support)):
        for v in range(bias.shape[1]):
            bias[m, v] /= support[m]


@within
def nearest(s, zeta, ring_zeta, lived):
    """Return the position in the ring of the decision nearest to zeta (D,); newer ones count as nearer."""
    capacity = len(ring_zeta)
    best, found = F(np.inf), 0
    for back in range(min(min(lived, capacity), s.searched)):
        at = (lived - 1 - back) % capacity
        total = F(back) * STALE
        for w in range(len(s.where)):
            gap = zeta[s.where[w]] - ring_zeta[at, s.where[w]]
            if s.turning[w]:
                gap -= TURN * F(math.floor(gap / TURN + HALF))
            gap *= s.nearness[w]
            total += gap * gap
        if total < best:
            best, found = total, at
    return found


@within
def look_ahead(s, zeta, open_, f_row, j_row, centres, cells, hope, marks, marked, memory, ring, room, beam, out):
    """Fill out (M,) with the score of the open movements, the least over what may follow; infinity for the others.

    A beam search over `depth` movements: the discounted drive on the way and J at its end. The best successor of every
    first movement is kept, so all have the same depth. What is open at a predicted state is what was open at the
    nearest decision remembered. `memory` is a row of `Trace` and the agent's age, `ring` one of `Ring`.
    """
    hopes = hope[0] > ZERO and 0 < marked < marks.shape[1]
    now, where, traced, error, time, noted = memory
    ring_zeta, ring_open, lived = ring
    base, width, parts = len(s.plain) + 2 * len(s.angle), s.width, len(zeta)
    k = base + cells
    w1, b1, w2, b2, w3, b3 = layers(f_row, base + centres.shape[1], width)
    nodes = 1
    beam.cost[0], beam.keep[0] = ZERO, ONE
    copy(zeta, beam.state[0])
    copy(open_, beam.open[0])
    out[:] = np.inf
    for level in range(s.depth):
        x = shaped(room.inputs, nodes, k)
        features(s, beam.state[:nodes], centres, x)
        h1, h2 = shaped(room.first, nodes, width), shaped(room.second, nodes, width)
        relu_layer(x, w1[:k], b1, h1)
        relu_layer(h1, w2, b2, h2)
        raw = shaped(room.outputs, nodes, len(w3))
        product_back(h2, w3, raw)
        count = 0
        for r in range(nodes):
            here = beam.state[r]
            d = drive(s, here, room.own)
            recall(s, here, now, where, traced, error, time, noted, beam.bias, beam.support)
            for m in range(s.movements):
                if not beam.open[r, m]:
                    continue
                o = m * (parts + 1)
                tau = (raw[r, o + parts] + b3[o + parts]) * s.unit[parts] + beam.bias[m, parts]
                tau = min(max(tau, s.dt), LONGEST)
                ahead = beam.next_state[count]
                for v in range(parts):
                    change = (raw[r, o + v] + b3[o + v]) * s.unit[v] + beam.bias[m, v]
                    ahead[v] = min(max(here[v] + change, s.low[v]), s.high[v])
                keep = exp32(max(tau * s.log_gamma, F(-80.0)))
                beam.next_cost[count] = beam.cost[r] + beam.keep[r] * (ONE - keep) * HALF * (
                    d + drive(s, ahead, room.own)
                )
                beam.next_keep[count] = beam.keep[r] * keep
                beam.next_root[count] = m if level == 0 else beam.root[r]
                count += 1
        deviations(s, beam.next_state[:count], j_row, centres, cells, room)
        for c in range(count):
            value = room.outputs[c]
            if hopes and unknown(s, beam.next_state[c], marks, marked):
                value -= hope[0] * value + hope[1]
            beam.score[c] = beam.next_cost[c] + beam.next_keep[c] * value
        if level == s.depth - 1:
            for c in range(count):
                out[beam.next_root[c]] = min(out[beam.next_root[c]], beam.score[c])
            break
        nodes = keep_best(s, beam, count)
        for r in range(nodes):
            copy(ring_open[nearest(s, beam.state[r], ring_zeta, lived)], beam.open[r])


@within
def keep_best(s, beam, count):
    """Keep the best successor of every first movement, and of the others the best that there is room for."""
    beam.taken[:count] = False
    nodes = np.int64(0)  # a literal would be compiled for, and then an integer
    for m in range(s.movements):
        best = -1
        for c in range(count):
            if beam.next_root[c] == m and (best < 0 or beam.score[c] < beam.score[best]):
                best = c
        if best >= 0:
            nodes = keep_one(beam, best, nodes)
    while nodes < min(count, len(beam.state)):
        best = -1
        for c in range(count):
            if not beam.taken[c] and (best < 0 or beam.score[c] < beam.score[best]):
                best = c
        nodes = keep_one(beam, best, nodes)
    return nodes


@within
def keep_one(beam, c, nodes):
    """Make the successor c the next state to look ahead from; return how many there are."""
    beam.taken[c] = True
    copy(beam.next_state[c], beam.state[nodes])
    beam.cost[nodes], beam.keep[nodes], beam.root[nodes] = beam.next_cost[c], beam.next_keep[c], beam.next_root[c]
    return nodes + 1


@compiled
def decide_far(s, brains, ring, trace, slots, ages, zeta, open_, out):
    """Fill out (k, M) with the scores of the agents `slots` (k,) at zeta (k, D), by looking ahead."""
    base = len(s.plain) + 2 * len(s.angle)
    parts = zeta.shape[1]
    size = max(s.beam, s.movements)
    outputs = s.movements * (parts + 1)
    room = room_for(s, size * s.movements, parts, outputs, base + brains.cell_centre.shape[2], size)
    beam = Beam(
        np.empty((size, parts), F),
        np.empty(size, F),
        np.empty(size, F),
        np.empty(size, np.int64),
        np.empty((size, s.movements), np.bool_),
        np.empty((size * s.movements, parts), F),
        np.empty(size * s.movements, F),
        np.empty(size * s.movements, F),
        np.empty(size * s.movements, np.int64),
        np.empty(size * s.movements, F),
        np.empty(size * s.movements, np.bool_),
        np.empty((s.movements, parts + 1), F),
        np.empty(s.movements, F),
    )
    word = control_word()
    set_control_word(word | ZEROED)
    for r in range(len(slots)):
        i = slots[r]
        look_ahead(
            s,
            zeta[r],
            open_[r],
            brains.f[i],
            brains.target[i],
            brains.cell_centre[i],
            brains.cell_count[i],
            brains.hope[i],
            brains.marks[i],
            brains.marked[i],
            (ages[r], trace.where[i], trace.movement[i], trace.error[i], trace.time[i], trace.count[i]),
            (ring.zeta[i], ring.open[i], ring.lived[i]),
            room,
            beam,
            out[r],
        )
    set_control_word(word)


@compiled
def expected(s, brains, slots, zeta, movement):
    """Return what f predicts (k, D + 1) of one movement each (k,) of the agents `slots` (k,) at zeta (k, D)."""
    base, width, parts = len(s.plain) + 2 * len(s.angle), s.width, zeta.shape[1]
    room = room_for(s, np.int64(1), parts, parts + 1, base + brains.cell_centre.shape[2], np.int64(1))
    out = np.empty((len(slots), parts + 1), F)
    for r in range(len(slots)):
        i = slots[r]
        centres, cells = brains.cell_centre[i], brains.cell_count[i]
        k = base + cells
        w1, b1, w2, b2, w3, b3 = layers(brains.f[i], base + centres.shape[1], width)
        x = shaped(room.inputs, 1, k)
        features(s, zeta[r : r + 1], centres, x)
        h1, h2 = shaped(room.first, 1, width), shaped(room.second, 1, width)
        relu_layer(x, w1[:k], b1, h1)
        relu_layer(h1, w2, b2, h2)
        o = movement[r] * (parts + 1)
        for v in range(parts + 1):
            out[r, v] = output(h2[0], w3[o + v], b3[o + v]) * s.unit[v]
        out[r, parts] = min(max(out[r, parts], s.dt), LONGEST)
    return out


@within
def unknown(s, zeta, centres, cells):
    """Return whether zeta (D,) is farther than the spacing from all marks."""
    for c in range(cells):
        gap_x, gap_y = centres[0, c] - zeta[s.place[0]], centres[1, c] - zeta[s.place[1]]
        if gap_x * gap_x + gap_y * gap_y <= centres[2, c]:
            return False
    return True


@within
def deviations(s, zeta, j_row, centres, cells, room):
    """Leave Jn of zeta (b, D), drive units, in room.outputs."""
    base, rows = len(s.plain) + 2 * len(s.angle), len(zeta)
    k = base + cells
    w1, b1, w2, b2, w3, b3 = layers(j_row, base + centres.shape[1], s.width)
    x = shaped(room.inputs, rows, k)
    features(s, zeta, centres, x)
    hidden, hidden2 = shaped(room.first, rows, s.width), shaped(room.second, rows, s.width)
    silu_layer(x, w1[:k], b1, hidden)
    silu_layer(hidden, w2, b2, hidden2)
    for r in range(rows):
        base_j = drive(s, zeta[r], room.own) if s.anchored else s.centre_j
        room.outputs[r] = base_j + s.spread_j * output(hidden2[r], w3[0], b3[0])


@within
def slopes(s, zeta, j_row, centres, cells, room):
    """Leave dJn/dzeta of zeta (b, D) in room.slope."""
    base, rows, width = len(s.plain) + 2 * len(s.angle), len(zeta), s.width
    k = base + cells
    w1, b1, w2, b2, w3, _ = layers(j_row, base + centres.shape[1], width)
    x = shaped(room.inputs, rows, k)
    features(s, zeta, centres, x)
    z1, h1 = shaped(room.first, rows, width), shaped(room.second, rows, width)
    z2, back = shaped(room.third, rows, width), shaped(room.fourth, rows, width)
    multiply(x, w1[:k], z1)
    for r in range(rows):
        for h in range(width):
            z1[r, h] += b1[h]
            h1[r, h] = z1[r, h] * sigmoid(z1[r, h])
    multiply(h1, w2, z2)
    for r in range(rows):
        for h in range(width):
            z = z2[r, h] + b2[h]
            g = sigmoid(z)
            z2[r, h] = s.spread_j * w3[0, h] * g * (ONE + z * (ONE - g))
    product_back(z2, w2, back)
    for r in range(rows):
        for h in range(width):
            z = z1[r, h]
            g = sigmoid(z)
            back[r, h] *= g * (ONE + z * (ONE - g))
    towards = shaped(room.inputs, 2 * rows, k)[rows:]
    product_back(back, w1[:k], towards)
    for r in range(rows):
        row = room.slope[r]
        row[:] = ZERO
        at = 0
        for p in s.plain:
            row[p] = towards[r, at] * s.inverse[p]
            at += 1
        for p in s.angle:
            row[p] = x[r, at] * towards[r, at + len(s.angle)] - x[r, at + len(s.angle)] * towards[r, at]
            at += 1
        for c in range(cells):
            pull = towards[r, base + c] * x[r, base + c] * s.sharp
            row[s.place[0]] += pull * (centres[0, c] - zeta[r, s.place[0]])
            row[s.place[1]] += pull * (centres[1, c] - zeta[r, s.place[1]])
        if s.anchored:
            add_drive_slope(s, zeta[r], room.own, row)


@within
def tangents(s, zeta, x, rate, centres, tangent):
    """Fill tangent (b, k): how the inputs x change per unit of time when zeta changes at `rate` (b, D)."""
    base = len(s.plain) + 2 * len(s.angle)
    for r in range(len(x)):
        at = 0
        for p in s.plain:
            tangent[r, at] = rate[r, p] * s.inverse[p]
            at += 1
        for p in s.angle:
            tangent[r, at] = -x[r, at + len(s.angle)] * rate[r, p]
            tangent[r, at + len(s.angle)] = x[r, at] * rate[r, p]
            at += 1
        for c in range(x.shape[1] - base):
            gap_x, gap_y = centres[0, c] - zeta[r, s.place[0]], centres[1, c] - zeta[r, s.place[1]]
            nearing = gap_x * rate[r, s.place[0]] + gap_y * rate[r, s.place[1]]
            tangent[r, base + c] = x[r, base + c] * s.sharp * nearing


@within
def moved(w, g, m, v, size, floor):
    """Return one weight and its moments after a step of Adam (Kingma and Ba 2015) along its gradient g."""
    first = fused(ONE - BETA1, g - m, m)
    second = fused(BETA2, v, (ONE - BETA2) * g * g)
    return w - size * first / (math.sqrt(second) + floor), first, second


@within
def corrected(rate, steps):
    """Return the size and the floor of an Adam step, corrected for moments that began at zero."""
    correction = math.sqrt(1.0 - 0.999**steps)
    return F(rate * correction / (1.0 - 0.9**steps)), F(1e-8 * correction)


@within
def adam(w, g, m, v, start, stop, size, floor):
    """Move the weights from `start` to `stop` by one step of Adam."""
    w, g, m, v = w[start:stop], g[start:stop], m[start:stop], v[start:stop]
    for i in range(len(w)):
        w[i], m[i], v[i] = moved(w[i], g[i], m[i], v[i], size, floor)


@within
def adam_across(w, m, v, start, x, up, size, floor, ahead):
    """The same for the weights (k, H) from `start` on, whose gradient is x (b, k) transposed times up (b, H), b <= 2.

    The gradient is worked out on the way, while the weights and their moments are waited for. `ahead` are weights that
    are needed next.
    """
    width, last = up.shape[1], len(up) - 1
    up0, up1 = up[0], up[last]
    for k in range(x.shape[1]):
        x0, x1 = x[0, k], x[last, k] if last else ZERO
        here = start + k * width
        for h in range(here, here + width, LINE):
            fetch(ahead, h)
            fetch(m, h + SOON)
            fetch(v, h + SOON)
        wk, mk, vk = w[here : here + width], m[here : here + width], v[here : here + width]
        for h in range(width):
            wk[h], mk[h], vk[h] = moved(wk[h], x0 * up0[h] + x1 * up1[h], mk[h], vk[h], size, floor)


@within
def step(s, w, g, m, v, steps, rate, k, inputs, rows, room, trained, ahead):
    """Take one step for one agent, after `learn_f` or `learn_j`; of the inputs only the first k are in use.

    Of the last layer only the heads `trained` (M,) move; all take as many outputs. `steps` (1 + M,) is brought up to
    date: of the hidden layers, and of every head.
    """
    width = s.width
    ends = inputs * width
    last = ends + width + width * width + width
    outputs = (len(w) - last) // (width + 1)
    steps[0] += 1
    size, floor = corrected(rate, steps[0])
    if rows > FEW:
        adam(w, g, m, v, np.int64(0), k * width, size, floor)
        adam(w, g, m, v, ends, last, size, floor)
    else:
        x, hidden = shaped(room.inputs, rows, k), shaped(room.second, rows, width)
        up1, up2 = shaped(room.third, rows, width), shaped(room.fourth, rows, width)
        adam_across(w, m, v, np.int64(0), x, up1, size, floor, ahead)
        adam(w, g, m, v, ends, ends + width, size, floor)
        adam_across(w, m, v, ends + width, hidden, up2, size, floor, ahead)
        adam(w, g, m, v, last - width, last, size, floor)
    each, biases = outputs // len(trained), last + outputs * width
    for o in range(len(trained)):
        if trained[o]:
            steps[1 + o] += 1
            size, floor = corrected(rate, steps[1 + o])
            adam(w, g, m, v, last + o * each * width, last + (o + 1) * each * width, size, floor)
            adam(w, g, m, v, biases + o * each, biases + (o + 1) * each, size, floor)


@within
def sum_rows(g, out):
    """Fill out (H,) with the sum over the rows of g (b, H)."""
    out[:] = ZERO
    for r in range(len(g)):
        for h in range(len(out)):
            out[h] += g[r, h]


@within
def positions(count, capacity, uniform, late, recent, at):
    """Fill at (b,) with positions in the ring: the last `late` of them among the `recent` decisions."""
    kept = min(count, capacity)
    for r in range(len(at)):
        window = min(kept, recent) if r >= len(at) - late else kept
        back = min(int(uniform[r] * F(window)), window - 1)  # 0: the newest
        at[r] = (count - 1 - back) % capacity


@within
def imagine(s, zeta, uniform, normal, m):
    """Redraw the needs of the first m states of zeta (b, D), place and rest kept; fatigues are scaled down.

    Half of them have one need deprived and the others near sated, half have all needs uniform
    between deprived and a little beyond sated.
    """
    parts = zeta.shape[1]
    for r in range(m):
        one = -1
        if r < m // 2 and len(s.deprivable):
            one = s.deprivable[min(int(uniform[m * parts + m + r] * F(len(s.deprivable))), len(s.deprivable) - 1)]
        calm = uniform[m * parts + r]
        for v in range(parts):
            if not s.need[v]:
                continue
            can = False
            for e in s.deprivable:
                can |= e == v
            bottom = max(s.deprived * s.scale[v], s.low[v])
            drawn = bottom + uniform[r * parts + v] * (s.sated * s.scale[v] - bottom)
            if not can:
                drawn = zeta[r, v] * calm
            elif r < m // 2 and v != one:
                drawn = F(0.1) * s.scale[v] * normal[r, v]
            zeta[r, v] = min(max(drawn, s.low[v]), s.high[v])


@within
def learn_f(s, zeta, movement, after, duration, f_row, centres, cells, room, g):
    """Return L_f and fill its gradient g (P,): the squared error of the executed movement's predicted change.

    Of one or two rows, g must be zero before, and the gradients of w1 and w2 are left to `adam_across`: x, h1 and
    what comes back to them lie in `room`. `learn_j` does so too.
    """
    base, width, parts, rows = len(s.plain) + 2 * len(s.angle), s.width, zeta.shape[1], len(zeta)
    k, inputs = base + cells, base + centres.shape[1]
    w1, b1, w2, b2, w3, b3 = layers(f_row, inputs, width)
    g1, gb1, g2, gb2, g3, gb3 = layers(g, inputs, width)
    x = shaped(room.inputs, rows, k)
    features(s, zeta, centres, x)
    h2, h1 = shaped(room.first, rows, width), shaped(room.second, rows, width)
    back1, back2 = shaped(room.third, rows, width), shaped(room.fourth, rows, width)
    relu_layer(x, w1[:k], b1, h1)
    relu_layer(h1, w2, b2, h2)
    known = 0
    for r in range(rows):
        known += movement[r] >= 0
    part = ONE / F(max(known, 1) * (parts + 1))
    loss = ZERO
    if rows > FEW:
        g3[:] = ZERO
        gb3[:] = ZERO
    for r in range(rows):
        up, row = back2[r], h2[r]
        up[:] = ZERO
        if movement[r] < 0:
            continue
        for v in range(parts + 1):
            goal = min(duration[r], LONGEST) if v == parts else after[r, v] - zeta[r, v]
            for p in s.angle:
                if p == v:
                    goal -= TURN * F(math.floor(goal / TURN + HALF))
            o = movement[r] * (parts + 1) + v
            weight, slot = w3[o], g3[o]
            error = output(row, weight, b3[o]) - goal / s.unit[v]
            loss += error * error * part
            e = TWO * error * part
            gb3[o] += e
            for h in range(width):
                slot[h] += e * row[h]
                up[h] += e * weight[h]
        for h in range(width):
            up[h] = up[h] if row[h] > ZERO else ZERO
    product_back(back2, w2, back1)
    for r in range(rows):
        for h in range(width):
            back1[r, h] = back1[r, h] if h1[r, h] > ZERO else ZERO
    sum_rows(back1, gb1)
    sum_rows(back2, gb2)
    if rows > FEW:
        multiply(x.T, back1, g1[:k])
        multiply(h1.T, back2, g2)
    return loss


@within
def learn_j(s, zeta, movement, goal, rate, j_row, centres, cells, room, g):
    """Return L_J and fill its gradient g (Q,): the squared residual of the HJB equation, in drive units.

    `goal` (b,) is the right-hand side; where the score is first order and there is no min (Algorithm 1 as
    printed) it lacks dJ/dzeta . f, which is added here along `rate` (b, D) and differentiated too.
    """
    base, width, b = len(s.plain) + 2 * len(s.angle), s.width, len(zeta)
    k, inputs = base + cells, base + centres.shape[1]
    printed = not (s.finite or s.minimum)
    rows = 2 * b if printed else b  # the states, and below them their tangents
    w1, b1, w2, b2, w3, b3 = layers(j_row, inputs, width)
    g1, gb1, g2, gb2, g3, gb3 = layers(g, inputs, width)
    x = shaped(room.inputs, rows, k)
    if not printed:  # else `executed` has left x there
        features(s, zeta, centres, x)
    else:
        tangents(s, zeta, x[:b], rate, centres, x[b:])
    z1, h1 = shaped(room.first, rows, width), shaped(room.second, rows, width)
    z2, h2 = shaped(room.third, rows, width), shaped(room.fourth, rows, width)
    back1 = z2  # when z2 is no longer needed
    multiply(x, w1[:k], z1)
    activate(z1, b1, h1, b)
    multiply(h1, w2, z2)
    activate(z2, b2, h2, b)
    known = 0
    for r in range(b):
        known += s.minimum or movement[r] >= 0
    loss, share = ZERO, ONE / F(max(known, 1))
    g3[:] = ZERO
    gb3[:] = ZERO
    for r in range(b):
        base_j = drive(s, zeta[r], room.own) if s.anchored else s.centre_j
        residual = base_j + s.spread_j * output(h2[r], w3[0], b3[0]) - goal[r]
        if printed:
            residual += s.spread_j * output(h2[b + r], w3[0], ZERO) / s.log_gamma
            if s.anchored:
                room.slope[r] = ZERO
                add_drive_slope(s, zeta[r], room.own, room.slope[r])
                for v in range(zeta.shape[1]):
                    residual += room.slope[r, v] * rate[r, v] / s.log_gamma
        weight = ONE
        if s.weight_top > ZERO:
            weight = s.weight_top / (s.weight_floor + drive(s, zeta[r], room.own))
        weight *= weight * share * F(s.minimum or movement[r] >= 0)
        loss += residual * residual * weight
        e = TWO * residual * weight * s.spread_j
        gb3[0] += e
        for h in range(width):
            g3[0, h] += e * h2[r, h]
            h2[r, h] = e * w3[0, h]  # from here on the gradient of the loss
        if printed:
            e /= s.log_gamma
            for h in range(width):
                g3[0, h] += e * h2[b + r, h]
                h2[b + r, h] = e * w3[0, h]
    deactivate(z2, h2, b)
    product_back(h2, w2, back1)
    deactivate(z1, back1, b)
    sum_rows(back1[:b], gb1)
    sum_rows(h2[:b], gb2)
    if rows > FEW:
        multiply(x.T, back1, g1[:k])
        multiply(h1.T, h2, g2)
    return loss


@within
def activate(z, bias, out, b):
    """Add the bias to z's first b rows and fill out with silu(z); rows below are tangents of those above."""
    for r in range(b):
        for h in range(len(bias)):
            z[r, h] += bias[h]
            out[r, h] = z[r, h] * sigmoid(z[r, h])
    for r in range(b, len(z)):
        for h in range(len(bias)):
            at = z[r - b, h]
            g = sigmoid(at)
            out[r, h] = z[r, h] * g * (ONE + at * (ONE - g))


@within
def deactivate(z, up, b):
    """Turn the gradient `up` of silu's values, tangents below, into that of z, in place."""
    for r in range(b):
        for h in range(z.shape[1]):
            at = z[r, h]
            g = sigmoid(at)
            slope = g * (ONE + at * (ONE - g))
            value = up[r, h] * slope
            if len(z) > b:
                value += up[b + r, h] * z[b + r, h] * g * (ONE - g) * (TWO + at * (ONE - TWO * g))
                up[b + r, h] *= slope
            up[r, h] = value


@within
def room_for(s, rows, parts, outputs, inputs, b):
    """Return room for `rows` states at once, of which `b` may be followed by as many tangents."""
    flat = max(rows, 2 * b) * max(s.width, 1)
    return Room(
        np.empty(max(rows, 2 * b) * inputs, F),
        np.empty(flat, F),
        np.empty(flat, F),
        np.empty(flat, F),
        np.empty(flat, F),
        np.empty(max(b * outputs, rows), F),
        np.empty((max(rows, 1), parts), F),
        np.empty(max(rows, 1), F),
        np.empty(max(rows, 1), np.int64),
        np.empty(parts, F),
        np.empty((b, parts), F),
    )


@compiled
def go_on(table, ticks, way, masks, zeta, keep, free, actions):
    """Live one tick of the movements that go on: fill actions (n,), and with `keep` the trail.

    A movement passes to its second stage when the first is over; it goes on past its end where the world leaves
    no choice. Returns how many agents have none to go on with, marked in free (n,). `table` and `ticks` (M, 2) are
    those of `agents.movements`; masks (n, A), zeta (n, D).
    """
    count = 0
    for i in range(len(free)):
        m = way.movement[i]
        free[i] = True
        if m >= 0:
            over = way.left[i] <= 0
            if over and way.stage[i] == 0 and ticks[m, 1] > 0:
                way.stage[i], way.left[i], over = 1, ticks[m, 1], False
            actions[i] = table[m, way.stage[i]]
            free[i] = not masks[i, actions[i]] or (over and np.sum(masks[i]) != 1)
        if free[i]:
            count += 1
            continue
        at = way.elapsed[i]
        if keep and at < way.trail.shape[1]:
            copy(zeta[i], way.trail[i, at])
            for k in range(len(table)):
                way.trail_open[i, at, k] = masks[i, table[k, 0]] and masks[i, table[k, 1]]
        way.left[i] -= 1
        way.elapsed[i] += 1
    return count


@compiled
def decide(s, brains, slots, zeta, open_, out):
    """Fill out (k, M) with the scores of the agents `slots` (k,) at zeta (k, D), infinity where not open."""
    base = len(s.plain) + 2 * len(s.angle)
    parts = zeta.shape[1]
    room = room_for(s, s.movements, parts, s.movements * (parts + 1), base + brains.cell_centre.shape[2], np.int64(1))
    word = control_word()
    set_control_word(word | ZEROED)
    kept = room
    s, brains, room = borrowed(s), borrowed(brains), borrowed(room)
    for r in range(len(slots)):
        i = slots[r]
        scores(
            s,
            zeta[r : r + 1],
            open_[r : r + 1],
            brains.f[i],
            brains.target[i],
            brains.cell_centre[i],
            brains.cell_count[i],
            brains.hope[i],
            brains.marks[i],
            brains.marked[i],
            room,
            out[r : r + 1],
        )
    set_control_word(word)
    keep_alive(kept)


@within
def expected_score(s, score):
    """Return the mean score (M,) of one that explores with the share `explored`, and else takes the least."""
    least, total, weight = score[0], ZERO, ZERO
    for m in range(len(score)):
        least = min(least, score[m])
        if score[m] < np.inf:
            total += score[m] / s.length[m]
            weight += ONE / s.length[m]
    if weight == ZERO:
        return least
    return least + s.explored * (total / weight - least)


@compiled
def update(s, brains, ring, draws, ready, rate, loss_f, loss_j, ahead, start, stop):
    """Take one step on L_f and on L_J for every `ready` agent from `start` to `stop`, and score what is `ahead`."""
    parts, b, bf = ring.zeta.shape[2], draws.batch, draws.batch_f
    base = len(s.plain) + 2 * len(s.angle)
    inputs = base + brains.cell_centre.shape[2]
    room = room_for(s, max(b * s.movements, bf), parts, s.movements * (parts + 1), inputs, b)
    batch = Batch(
        np.zeros(brains.f.shape[1], F),
        np.zeros(brains.J.shape[1], F),
        np.empty(b, np.int64),
        np.empty(bf, np.int64),
        np.empty((bf, parts), F),
        np.empty((bf, parts), F),
        np.empty(bf, F),
        np.empty(bf, np.int64),
        np.empty((b, parts), F),
        np.empty((b, parts), F),
        np.empty(b, np.int64),
        np.empty((b, s.movements), np.bool_),
        np.empty((b, s.movements), F),
        np.empty(b, F),
        np.empty(s.movements, np.bool_),
    )
    word = control_word()
    set_control_word(word | ZEROED)
    kept = room, batch
    s, brains, ring, draws, room = borrowed(s), borrowed(brains), borrowed(ring), borrowed(draws), borrowed(room)
    ahead = borrowed(ahead)
    g_f, g_j, at, at_f, zeta_f, after_f, time_f, done_f, zeta, pace, done, open_, table, goal, trained = borrowed(batch)
    capacity, m = ring.zeta.shape[1], draws.imagined
    _, _, _, _, g3_f, gb3_f = layers(g_f, inputs, s.width)
    always = np.ones(1, np.bool_)  # J has one head
    no_hope = np.zeros(2, F)  # the target holds no optimism, so J stays what has been met
    rows = b if s.finite or s.minimum else 2 * b  # of learn_j
    for i in range(start, stop):
        if not ready[i]:
            continue
        uniform, cells, centres = draws.uniform[i], brains.cell_count[i], brains.cell_centre[i]
        k = base + cells
        # f
        positions(ring.lived[i], capacity, uniform[b:], draws.late_f, draws.recent, at_f)
        for r in range(bf):
            copy(ring.zeta[i, at_f[r]], zeta_f[r])
            copy(ring.after[i, at_f[r]], after_f[r])
            time_f[r], done_f[r] = ring.duration[i, at_f[r]], ring.movement[i, at_f[r]]
        loss_f[i] = learn_f(s, zeta_f, done_f, after_f, time_f, brains.f[i], centres, cells, room, g_f)
        trained[:] = not s.lazy
        for r in range(bf):
            if done_f[r] >= 0:
                trained[done_f[r]] = True
        step(
            s,
            brains.f[i],
            g_f,
            brains.f_first[i],
            brains.f_second[i],
            brains.f_steps[i],
            rate[i],
            k,
            inputs,
            bf,
            room,
            trained,
            brains.J[i],
        )
        if bf <= FEW:
            for o in range(bf):
                head = max(done_f[o], 0) * (parts + 1)
                g3_f[head : head + parts + 1], gb3_f[head : head + parts + 1] = ZERO, ZERO
        # the right-hand side of the equation
        positions(ring.lived[i], capacity, uniform, draws.late, draws.recent, at)
        for r in range(b):
            copy(ring.zeta[i, at[r]], zeta[r])
            done[r] = ring.movement[i, at[r]]
            for v in range(s.movements):
                open_[r, v] = ring.open[i, at[r], v] if s.minimum else v == max(done[r], 0)
        if m:
            imagine(s, zeta, uniform[b + bf :], draws.normal[i], m)
        if s.minimum or s.finite:
            scores(
                s,
                zeta,
                open_,
                brains.f[i],
                brains.target[i],
                centres,
                cells,
                no_hope,
                brains.marks[i],
                brains.marked[i],
                room,
                table,
            )
            for r in range(b):
                goal[r] = min(max(expected_score(s, table[r]), ZERO), s.ceiling)
        else:
            executed(s, zeta, done, brains.f[i], centres, cells, room, pace)
            for r in range(b):
                goal[r] = drive(s, ring.after[i, at[r]], room.own)
        # J
        loss_j[i] = learn_j(s, zeta, done, goal, pace, brains.J[i], centres, cells, room, g_j)
        step(
            s,
            brains.J[i],
            g_j,
            brains.J_first[i],
            brains.J_second[i],
            brains.J_steps[i],
            rate[i],
            k,
            inputs,
            rows,
            room,
            always,
            brains.f[min(i + 1, len(brains.f) - 1)],
        )
        if s.slow:
            slow, fast = brains.target[i], brains.J[i]
            for p in range(len(slow)):
                slow[p] += s.polyak * (fast[p] - slow[p])
        if ahead.open[i].any():
            here, options, table_ahead = ahead.zeta[i : i + 1], ahead.open[i : i + 1], ahead.score[i : i + 1]
            scores(
                s,
                here,
                options,
                brains.f[i],
                brains.target[i],
                centres,
                cells,
                brains.hope[i],
                brains.marks[i],
                brains.marked[i],
                room,
                table_ahead,
            )
    set_control_word(word)
    keep_alive(kept)


@within
def executed(s, zeta, movement, f_row, centres, cells, room, pace):
    """Fill pace (b, D) with f, per unit of time, of the movement executed at each zeta (b, D)."""
    base, width, parts, rows = len(s.plain) + 2 * len(s.angle), s.width, zeta.shape[1], len(zeta)
    k = base + cells
    w1, b1, w2, b2, w3, b3 = layers(f_row, base + centres.shape[1], width)
    x = shaped(room.inputs, rows, k)
    features(s, zeta, centres, x)
    h1, h2 = shaped(room.first, rows, width), shaped(room.second, rows, width)
    relu_layer(x, w1[:k], b1, h1)
    relu_layer(h1, w2, b2, h2)
    for r in range(rows):
        o = max(movement[r], 0) * (parts + 1)
        tau = output(h2[r], w3[o + parts], b3[o + parts]) * s.unit[parts]
        tau = min(max(tau, s.dt), LONGEST)
        for v in range(parts):
            pace[r, v] = output(h2[r], w3[o + v], b3[o + v]) * s.unit[v] / tau


@compiled
def value_at(s, brains, slot, zeta):
    """Return Jn (m,) of one agent at zeta (m, D)."""
    parts, inputs = zeta.shape[1], len(s.plain) + 2 * len(s.angle) + brains.cell_centre.shape[2]
    room = room_for(s, len(zeta), parts, np.int64(1), inputs, np.int64(1))
    deviations(s, zeta, brains.target[slot], brains.cell_centre[slot], brains.cell_count[slot], room)
    return room.outputs[: len(zeta)].copy()


@compiled
def slope_at(s, brains, slot, zeta):
    """Return dJn/dzeta (m, D) of one agent at zeta (m, D)."""
    parts, inputs = zeta.shape[1], len(s.plain) + 2 * len(s.angle) + brains.cell_centre.shape[2]
    room = room_for(s, len(zeta), parts, np.int64(1), inputs, len(zeta))
    slopes(s, zeta, brains.target[slot], brains.cell_centre[slot], brains.cell_count[slot], room)
    return room.slope


@compiled
def forecast_at(s, brains, slot, zeta):
    """Return f's outputs (m, M (D + 1)) of one agent at zeta (m, D), in its units."""
    inputs = len(s.plain) + 2 * len(s.angle) + brains.cell_centre.shape[2]
    out = np.empty((len(zeta), s.movements * (zeta.shape[1] + 1)), F)
    room = room_for(s, len(zeta), zeta.shape[1], np.int64(1), inputs, np.int64(1))
    cells, centres = brains.cell_count[slot], brains.cell_centre[slot]
    base, rows = len(s.plain) + 2 * len(s.angle), len(zeta)
    k = base + cells
    w1, b1, w2, b2, w3, b3 = layers(brains.f[slot], inputs, s.width)
    x = shaped(room.inputs, rows, k)
    features(s, zeta, centres, x)
    h1, h2 = shaped(room.first, rows, s.width), shaped(room.second, rows, s.width)
    relu_layer(x, w1[:k], b1, h1)
    relu_layer(h1, w2, b2, h2)
    product_back(h2, w3, out)
    for r in range(rows):
        for o in range(len(b3)):
            out[r, o] += b3[o]
    keep_alive(room)
    return out
