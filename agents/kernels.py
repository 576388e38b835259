"""Compiled kernels of the f/J learner: scores, losses, gradients and Adam, one agent after another.

Every agent's weights lie in one row, and all that an update needs of them is done while the row is in
the cache. An agent's numbers depend on no other's, so any split of the agents over threads gives
the same result. Gradients are written out by hand; the tests hold them to automatic ones.

Shapes: n agents, b states, D components of zeta, M movements, I inputs, H hidden units, C place cells.
"""

from __future__ import annotations

import math
import platform
from typing import Any, NamedTuple

import numba
import numpy as np
import scipy.linalg  # noqa: F401  (np.dot calls its BLAS: to be loaded before threads are limited)
from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic
from numba.np.arrayobj import populate_array

from ecology.compiler_cache import use_cache

use_cache(__file__)

F = np.float32
ZERO, HALF, ONE, TWO = F(0), F(0.5), F(1), F(2)
BIAS, LOG2E, LN2_HIGH, LN2_LOW = F(127), F(1.44269504), F(0.693359375), F(-2.12194440e-4)
E6, E5, E4 = F(1.9875691500e-4), F(1.3981999507e-3), F(8.3334519073e-3)  # exp, after Cephes' expf
E3, E2, E1 = F(4.1665795894e-2), F(1.6666665459e-1), F(5.0000001201e-1)
BETA1, BETA2, TINY = F(0.9), F(0.999), F(1e-8)  # of Adam
POLYAK = F(0.1)  # share by which the target network follows J per update
FAR = F(-30.0)  # exponent of a place cell below which it is silent; keeps subnormal numbers out
FEW = 2  # rows up to which a product is a loop here, not one of the linear algebra library
LINE = 16  # numbers in a line of the cache
SOON = 512  # numbers by which Adam's moments are asked for ahead of their use
X86 = platform.machine().lower() in ("x86_64", "amd64")
ZEROED = np.uint32(0x8040)  # bits of its control word: subnormal numbers, read or computed, are zero
LONGEST = F(300.0)  # units of time, of a predicted duration

Array = Any  # of NumPy, or as another device holds it

FLAGS: dict[str, Any] = {"nogil": True, "cache": True, "error_model": "numpy"}
# no assumption about NaN or infinity: what diverges must be seen
compiled = numba.njit(fastmath={"reassoc", "contract", "arcp", "nsz"}, **FLAGS)
lowered: Any = intrinsic  # to LLVM's own instructions
exactly = numba.njit(fastmath={"contract"}, **FLAGS)  # additions in the order in which they are written


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
    sharp: np.float32  # 1 / width^2 of a place cell
    apart: np.float32  # squared distance from all place cells beyond which a place is unknown
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
    slow: bool  # whether there is a target network
    lazy: bool  # heads of f that no decision of the batch trains rest


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
    hope: Array  # (n,) share by which J of places without a place cell is taken to be lower


class Ring(NamedTuple):
    """The memory of decisions, see `agents.memory`."""

    zeta: Array
    after: Array
    duration: Array
    movement: Array
    open: Array
    lived: Array  # (n,) decisions so far


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
    there would be hundreds per agent. Only for arguments of a kernel, which its caller keeps alive.
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


@exactly
def exp32(x):
    """Return e^x for x > -87 within 3e-7 of itself, in instructions that vectorise."""
    biased = np.int32(x * LOG2E + HALF + BIAS)  # the exponent of the result, as float32 holds it
    n = F(biased) - BIAS
    r = x - n * LN2_HIGH - n * LN2_LOW
    p = (((((E6 * r + E5) * r + E4) * r + E3) * r + E2) * r + E1) * r * r + r + ONE
    return p * np.int32(biased << np.int32(23)).view(F)


@compiled
def sigmoid(x):
    """Return 1 / (1 + e^-x)."""
    return ONE / (ONE + exp32(min(max(-x, F(-80)), F(80))))


@compiled
def shaped(flat, rows, columns):
    """Return the beginning of a flat array as (rows, columns)."""
    return matrix(flat, 0, rows, columns)


@compiled
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


@compiled
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
            row[at] = math.cos(zeta[r, p])
            row[at + len(s.angle)] = math.sin(zeta[r, p])
            at += 1
        if cells:
            here_x, here_y, sharp = zeta[r, s.place[0]], zeta[r, s.place[1]], s.sharp * HALF
            bumps, centre_x, centre_y = row[base:], centres[0], centres[1]
            for c in range(cells):
                gap_x, gap_y = here_x - centre_x[c], here_y - centre_y[c]
                bumps[c] = exp32(max(-sharp * (gap_x * gap_x + gap_y * gap_y), FAR))


