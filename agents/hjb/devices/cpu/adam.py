"""Take a step of Adam (Kingma and Ba 2015) on the weights of one agent."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ecology.agents.hjb.devices import records
from ecology.agents.hjb.devices.cpu.arithmetic import FEW, ONE, ZERO, F, reshape
from ecology.agents.hjb.devices.cpu.compiler import within
from ecology.agents.hjb.devices.cpu.llvm import fetch, multiply_and_add

BETA1, BETA2 = F(records.BETA1), F(records.BETA2)
LINE = 16  # numbers in a line of the cache
SOON = 512  # numbers by which Adam's moments are fetched ahead of their use


class Row(NamedTuple):
    """One network of one agent, with Adam's moments."""

    w: np.ndarray  # (P,)
    first: np.ndarray
    second: np.ndarray
    steps: np.ndarray  # int (1 + heads,)


class Pace(NamedTuple):
    """How fast the weights move."""

    rate: float  # learning rate
    decay: np.float32  # of the weights of the last layer, per unit of the learning rate


class Extent(NamedTuple):
    """The part of a network that an update trains."""

    used: int  # inputs in use
    inputs: int  # inputs that there is room for
    rows: int  # of the batch


@within
def move(w, g, m, v, size, floor):
    """Return one weight and its moments after a step of Adam (Kingma and Ba 2015) along its gradient g."""
    first = multiply_and_add(ONE - BETA1, g - m, m)
    second = multiply_and_add(BETA2, v, (ONE - BETA2) * g * g)
    return w - size * first / (math.sqrt(second) + floor), first, second


@within
def correct(rate, steps):
    """Return the size and the floor of an Adam step, corrected for moments that began at zero."""
    correction = math.sqrt(1.0 - 0.999**steps)
    return F(rate * correction / (1.0 - 0.9**steps)), F(1e-8 * correction)


@within
def adam(row, g, start, stop, size, floor):
    """Move the weights from `start` to `stop` by one step of Adam along the gradient g (P,)."""
    w, g, m, v = row.w[start:stop], g[start:stop], row.first[start:stop], row.second[start:stop]
    for i in range(len(w)):
        w[i], m[i], v[i] = move(w[i], g[i], m[i], v[i], size, floor)


@within
def shrink(row, start, stop, factor):
    """Shrink the weights from `start` to `stop` by a factor: decay apart from the gradient (Loshchilov 2019)."""
    w = row.w[start:stop]
    for i in range(len(w)):
        w[i] *= factor


@within
def adam_across(row, start, x, up, size, floor, soon):
    """The same for the weights (k, H) from `start` on, whose gradient is x (b, k) transposed times up (b, H), b <= 2.

    The gradient is computed on the way, while the processor waits for the weights and their moments. `soon` are
    weights that are needed next.
    """
    w, m, v = row.w, row.first, row.second
    width, last = up.shape[1], len(up) - 1
    up0, up1 = up[0], up[last]
    for k in range(x.shape[1]):
        x0, x1 = x[0, k], x[last, k] if last else ZERO
        here = start + k * width
        for h in range(here, here + width, LINE):
            fetch(soon, h)
            fetch(m, h + SOON)
            fetch(v, h + SOON)
        wk, mk, vk = w[here : here + width], m[here : here + width], v[here : here + width]
        for h in range(width):
            wk[h], mk[h], vk[h] = move(wk[h], x0 * up0[h] + x1 * up1[h], mk[h], vk[h], size, floor)


@within
def step(s, row, g, pace, extent, trained, scratch, soon):
    """Take one step for one agent, after `learn_f` or `learn_j`.

    Of the last layer only the heads `trained` (M,) move; all have as many outputs, and their weights decay. The step
    counts of the hidden layers and of every head that moves are brought up to date.
    """
    width = s.width
    ends = extent.inputs * width
    last = ends + width + width * width + width
    outputs = (len(row.w) - last) // (width + 1)
    row.steps[0] += 1
    size, floor = correct(pace.rate, row.steps[0])
    if extent.rows > FEW:
        adam(row, g, np.int64(0), extent.used * width, size, floor)
        adam(row, g, ends, last, size, floor)
    else:
        x, hidden = reshape(scratch.inputs, extent.rows, extent.used), reshape(scratch.second, extent.rows, width)
        up1, up2 = reshape(scratch.third, extent.rows, width), reshape(scratch.fourth, extent.rows, width)
        adam_across(row, np.int64(0), x, up1, size, floor, soon)
        adam(row, g, ends, ends + width, size, floor)
        adam_across(row, ends + width, hidden, up2, size, floor, soon)
        adam(row, g, last - width, last, size, floor)
    each, biases = outputs // len(trained), last + outputs * width
    for o in range(len(trained)):
        if trained[o]:
            row.steps[1 + o] += 1
            size, floor = correct(pace.rate, row.steps[1 + o])
            if pace.decay > ZERO:
                shrink(row, last + o * each * width, last + (o + 1) * each * width, ONE - F(pace.rate) * pace.decay)
            adam(row, g, last + o * each * width, last + (o + 1) * each * width, size, floor)
            adam(row, g, biases + o * each, biases + (o + 1) * each, size, floor)
