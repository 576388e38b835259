"""The tests themselves: their order is random and printed, and `--luck` reaches every random seed."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

from conftest import PATIENCE

DRAWN = """
import numpy as np

def test_a():
    seed = np.random.SeedSequence(7)
    child = np.random.SeedSequence(seed.entropy, spawn_key=(0,), pool_size=seed.pool_size)
    draws = [np.random.default_rng(each).integers(10**9) for each in (7, [7, 1], seed, child, seed.spawn(1)[0])]
    assert draws[3] == draws[4]
    print("drawn", draws[0] == draws[2], len(set(draws)), *map(int, draws))
"""


def test_luck_reaches_every_seed_and_the_order_is_told(tmp_path: Path) -> None:
    """Every seed gives another stream under `--luck`, and the report ends with the seed of the order."""
    shutil.copy(Path(__file__).with_name("conftest.py"), tmp_path)
    (tmp_path / "test_drawn.py").write_text(DRAWN)

    def drawn(luck: int) -> str:
        words = [sys.executable, "-m", "pytest", "-q", "-s", f"--luck={luck}", "-p", "no:cacheprovider", str(tmp_path)]
        words += ["-p", "no:hypothesispytest"]
        done = subprocess.run(
            [*words, "--randomly-seed=5"], cwd=tmp_path, capture_output=True, text=True, check=False, timeout=PATIENCE
        )
        assert done.returncode == 0, done.stdout + done.stderr
        assert "to repeat it: pytest --randomly-seed=5" in done.stdout
        return re.search(r"drawn True 3 [\d ]+", done.stdout)[0]

    plain, other = drawn(0), drawn(1)
    assert not set(plain.split()[3:]) & set(other.split()[3:])
