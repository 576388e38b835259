"""The package as others get it: built, installed elsewhere, whole."""

from __future__ import annotations

import itertools
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import typing
from pathlib import Path

import pytest

import ecology
from ecology import agents, scenarios
from ecology.env import EnvOptions

ROOT = Path(__file__).parent.parent
FOLDERS = {"ecology": "ecology", "agents": "ecology/agents", "scenarios": "ecology/scenarios"}  # here -> installed
LINE = "import ecology.agents.loop, ecology.lab.cli; print(ecology.__file__, ecology.agents.__file__)"


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder in which the package was installed from a copy of its sources."""
    source, target = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("target")
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    for name in FOLDERS:
        shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__"))
    subprocess.run(
        [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-deps",
         "--no-build-isolation", "--no-index", "--target", str(target), str(source)],
        check=True, capture_output=True, text=True,
    )  # fmt: skip
    return target


def _python(installed: Path, *words: str) -> str:
    where = {"PYTHONPATH": str(installed)}
    done = subprocess.run(
        [sys.executable, *words], cwd=installed, env=where, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def _files(folder: Path) -> list[Path]:
    """Return the files under `folder`, but what Python and Numba made of them."""
    return [path for path in folder.rglob("*") if path.is_file() and "__pycache__" not in path.parts]


def test_every_module_is_installed(installed: Path) -> None:
    """What lies in the packages' folders here is what an install brings."""
    for name, folder in FOLDERS.items():
        here = {path.relative_to(ROOT / name) for path in _files(ROOT / name)}
        there = {path.relative_to(installed / folder) for path in _files(installed / folder)}
        assert here - there == set(), "add the package to [tool.setuptools] in pyproject.toml"


def test_an_install_works_away_from_the_checkout(installed: Path) -> None:
    """The installed package imports itself, lists its scenarios and writes a new one."""
    paths = _python(installed, "-c", LINE).split()
    assert all(path.startswith(str(installed)) for path in paths)
    listed = _python(installed, "-m", "ecology.lab.cli", "list")
    assert all(name in listed for name in scenarios.names())
    _python(installed, "-m", "ecology.lab.cli", "new", "fresh")
    assert (installed / "fresh.py").is_file()


def test_type_checkers_read_the_installed_packages(installed: Path) -> None:
    """Every package says that it has types, and so that misspelt options are found."""
    assert all((installed / name / "py.typed").is_file() for name in FOLDERS.values())


def test_the_options_of_parallel_env_are_typed() -> None:
    """`parallel_env` names the options of `Ecology` to type checkers."""
    options = typing.get_type_hints(EnvOptions)
    constructor = typing.get_type_hints(ecology.Ecology.__init__)
    assert options == {name: kind for name, kind in constructor.items() if name not in ("scenario", "return")}
    assert typing.get_type_hints(ecology.parallel_env)["options"] == typing.Unpack[EnvOptions]


def test_the_source_distribution_holds_what_its_tests_need(tmp_path: Path) -> None:
    """All tests, documents and the files that they read are in it; of what was made here, nothing."""
    made = shutil.ignore_patterns("__pycache__", "*.egg-info")
    source = tmp_path / "source"
    source.mkdir()
    top = (".gitignore", "CHANGELOG.md", "CONTRIBUTING.md", "LICENSE", "MANIFEST.in", "Makefile", "README.md",
           "constraints.txt", "noxfile.py", "pyproject.toml")  # fmt: skip
    folders = (*FOLDERS, "tests", "docs")
    for name in top:
        shutil.copy(ROOT / name, source)
    for name in folders:
        shutil.copytree(ROOT / name, source / name, ignore=made)
    build = "from setuptools import build_meta; build_meta.build_sdist('.')"
    done = subprocess.run([sys.executable, "-c", build], cwd=source, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    (archive,) = source.glob("*.tar.gz")
    with tarfile.open(archive) as packed:
        inside = {path.partition("/")[2] for path in packed.getnames()}
    wanted = {path.relative_to(ROOT).as_posix() for name in folders for path in _files(ROOT / name)}
    assert {*wanted, *top} - inside == set()


def test_the_project_has_its_names_to_itself() -> None:
    """All three packages are this checkout's."""
    for package in (ecology, agents, scenarios):
        assert Path(package.__file__ or "").parent == ROOT / package.__name__.rpartition(".")[2], (
            f"another package {package.__name__!r} at {package.__file__} hides the project's; install "
            "the project into a virtual environment of its own (make install)."
        )


def test_constraints_pin_every_direct_dependency() -> None:
    """constraints.txt names one version of everything that pyproject.toml asks for."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    asked = [*project["dependencies"], *itertools.chain(*project["optional-dependencies"].values())]
    names = {re.split(r"[\[<>=]", line)[0] for line in asked}
    lines = [line for line in (ROOT / "constraints.txt").read_text().splitlines() if not line.startswith("#")]
    assert all("==" in line for line in lines)
    assert {line.partition("==")[0] for line in lines} == names - {project["name"]}  # an extra may name another
