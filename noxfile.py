"""Run the tests on other versions, for a generic processor, in other orders, with other seeds and without a home.

`nox --list` prints the sessions, `nox -s lowest` runs one, `nox -s lowest -- tests/test_run.py` runs a part of it.
Nox is not a dependency of the project: `pipx install nox`.
"""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import nox

TORCH = "torch==2.13.0"  # exactly: a newer release is a download of gigabytes
PROJECT = tomllib.loads(Path("pyproject.toml").read_text(encoding="utf-8"))["project"]

nox.options.default_venv_backend = "venv"
nox.options.sessions = ["lowest", "newest"]


def install(session: nox.Session, constraints: list[str]) -> None:
    """Install the project with its tests under `constraints`, torch always as TORCH."""
    path = Path(session.create_tmp()) / "constraints.txt"
    kept = [line for line in constraints if not re.match(r"torch\b", line)]
    path.write_text("\n".join([*kept, TORCH]) + "\n", encoding="utf-8")
    session.install("-c", str(path), TORCH)
    session.install("-c", str(path), "-e", ".[dev]")
    session.run("python", "-m", "pip", "list")


def run_tests(session: nox.Session, *options: str, **variables: str | None) -> None:
    """Run the tests that were named after `--`, or all, with environment `variables`."""
    numba = str(Path(session.create_tmp()) / "numba")  # of this session alone
    own = {"NUMBA_CACHE_DIR": numba, "PYTHONDONTWRITEBYTECODE": None}
    parallel = ("-n", "auto", "--dist", "loadfile")
    session.run("pytest", *parallel, *options, *session.posargs, env={**own, **variables})


@nox.session
def lowest(session: nox.Session) -> None:
    """Test on the lowest version of every direct dependency that pyproject.toml allows."""
    extras = PROJECT["optional-dependencies"]
    wanted = [*PROJECT["dependencies"], *extras["dev"], *extras["docs"]]
    bounded = [requirement for requirement in wanted if not requirement.startswith(PROJECT["name"])]
    install(session, [re.sub(r">=([^,;]+)[^;]*", r"==\1", requirement) for requirement in bounded])
    run_tests(session)


@nox.session
def newest(session: nox.Session) -> None:
    """Test on the newest version of every dependency that pyproject.toml allows, but for torch."""
    install(session, [])
    run_tests(session)


@nox.session
def generic(session: nox.Session) -> None:
    """Test with loops that are compiled for any processor of this kind, without what is special to this one."""
    install(session, Path("constraints.txt").read_text(encoding="utf-8").splitlines())
    run_tests(session, NUMBA_CPU_NAME="generic")


@nox.session
def order(session: nox.Session) -> None:
    """Test in three random orders; each prints its seed."""
    install(session, Path("constraints.txt").read_text(encoding="utf-8").splitlines())
    for _ in range(3):
        run_tests(session)


@nox.session
def luck(session: nox.Session) -> None:
    """Test with three other numbers mixed into every random seed: no test may depend on the luck of one."""
    install(session, Path("constraints.txt").read_text(encoding="utf-8").splitlines())
    for number in ("1", "2", "3"):
        run_tests(session, "--luck", number)


@nox.session
def homeless(session: nox.Session) -> None:
    """Test with a home that cannot be written to, by root either, and no compiled loops beside the source."""
    install(session, Path("constraints.txt").read_text(encoding="utf-8").splitlines())
    run_tests(
        session,
        "-p",
        "no:cacheprovider",
        HOME="/dev/null/home",
        XDG_CACHE_HOME=None,
        PYTHONDONTWRITEBYTECODE="1",
        NUMBA_CACHE_DIR=None,
        NUMBA_CACHE_LOCATOR_CLASSES="UserProvidedCacheLocator,UserWideCacheLocator",
    )