@compiled
def drive(s, zeta, own):
    """Return d(zeta) for one zeta (D,); `own` (D,) is room to work in."""
    own[:] = ZERO
    for e in range(len(s.mix_from)):
        own[s.mix_to[e]] += s.mix_weight[e] * zeta[s.mix_from[e]]
    total, felt = s.epsilon, ZERO
    for v in range(len(own)):
        total += own[v] * own[v]
        felt += s.felt[v] * zeta[v]
    return (math.sqrt(total) if s.exponent == ONE else total ** (s.exponent * HALF)) + felt


@compiled
def output(row, w, b):
    """Return w . row + b, a single output."""
    total = b
    for h in range(len(row)):
        total += w[h] * row[h]
    return total


@exactly
def product_of_few(x, w, out):
    """Fill out (b, H) with x (b, k) times w (k, H), four rows of w at a time; sums are taken in the order of k."""
    fours = len(w) - len(w) % 4
    for r in range(len(x)):
        row, factor = out[r], x[r]
        row[:] = ZERO
        for k in range(0, fours, 4):
            w0, w1, w2, w3 = w[k], w[k + 1], w[k + 2], w[k + 3]
            for h in range(len(row)):
                total = row[h] + factor[k] * w0[h]
                total += factor[k + 1] * w1[h]
                total += factor[k + 2] * w2[h]
                row[h] = total + factor[k + 3] * w3[h]
        for k in range(fours, len(w)):
            w0 = w[k]
            for h in range(len(row)):
                row[h] += factor[k] * w0[h]


@compiled
def product(x, w, out):
    """Fill out (b, H) with x (b, k) times w (k, H)."""
    if len(x) > FEW:
        np.dot(x, w, out)
    else:
        product_of_few(x, w, out)


@compiled
def product_back(g, w, out):
    """Fill out (b, k) with g (b, H) times the transpose of w (k, H)."""
    if len(g) > FEW:
        np.dot(g, w.T, out)
        return
    for r in range(len(g)):
        for k in range(len(w)):
            out[r, k] = output(g[r], w[k], ZERO)


@compiled
def relu_layer(x, w, b, out):
    """Fill out (b, H) with max(x w + b, 0)."""
    product(x, w, out)
    for r in range(len(out)):
        row = out[r]
        for h in range(len(row)):
            row[h] = max(row[h] + b[h], ZERO)


@compiled
def silu_layer(x, w, b, out):
    """Fill out (b, H) with silu(x w + b)."""
    product(x, w, out)
    for r in range(len(out)):
        row = out[r]
        for h in range(len(row)):
            z = row[h] + b[h]
            row[h] = z * sigmoid(z)


@compiled
def scores(s, zeta, open_, f_row, j_row, centres, cells, hope, room, out):
    """Fill out (b, M) with the HJB score of the open movements, drive units; infinity for the others.

    Over a whole movement, (1 - gamma^tau) (d + d') / 2 + gamma^tau Jn(zeta'); or d + dJ/dzeta . f. With `hope`, Jn
    of a place unknown is lower by that share, as long as there are place cells to be given.
    """
    hopes = hope > ZERO and 0 < cells < centres.shape[1]
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
        np.dot(hidden2, w3.T, raw)
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
                keep = math.exp(tau * s.log_gamma)
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
            if hopes and unknown(s, room.ahead[r], centres, cells):
                value *= ONE - hope
            flat[room.which[r]] += room.keep[r] * value


@compiled
def unknown(s, zeta, centres, cells):
    """Return whether zeta (D,) is farther than the spacing from all place cells."""
    for c in range(cells):
        gap_x, gap_y = centres[0, c] - zeta[s.place[0]], centres[1, c] - zeta[s.place[1]]
        if gap_x * gap_x + gap_y * gap_y <= s.apart:
            return False
    return True


@compiled
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
        room.outputs[r] = s.centre_j + s.spread_j * output(hidden2[r], w3[0], b3[0])


@compiled
def slopes(s, zeta, j_row, centres, cells, room):
    """Leave dJn/dzeta of zeta (b, D) in room.slope."""
    base, rows, width = len(s.plain) + 2 * len(s.angle), len(zeta), s.width
    k = base + cells
    w1, b1, w2, b2, w3, _ = layers(j_row, base + centres.shape[1], width)
    x = shaped(room.inputs, rows, k)
    features(s, zeta, centres, x)
    z1, h1 = shaped(room.first, rows, width), shaped(room.second, rows, width)
    z2, back = shaped(room.third, rows, width), shaped(room.fourth, rows, width)
    product(x, w1[:k], z1)
    for r in range(rows):
        for h in range(width):
            z1[r, h] += b1[h]
            h1[r, h] = z1[r, h] * sigmoid(z1[r, h])
    product(h1, w2, z2)
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


