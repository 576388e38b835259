"""Series of figures are told apart without colour, and show their seeds."""

from __future__ import annotations

import itertools

import numpy as np

from ecology.lab.certificate import answers
from ecology.observers.plotting import draw_means, new_figure, style


def test_no_two_series_look_alike():
    """Each of the first 49 series has a look of its own; neighbours differ by marker and line, not by colour alone."""
    looks = [style(i) for i in range(49)]
    assert len({(look.colour, look.marker) for look in looks}) == len(looks)
    assert all(a.marker != b.marker and a.line != b.line for a, b in itertools.pairwise(looks))


def test_means_show_their_seeds():
    """The interval is the one given, every seed has a dot beside its mean, and one run has neither."""
    figure = new_figure((4, 3))
    ax = figure.add_subplot()
    draw_means(ax, [0, 1], [2.0, 5.0], [[1.0, np.nan], [3.0, np.nan]], [[1.5, 2.5], [5.0]], style(0), wide=1.0)
    (dots,) = [line for line in ax.lines if line.get_marker() == "."]
    assert dots.get_ydata().tolist() == [1.5, 2.5]
    assert (dots.get_xdata() > 0).all()
    (bars,) = ax.containers
    spans = [segment[:, 1].tolist() for segment in bars[2][0].get_segments()]
    assert spans == [[1.0, 3.0], [5.0, 5.0]]


def test_a_band_names_its_interval():
    """The figure says what its bars are, and the legend how many seeds there are."""
    figure = new_figure((4, 3))
    ax = figure.add_subplot()
    answers.band(ax, [0, 1], [[1.0, 2.0, 3.0], [1.0, 2.0]], "f/J")
    assert figure.get_supxlabel() == answers.INTERVAL
    assert "95 % t interval" in answers.INTERVAL
    assert ax.get_legend_handles_labels()[1] == ["f/J, 2 to 3 seeds"]
