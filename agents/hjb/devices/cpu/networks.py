"""Evaluate the networks of one agent: f for the transitions, J for the deviations."""

from __future__ import annotations

from ecology.agents.hjb.devices.cpu.arithmetic import output, product_back, relu_layer, reshape, silu_layer
from ecology.agents.hjb.devices.cpu.compiler import within
from ecology.agents.hjb.devices.cpu.encoding import drive, features
from ecology.agents.hjb.devices.cpu.llvm import matrix


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
def inputs_of(s, weights):
    """Return how many inputs the networks of one agent, or of all, have: components, and room for place cells."""
    return len(s.plain) + 2 * len(s.angle) + weights.centres.shape[-1]


@within
def hidden_layer(s, own, zeta, scratch):
    """Return the second hidden layer (b, H) of f at zeta (b, D).

    Inputs stay in scratch.inputs and the first layer in scratch.second, where `adam.step` expects them.
    """
    rows, width = len(zeta), s.width
    k = len(s.plain) + 2 * len(s.angle) + own.cells
    w1, b1, w2, b2, _, _ = layers(own.f, inputs_of(s, own), width)
    x = reshape(scratch.inputs, rows, k)
    features(s, zeta, own.centres, x)
    first, second = reshape(scratch.second, rows, width), reshape(scratch.first, rows, width)
    relu_layer(x, w1[:k], b1, first)
    relu_layer(first, w2, b2, second)
    return second


@within
def forecast(s, own, zeta, scratch, out):
    """Fill out (b, M E) with f of all movements at zeta (b, D), in its units."""
    second = hidden_layer(s, own, zeta, scratch)
    _, _, _, _, w3, b3 = layers(own.f, inputs_of(s, own), s.width)
    product_back(second, w3, out)
    for r in range(len(out)):
        for o in range(len(b3)):
            out[r, o] += b3[o]


@within
def deviations(s, own, zeta, scratch):
    """Leave Jn of zeta (b, D), drive units, in scratch.outputs."""
    rows, width = len(zeta), s.width
    k = len(s.plain) + 2 * len(s.angle) + own.cells
    w1, b1, w2, b2, w3, b3 = layers(own.J, inputs_of(s, own), width)
    x = reshape(scratch.inputs, rows, k)
    features(s, zeta, own.centres, x)
    first, second = reshape(scratch.first, rows, width), reshape(scratch.second, rows, width)
    silu_layer(x, w1[:k], b1, first)
    silu_layer(first, w2, b2, second)
    for r in range(rows):
        base = drive(s, zeta[r], scratch.mixed) if s.anchored else s.centre_j
        scratch.outputs[r] = base + s.spread_j * output(second[r], w3[0], b3[0])