@compiled
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


@compiled
def moved(w, g, m, v, size, floor):
    """Return one weight and its moments after a step of Adam (Kingma and Ba 2015) along its gradient g."""
    first = m + (ONE - BETA1) * (g - m)
    second = BETA2 * v + (ONE - BETA2) * g * g
    return w - size * first / (math.sqrt(second) + floor), first, second


@compiled
def corrected(rate, steps):
    """Return the size and the floor of an Adam step, corrected for moments that began at zero."""
    correction = math.sqrt(1.0 - 0.999**steps)
    return F(rate * correction / (1.0 - 0.9**steps)), F(1e-8 * correction)


@compiled
def adam(w, g, m, v, start, stop, size, floor):
    """Move the weights from `start` to `stop` by one step of Adam."""
    w, g, m, v = w[start:stop], g[start:stop], m[start:stop], v[start:stop]
    for i in range(len(w)):
        w[i], m[i], v[i] = moved(w[i], g[i], m[i], v[i], size, floor)


@compiled
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


@compiled
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
        adam(w, g, m, v, 0, k * width, size, floor)
        adam(w, g, m, v, ends, last, size, floor)
    else:
        x, hidden = shaped(room.inputs, rows, k), shaped(room.second, rows, width)
        up1, up2 = shaped(room.third, rows, width), shaped(room.fourth, rows, width)
        adam_across(w, m, v, 0, x, up1, size, floor, ahead)
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


@compiled
def sum_rows(g, out):
    """Fill out (H,) with the sum over the rows of g (b, H)."""
    out[:] = ZERO
    for r in range(len(g)):
        for h in range(len(out)):
            out[h] += g[r, h]


@compiled
def positions(count, capacity, uniform, late, recent, at):
    """Fill at (b,) with positions in the ring: the last `late` of them among the `recent` decisions."""
    kept = min(count, capacity)
    for r in range(len(at)):
        window = min(kept, recent) if r >= len(at) - late else kept
        back = min(int(uniform[r] * F(window)), window - 1)  # 0: the newest
        at[r] = (count - 1 - back) % capacity


@compiled
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


@compiled
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
                    goal = F(math.atan2(math.sin(goal), math.cos(goal)))
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
        np.dot(x.T, back1, g1[:k])
        np.dot(h1.T, back2, g2)
    return loss


@compiled
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
    product(x, w1[:k], z1)
    activate(z1, b1, h1, b)
    product(h1, w2, z2)
    activate(z2, b2, h2, b)
    known = 0
    for r in range(b):
        known += s.minimum or movement[r] >= 0
    loss, share = ZERO, ONE / F(max(known, 1))
    g3[:] = ZERO
    gb3[:] = ZERO
    for r in range(b):
        residual = s.centre_j + s.spread_j * output(h2[r], w3[0], b3[0]) - goal[r]
        if printed:
            residual += s.spread_j * output(h2[b + r], w3[0], ZERO) / s.log_gamma
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
        np.dot(x.T, back1, g1[:k])
        np.dot(h1.T, h2, g2)
    return loss


@compiled
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


@compiled
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


@compiled
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
            way.trail[i, at] = zeta[i]
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
    room = room_for(s, s.movements, parts, s.movements * (parts + 1), base + brains.cell_centre.shape[2], 1)
    word = control_word()
    set_control_word(word | ZEROED)
    decide_each(s, brains, slots, (zeta, open_, out), room)
    set_control_word(word)


@compiled
def decide_each(s, brains, slots, rows, room):
    """Do what `decide` does, in `room`."""
    s, brains, room = borrowed(s), borrowed(brains), borrowed(room)
    zeta, open_, out = borrowed(rows)
    for r in range(len(slots)):
        i = slots[r]
        scores(
            s,
            zeta[r : r + 1],
            open_[r : r + 1],
            brains.f[i],
            brains.J[i],
            brains.cell_centre[i],
            brains.cell_count[i],
            brains.hope[i],
            room,
            out[r : r + 1],
        )


@compiled
def update(s, brains, ring, draws, ready, rate, loss_f, loss_j, ahead, start, stop):
    """Take one step on L_f and on L_J for every `ready` agent from `start` to `stop`, and score what is `ahead`."""
    parts, b, bf = ring.zeta.shape[2], draws.batch, draws.batch_f
    inputs = len(s.plain) + 2 * len(s.angle) + brains.cell_centre.shape[2]
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
    update_each(s, brains, ring, draws, ready, rate, loss_f, loss_j, ahead, start, stop, room, batch)
    set_control_word(word)


