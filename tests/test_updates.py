"""The table of what updates cost: that it counts and times what it says, not how fast that is."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ecology.agents.hjb import devices
from ecology.agents.hjb.devices.cpu import device as cpu
from ecology.agents.hjb.devices.torch.device import Torch
from ecology.lab.bench import updates


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Time every call once or twice."""
    monkeypatch.setattr(updates, "WINDOW", 0.0)
    monkeypatch.setattr(cpu, "WORKERS", cpu.WORKERS)  # which the command changes


def test_a_row_counts_weights_and_takes_ratios(capsys: pytest.CaptureFixture[str]) -> None:
    """Weights are those of both networks; the kernels move one head of f in fourteen; ratios are of the times told."""
    found = updates.cost(3, 8, "cpu", 1)
    zeta, actions, width = 9, 14, 8
    hidden = (zeta + 1) * width + width + width * width + width  # the heading is a cosine and a sine
    head = (zeta + 1) * (width + 1)
    assert found.weights == hidden + actions * head + hidden + width + 1
    assert found.moved == hidden + head + hidden + width + 1
    assert min(found.update, found.score, found.floor, found.plain) > 0
    updates.main(["--agents", "1,3", "--widths", "8", "--rounds", "1"])
    *_, one, three = (line.split(" | ") for line in capsys.readouterr().out.splitlines())
    assert [one[0], one[3], three[3]] == ["| 8", "1", "3"]
    update, score, floor, plain = (float(three[k].replace(",", "")) for k in (4, 5, 8, 10))
    assert float(three[6].replace(",", "")) == pytest.approx(3e3 / update, rel=0.01)
    assert float(three[7]) == pytest.approx(3 * found.moved * 24 / update / 1e6, rel=0.02)
    assert float(three[9]) == pytest.approx(update / floor, rel=0.02, abs=0.06)
    assert float(three[11].removesuffix(" |").replace(",", "")) == pytest.approx(
        plain / (update + score), rel=0.02, abs=0.6
    )


def test_what_is_timed_is_an_update_of_everyone() -> None:
    """Both networks of all agents take a step from their own transition, on which alone they have lived."""
    learner, zeta, open_ = updates.population(4, 8, "cpu")
    assert learner.memory.count.tolist() == [1] * 4
    assert zeta.shape == (4, 9)
    assert open_[np.arange(4), learner.memory.movement[:, 0]].all()
    learner._update(np.ones(4, bool))
    assert learner.f.steps[:, 0].tolist() == learner.J.steps[:, 0].tolist() == [1] * 4


def test_on_another_device_all_weights_count(monkeypatch: pytest.MonkeyPatch) -> None:
    """Torch moves rows as a whole; the plain loop is for the kernels alone."""
    monkeypatch.setattr(devices, "make", lambda name, encoding, n: Torch(encoding, "cpu"))
    found = updates.cost(3, 8, "cuda", 1)
    assert found.moved == found.weights
    assert min(found.update, found.score, found.floor) > 0
    assert math.isnan(found.plain)


@pytest.mark.parametrize("words", [["--agents", "0"], ["--widths", "many"], ["--device", "cuda:99"], ["--rounds", "0"]])
def test_what_cannot_be_measured_is_refused(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    """A user's error is a message with what was given and exit code 2."""
    with pytest.raises(SystemExit) as stop:
        updates.main(words)
    assert stop.value.code == 2
    assert words[1] in capsys.readouterr().err
