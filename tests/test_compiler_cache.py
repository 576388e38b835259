"""Compiled functions are kept wherever something can be written, and nobody else can slip one in."""

from __future__ import annotations

import ast
import ctypes
import importlib
import os
import pickle
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import numba
import numpy as np
import pytest
from numba import types
from numba.core.dispatcher import Dispatcher

import ecology
from ecology import EcologyError, actions, compiler_cache, scenarios

ROOT = Path(__file__).parent.parent
CODE = """
import sys
import numpy as np
import ecology.agents.hjb
from ecology import physics
physics.fastest(np.zeros((1, 2)))
print(physics.__file__, physics.fastest.stats.cache_path, sum(physics.fastest.stats.cache_hits.values()))
"""
DROP, WRITE_ANYWHERE = 24, 1  # PR_CAPBSET_DROP and CAP_DAC_OVERRIDE of Linux


@pytest.fixture
def read_only(tmp_path: Path) -> Iterator[Path]:
    """Return a folder with a copy of the packages and an empty home, in which nothing can be written."""
    place = tmp_path / "read_only"
    (place / "home").mkdir(parents=True)
    for name, folder in (("ecology", "ecology"), ("agents", "ecology/agents"), ("scenarios", "ecology/scenarios")):
        shutil.copytree(ROOT / name, place / folder, ignore=shutil.ignore_patterns("__pycache__"))
    folders = [place, *(path for path in place.rglob("*") if path.is_dir())]
    for folder in folders:
        folder.chmod(0o555)
    yield place
    for folder in folders:
        folder.chmod(0o755)


def obey_permissions() -> None:
    """Let permissions bind the superuser too, in a process that is about to start."""
    if hasattr(os, "geteuid") and os.geteuid() == 0:
        ctypes.CDLL(None).prctl(DROP, WRITE_ANYWHERE, 0, 0, 0)


def start(place: Path, temporary: Path) -> subprocess.CompletedProcess[str]:
    """Run `CODE` with the packages in `place`, a home there, and a temporary folder."""
    env = {key: value for key, value in os.environ.items() if not key.startswith(("NUMBA_", "XDG_"))}
    env |= {"PYTHONPATH": str(place), "HOME": str(place / "home"), "TMPDIR": str(temporary)}
    return subprocess.run(
        [sys.executable, "-B", "-c", CODE], cwd=place, env=env, capture_output=True, text=True, check=False,
        preexec_fn=obey_permissions,
    )  # fmt: skip


@pytest.mark.skipif(sys.platform == "win32", reason="permissions of folders are other ones")
def test_functions_compile_where_neither_install_nor_home_can_be_written(read_only: Path, tmp_path: Path) -> None:
    """The first process keeps what it compiles in a temporary folder of this user, the second one loads it."""
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    for hits in (0, 1):
        done = start(read_only, temporary)
        assert done.returncode == 0, done.stderr
        module, cache, loaded = done.stdout.split()
        assert Path(module).is_relative_to(read_only)
        assert Path(cache).is_relative_to(temporary)
        assert int(loaded) == hits
    assert not list(read_only.rglob("*.nb?"))


@pytest.fixture
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the temporary folder of this process, an empty one."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


def test_a_cache_that_can_be_written_is_left_as_it_is(monkeypatch: pytest.MonkeyPatch, temporary: Path) -> None:
    """Nothing is set where Numba has a folder."""
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setattr(compiler_cache.numba.config, "CACHE_LOCATOR_CLASSES", "", raising=False)  # Numba's own
    monkeypatch.setattr(compiler_cache.numba.config, "CACHE_DIR", "")
    compiler_cache.use_cache(str(temporary / "module.py"))  # not there: no folder beside it
    chosen = os.environ.pop("NUMBA_CACHE_DIR")
    assert Path(chosen).parent == temporary
    monkeypatch.setattr(compiler_cache.numba.config, "CACHE_DIR", "")
    (temporary / "module.py").write_text("")
    compiler_cache.use_cache(str(temporary / "module.py"))
    assert "NUMBA_CACHE_DIR" not in os.environ


def test_the_temporary_folder_is_the_same_and_private(temporary: Path) -> None:
    """Every process of a user has the same folder, which nobody else can enter."""
    folder = compiler_cache._temporary_folder()
    assert compiler_cache._temporary_folder() == folder
    assert folder.parent == temporary
    if hasattr(os, "getuid"):
        assert folder.stat().st_mode & 0o777 == 0o700


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="temporary folders are the user's own")
@pytest.mark.parametrize("trap", ["link", "loose", "foreign", "file"])
def test_a_folder_of_someone_else_is_not_used(temporary: Path, monkeypatch: pytest.MonkeyPatch, trap: str) -> None:
    """A link, a folder that others can write and a folder of another user are passed over for a new one."""
    taken = temporary / f"ecology-numba-{os.getuid()}"
    if trap == "link":
        (temporary / "elsewhere").mkdir()
        taken.symlink_to(temporary / "elsewhere")
    elif trap == "file":
        taken.write_text("")
    else:
        taken.mkdir()
        taken.chmod(0o777 if trap == "loose" else 0o700)
    if trap == "foreign":
        owner = taken.lstat().st_uid
        taken.rename(temporary / f"ecology-numba-{owner + 1}")
        monkeypatch.setattr(os, "getuid", lambda: owner + 1)
    folder = compiler_cache._temporary_folder()
    assert folder.parent == temporary
    assert folder.name.startswith("ecology-numba-")
    assert folder.name.count("-") == 3  # a new one, with a name of its own
    assert list(folder.iterdir()) == []


