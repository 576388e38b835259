"""Arithmetic that the kernels share and that torch brings along: products, layers and activations in float32.

Every sum has a fixed order and every step a fixed rounding, so the results are the same bits on every processor.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ecology.agents.hjb.devices import records
from ecology.agents.hjb.devices.cpu.compiler import within
from ecology.agents.hjb.devices.cpu.llvm import LANES, ROWS, dot, matrix, multiply_and_add, strip_of_one, strip_of_rows
from ecology.elementary import power

F = np.float32
ZERO, HALF, ONE, TWO = F(0), F(0.5), F(1), F(2)
BIAS, LOG2E, LN2_HIGH, LN2_LOW = F(127), F(1.44269504), F(0.693359375), F(-2.12194440e-4)
E6, E5, E4 = F(1.9875691500e-4), F(1.3981999507e-3), F(8.3334519073e-3)  # exp, after Cephes' expf
E3, E2, E1 = F(4.1665795894e-2), F(1.6666665459e-1), F(5.0000001201e-1)
TURN = F(2 * math.pi)
LONGEST = F(records.LONGEST)
FEW = 2  # rows up to which gradients are computed on the way of Adam, without matrices of their own


class Scratch(NamedTuple):
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
    mixed: np.ndarray  # (D,) of the drive
    slope: np.ndarray  # (b, D)


@within
def scratch_for(s, rows, parts, outputs, inputs, b):
    """Return room for `rows` states at once, of which `b` may be followed by as many tangents."""
    flat = max(rows, 2 * b) * max(s.width, 1)
    return Scratch(
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
def transpose(w):
    """Return w (k, H) as (H, k), rows without gaps."""
    found = np.empty((w.shape[1], w.shape[0]), F)
    for k in range(w.shape[0]):
        for h in range(w.shape[1]):
            found[h, k] = w[k, h]
    return found


@within
def exp32(x):
    """Return e^x for x > -87 within 3e-7 of itself, in instructions that vectorise."""
    biased = np.int32(multiply_and_add(x, LOG2E, HALF) + BIAS)  # the exponent of the result, as float32 holds it
    n = F(biased) - BIAS
    r = multiply_and_add(-n, LN2_LOW, multiply_and_add(-n, LN2_HIGH, x))
    p = multiply_and_add(
        multiply_and_add(multiply_and_add(multiply_and_add(multiply_and_add(E6, r, E5), r, E4), r, E3), r, E2), r, E1
    )
    return (multiply_and_add(p, r * r, r) + ONE) * np.int32(biased << np.int32(23)).view(F)


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
def reshape(flat, rows, columns):
    """Return the beginning of a flat array as (rows, columns)."""
    return matrix(flat, 0, rows, columns)


@within
def raise_to(x, exponent):
    """Return x^exponent of x > 0."""
    if exponent == HALF:
        return math.sqrt(x)
    return ONE / math.sqrt(x) if exponent == -HALF else F(power(np.float64(x), np.float64(exponent)))


@within
def output(row, w, b):
    """Return w . row + b, a single output."""
    if len(row) % LANES == 0:
        return dot(w, row) + b
    total = ZERO
    for h in range(len(row)):
        total = multiply_and_add(w[h], row[h], total)
    return total + b


@within
def product_back(g, w, out):
    """Fill out (b, k) with g (b, H) times the transpose of w (k, H)."""
    if len(g) > FEW:
        multiply(g, transpose(w), out)
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
def sum_rows(g, out):
    """Fill out (H,) with the sum over the rows of g (b, H)."""
    out[:] = ZERO
    for r in range(len(g)):
        for h in range(len(out)):
            out[h] += g[r, h]


@within
def activate(z, bias, out, b):
    """Add the bias to z's first b rows and fill those of out with silu(z)."""
    for r in range(b):
        for h in range(len(bias)):
            z[r, h] += bias[h]
            out[r, h] = z[r, h] * sigmoid(z[r, h])


@within
def deactivate(z, up, b):
    """Turn the first b rows of the gradient `up` of silu(z) into that of z, in place."""
    for r in range(b):
        for h in range(z.shape[1]):
            at = z[r, h]
            g = sigmoid(at)
            up[r, h] *= g * (ONE + at * (ONE - g))