@compiled
def update_each(s, brains, ring, draws, ready, rate, loss_f, loss_j, ahead, start, stop, room, batch):
    """Do what `update` does, in `room` and `batch`."""
    s, brains, ring, draws, room = borrowed(s), borrowed(brains), borrowed(ring), borrowed(draws), borrowed(room)
    ahead = borrowed(ahead)
    g_f, g_j, at, at_f, zeta_f, after_f, time_f, done_f, zeta, pace, done, open_, table, goal, trained = borrowed(batch)
    parts, capacity = ring.zeta.shape[2], ring.zeta.shape[1]
    b, bf, m = draws.batch, draws.batch_f, draws.imagined
    base = len(s.plain) + 2 * len(s.angle)
    inputs = base + brains.cell_centre.shape[2]
    _, _, _, _, g3_f, gb3_f = layers(g_f, inputs, s.width)
    always = np.ones(1, np.bool_)  # J has one head
    rows = b if s.finite or s.minimum else 2 * b  # of learn_j
    for i in range(start, stop):
        if not ready[i]:
            continue
        uniform, cells, centres = draws.uniform[i], brains.cell_count[i], brains.cell_centre[i]
        k = base + cells
        # f
        positions(ring.lived[i], capacity, uniform[b:], draws.late_f, draws.recent, at_f)
        for r in range(bf):
            zeta_f[r], after_f[r] = ring.zeta[i, at_f[r]], ring.after[i, at_f[r]]
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
            zeta[r], done[r] = ring.zeta[i, at[r]], ring.movement[i, at[r]]
            for v in range(s.movements):
                open_[r, v] = ring.open[i, at[r], v] if s.minimum else v == max(done[r], 0)
        if m:
            imagine(s, zeta, uniform[b + bf :], draws.normal[i], m)
        if s.minimum or s.finite:
            scores(s, zeta, open_, brains.f[i], brains.target[i], centres, cells, brains.hope[i], room, table)
            for r in range(b):
                least = table[r, 0]
                for v in range(1, s.movements):
                    least = min(least, table[r, v])
                goal[r] = min(max(least, ZERO), s.ceiling)
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
                slow[p] += POLYAK * (fast[p] - slow[p])
        if ahead.open[i].any():
            here, options, table_ahead = ahead.zeta[i : i + 1], ahead.open[i : i + 1], ahead.score[i : i + 1]
            scores(s, here, options, brains.f[i], brains.J[i], centres, cells, brains.hope[i], room, table_ahead)


@compiled
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
    room = room_for(s, len(zeta), parts, 1, inputs, 1)
    deviations(s, zeta, brains.J[slot], brains.cell_centre[slot], brains.cell_count[slot], room)
    return room.outputs[: len(zeta)].copy()


@compiled
def slope_at(s, brains, slot, zeta):
    """Return dJn/dzeta (m, D) of one agent at zeta (m, D)."""
    parts, inputs = zeta.shape[1], len(s.plain) + 2 * len(s.angle) + brains.cell_centre.shape[2]
    room = room_for(s, len(zeta), parts, 1, inputs, len(zeta))
    slopes(s, zeta, brains.J[slot], brains.cell_centre[slot], brains.cell_count[slot], room)
    return room.slope


@compiled
def forecast_at(s, brains, slot, zeta):
    """Return f's outputs (m, M (D + 1)) of one agent at zeta (m, D), in its units."""
    inputs = len(s.plain) + 2 * len(s.angle) + brains.cell_centre.shape[2]
    out = np.empty((len(zeta), s.movements * (zeta.shape[1] + 1)), F)
    room = room_for(s, len(zeta), zeta.shape[1], 1, inputs, 1)
    forecast(s, zeta, brains.f[slot], brains.cell_centre[slot], brains.cell_count[slot], room, out)
    return out


@compiled
def forecast(s, zeta, f_row, centres, cells, room, out):
    """Fill out (m, M (D + 1)) with f at zeta (m, D), in its units."""
    base, rows = len(s.plain) + 2 * len(s.angle), len(zeta)
    k = base + cells
    w1, b1, w2, b2, w3, b3 = layers(f_row, base + centres.shape[1], s.width)
    x = shaped(room.inputs, rows, k)
    features(s, zeta, centres, x)
    h1, h2 = shaped(room.first, rows, s.width), shaped(room.second, rows, s.width)
    relu_layer(x, w1[:k], b1, h1)
    relu_layer(h1, w2, b2, h2)
    np.dot(h2, w3.T, out)
    out += b3