def test_where_nothing_can_be_written_the_error_says_what_to_set(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without any folder there is one error, and it names the variables to set."""

    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "mkdir", refuse)
    monkeypatch.setattr(tempfile, "mkdtemp", refuse)
    with pytest.raises(EcologyError, match="NUMBA_CACHE_DIR or TMPDIR"):
        compiler_cache._temporary_folder()


def files_inlined(function: Dispatcher) -> set[str]:
    """Return the files of all functions that Numba compiles into `function`, directly or through others."""
    words = function.py_func.__globals__
    called = [words.get(name) for name in function.py_func.__code__.co_names]
    found: set[str] = set()
    for each in called:
        if isinstance(each, Dispatcher):
            found |= {each.py_func.__code__.co_filename, *files_inlined(each)}
    return found


def files_named(module: ModuleType) -> set[str]:
    """Return the files that `module` names when it calls `use_cache`."""
    for node in ast.walk(ast.parse(Path(str(module.__file__)).read_text())):
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "use_cache":
            return {str(eval(ast.unparse(each), vars(module))) for each in node.args[1:]}
    return set()


def test_a_file_names_all_files_that_it_inlines() -> None:
    """Where a compiled loop calls one of another file, a change of that file compiles it again."""
    compiled = 0
    for path in sorted((ROOT / "ecology").rglob("*.py")):
        if "use_cache(__file__" not in path.read_text():
            continue
        name = ".".join(path.relative_to(ROOT).with_suffix("").parts)
        module = importlib.import_module(name)
        loops = [getattr(value, "dispatcher", value) for value in vars(module).values()]
        own = [each for each in loops if isinstance(each, Dispatcher) and each.py_func.__module__ == name]
        inlined = set().union(*map(files_inlined, own)) - {str(path)}
        assert files_named(module) == inlined, name
        compiled += len(own)
    assert compiled > 25


def test_a_loop_is_given_records_field_by_field() -> None:
    """A loop that takes records sees them as Python does, and Numba is called with arrays and numbers alone."""
    env = ecology.Ecology(scenarios.load("predator_prey"))
    env.reset_arrays(0)
    model, state, seen = env.world.model, env.world.state, env.world.perception
    for group, table in model.acting:
        mine = seen.targets[group.name], table.conditions
        given = (group.slots.start, state.bodies(), state.internal, seen.here, seen.toward, *mine)
        assert np.array_equal(actions.open_masks(*given), actions.open_masks.__wrapped__(*given))
    (signature,) = actions.open_masks.dispatcher.signatures
    assert not [each for each in signature if isinstance(each, types.BaseTuple)]


LEAF, ROOT_KERNEL = "leaf.py", "root.py"
KERNELS = {
    LEAF: """
import numba
from pathlib import Path
from ecology.compiler_cache import keep_compiled
SOURCES = tuple(sorted(Path(__file__).parent.glob("*.py")))
def compiled(function):
    return keep_compiled(numba.njit(function), SOURCES)
@compiled
def leaf(x):
    return x + 1
""",
    ROOT_KERNEL: """
from leaf import compiled, leaf
from ecology.compiler_cache import is_kept
@compiled
def root(x):
    return 10 * leaf(x)
kept = is_kept(root)
print(kept, root(1), sum(root.stats.cache_hits.values()))
""",
}


def write_kernels(folder: Path) -> None:
    """Write the two files of kernels."""
    for name, text in KERNELS.items():
        (folder / name).write_text(text)


def run_kernels(folder: Path) -> list[str]:
    """Return what the program prints: whether code was kept, the result, and the number of cache hits."""
    done = subprocess.run(
        [sys.executable, "-B", str(folder / ROOT_KERNEL)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


def test_compiled_code_is_kept_until_any_of_its_sources_changes(tmp_path: Path) -> None:
    """A kernel is compiled again after a change in another file that it calls, also one with an older date."""
    write_kernels(tmp_path)
    assert run_kernels(tmp_path) == ["False", "20", "0"]
    assert run_kernels(tmp_path) == ["True", "20", "1"]
    (tmp_path / LEAF).write_text(KERNELS[LEAF].replace("x + 1", "x + 2"))
    os.utime(tmp_path / LEAF, (1_000, 1_000))
    assert run_kernels(tmp_path) == ["False", "30", "0"]
    assert run_kernels(tmp_path) == ["True", "30", "1"]


def test_code_kept_for_a_class_that_was_renamed_is_compiled_again(tmp_path: Path) -> None:
    """The index that an older version of the package left counts as none."""
    write_kernels(tmp_path)
    assert run_kernels(tmp_path) == ["False", "20", "0"]
    for index in tmp_path.rglob("root.root-*.nbi"):
        index.write_bytes(pickle.dumps(numba.__version__) + b"cleaf\nRenamed\n.")  # a reference to leaf.Renamed
    assert run_kernels(tmp_path) == ["False", "20", "0"]
    assert run_kernels(tmp_path) == ["True", "20", "1"]
