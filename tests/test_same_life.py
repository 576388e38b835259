"""One seed is one life: the digests of whole lives are those in the repository, on whatever processor this is."""

import json
import os
import platform
import subprocess
import sys
from pathlib import Path

import pytest
from same_life import LIVES, digest

from ecology.lab.certificate import reference

HERE = Path(__file__).parent
KNOWN = json.loads((HERE / "same_life.json").read_text())
NUMPY = {"NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL", "OPENBLAS_CORETYPE": "Haswell"}
COMPILERS = [{"NUMBA_CPU_NAME": "haswell"}, {"NUMBA_CPU_NAME": "generic"}]


def lived_with(environment: dict[str, str], *lives: str) -> dict[str, str]:
    """Return the digests of lives in a fresh Python."""
    done = subprocess.run(
        [sys.executable, str(HERE / "same_life.py"), *lives], env={**os.environ, **environment},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return dict(line.split() for line in done.stdout.splitlines())


@pytest.mark.one_seed("the digests are of one life")
@pytest.mark.parametrize("life", LIVES)
def test_a_life_is_the_same_here(life: str) -> None:
    """World and learners come to the same bits as where the digest was taken.

    After a change that is meant to change lives: `python tests/same_life.py` prints the new digests.
    """
    assert digest(life) == KNOWN[life]


@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="names kinds of x86-64 processors")
def test_a_life_does_not_depend_on_numpy_or_blas() -> None:
    """Without NumPy's vector instructions, and with the BLAS of another core, lives are the same."""
    lives = ("commons", "seasons", "well_mixed")
    assert lived_with(NUMPY, *lives) == {life: KNOWN[life] for life in lives}


@pytest.mark.skipif("ECOLOGY_PORTABLE" not in os.environ, reason="compiles everything anew: set ECOLOGY_PORTABLE=1")
@pytest.mark.parametrize("environment", COMPILERS, ids=lambda each: each["NUMBA_CPU_NAME"])
def test_a_life_does_not_depend_on_the_compiler_s_target(environment: dict[str, str]) -> None:
    """Compiled for another processor, lives are the same."""
    assert lived_with(environment) == {life: KNOWN[life] for life in LIVES}


def test_results_name_the_reference_life(monkeypatch: pytest.MonkeyPatch) -> None:
    """`ecology reproduce` says whether this machine gives the published digest, and what else it gives."""
    assert KNOWN["paper"] == reference.PUBLISHED
    monkeypatch.setattr(reference, "here", lambda: reference.PUBLISHED)
    assert reference.line().endswith("as published.")
    monkeypatch.setattr(reference, "here", lambda: "0123456789abcdef")
    assert f"0123456789abcdef, published {reference.PUBLISHED}" in reference.line()
