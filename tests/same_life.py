"""Print a digest of whole lives, learners included: the same on every processor.

`python same_life.py [LIFE ...]` prints those of short lives, or of the ones that are named. With `--long` it lives the
long ones as different processors would, each in a fresh Python, and compares with `same_life.json`; it takes about half
an hour on two free cores, most of it compiling. `--long VARIANT ...` lives under some of the variants.
"""

import json
import os
import platform
import subprocess
import sys
import time
from pathlib import Path

from ecology.lab.certificate.reference import LEARNER, SCENARIO, TICKS
from ecology.lab.certificate.reference import digest as digest_of

HERE = Path(__file__).parent
LIVES = {  # scenario, its settings, learner and ticks
    "paper": (SCENARIO, {}, LEARNER, TICKS),
    "commons": ("commons", {"n": 300, "walls": True}, "lean", 60),
    "predator_prey": ("predator_prey", {}, "hjb", 150),
    "seasons": ("seasons", {}, "algorithm1", 300),
    "well_mixed": ("well_mixed", {}, "random", 300),
}
LONG = {
    "long_paper": ("paper", {}, "hjb", 5_000),
    "long_predator_prey": ("predator_prey", {}, "hjb", 2_000),
    "long_commons": ("commons", {"n": 300, "walls": True}, "lean", 1_000),
}
BEYOND = ("avx", "fma", "bmi", "f16c", "vaes", "vpclmul", "gfni", "sha512", "sm3", "sm4", "amx")  # SSE4.2 at most


def variants() -> dict[str, dict[str, str]]:
    """Return environments under which this machine computes as another processor would."""
    from llvmlite.binding import get_host_cpu_features

    off = ",".join(f"-{name}" for name in get_host_cpu_features() if name.startswith(BEYOND))
    return {
        "native": {},
        "generic": {"NUMBA_CPU_NAME": "generic"},
        "without fma and avx": {"NUMBA_CPU_FEATURES": off},
        "BLAS of Haswell": {"OPENBLAS_CORETYPE": "Haswell"},
        "BLAS of Nehalem": {"OPENBLAS_CORETYPE": "Nehalem"},
        "NumPy without vectors": {"NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL"},
        "one thread": {"NUMBA_NUM_THREADS": "1"},
    }


def digest(life: str) -> str:
    """Return a digest of one of LIVES or LONG."""
    return digest_of(*(LIVES | LONG)[life])


def compare(wanted: list[str]) -> bool:
    """Live the long lives under the variants `wanted`, print a table, and return whether all are the known ones."""
    known, good = json.loads((HERE / "same_life.json").read_text()), True
    print(f"{platform.machine()}, {os.cpu_count()} cores; known: {', '.join(known.get(life, '-') for life in LONG)}")
    for name, environment in variants().items():
        if wanted and name not in wanted:
            continue
        began = time.monotonic()
        done = subprocess.run(
            [sys.executable, __file__, *LONG], env={**os.environ, **environment},
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        found = dict(line.split() for line in done.stdout.splitlines())
        same = all(found.get(life) == known.get(life) for life in LONG)
        good &= same
        told = ", ".join(found.get(life, "-") for life in LONG)
        print(f"{name}: {told}; {'as known' if same else 'DIFFERENT'}, {time.monotonic() - began:.0f} s", flush=True)
        if done.returncode:
            print(done.stderr)
    return good


if __name__ == "__main__":
    if "--long" in sys.argv:
        sys.exit(not compare(sys.argv[sys.argv.index("--long") + 1 :]))
    for each in sys.argv[1:] or LIVES:
        print(each, digest(each), flush=True)
