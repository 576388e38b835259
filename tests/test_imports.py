"""Who may know whom: read from what is loaded and from the source itself."""

import ast
import functools
import json
import re
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

import ecology

ROOT = Path(__file__).parent.parent
PACKAGES = {"ecology": "ecology", "agents": "ecology.agents", "scenarios": "ecology.scenarios"}  # folder -> name


def loaded_by(statement, tmp_path):
    """Return what a fresh Python, started elsewhere, has loaded after `statement`: module names and files."""
    code = (
        f"{statement}\nimport json, sys\n"
        "print(json.dumps({name: getattr(module, '__file__', None) for name, module in sys.modules.items()}))"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@functools.cache
def tree_of(path):
    """Return the syntax tree of a source file."""
    return ast.parse(path.read_text(encoding="utf-8"))


@functools.cache
def imports(path):
    """Return the packages that a source file imports, wherever it does: top names, and "ecology.PART"."""
    names = set()
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return {name.partition(".")[0] for name in names} | {".".join(name.split(".")[:2]) for name in names}


def importing(name, package):
    """Return the files of a package, relative to the root, that import `name`."""
    files = sorted((ROOT / package).rglob("*.py"))
    assert files, f"there is no package {package} in {ROOT}"
    return {path.relative_to(ROOT).as_posix() for path in files if name in imports(path)}


def test_importing_ecology_is_light(tmp_path):
    """`import ecology` loads neither torch nor rerun, and nobody who learns in it or is built on it."""
    for statement in ("import ecology", "import ecology; ecology.Ecology"):
        loaded = loaded_by(statement, tmp_path)
        assert ("ecology.env" in loaded) is statement.endswith("Ecology")
        for heavy in ("torch", "rerun", "matplotlib", "pyarrow", "ecology.agents", "ecology.scenarios", "ecology.lab"):
            assert heavy not in loaded, f"`{statement}` loads {heavy}"


def test_all_names_of_ecology_are_loaded_when_they_are_used():
    """Each is there, and the same as in the module that defines it; a misspelt one is an AttributeError."""
    assert all(getattr(ecology, name).__name__ in (name, name.title()) for name in ecology.__all__)
    assert set(ecology.__all__) <= set(dir(ecology))
    with pytest.raises(AttributeError, match="Ecolgy"):
        _ = ecology.Ecolgy


@pytest.mark.parametrize("word", ["--help", "list", "run --help", "sweep --help"])
def test_what_needs_no_world_starts_at_once(word, tmp_path):
    """Help and `ecology list` load neither a world nor a learner, nor anything that is slow to load."""
    command = f"from ecology.lab.cli import main\ntry: main({word.split()})\nexcept SystemExit: pass\n"
    quietly = (
        f"import contextlib, io\nwith contextlib.redirect_stdout(io.StringIO()):\n{textwrap.indent(command, '    ')}"
    )
    loaded = loaded_by(quietly, tmp_path)
    for heavy in ("numba", "scipy", "shapely", "pymunk", "torch", "rerun", "matplotlib", "pyarrow", "ecology.env"):
        assert heavy not in loaded, f"`ecology {word}` loads {heavy}"


def test_importing_scenarios_is_light(tmp_path):
    """Building a scenario, and listing them, loads neither torch nor rerun nor a learner."""
    loaded = loaded_by("from ecology import scenarios; scenarios.load(scenarios.names()[0])", tmp_path)
    for heavy in ("torch", "rerun", "ecology.agents"):
        assert heavy not in loaded, f"loading a scenario loads {heavy}"


@pytest.mark.parametrize("folder", PACKAGES)
def test_the_packages_are_ours(folder, tmp_path):
    """In this environment the packages are those of this checkout."""
    package = PACKAGES[folder]
    found = loaded_by(f"import {package}", tmp_path)[package]
    ours = ROOT / folder / "__init__.py"
    assert Path(found or "nowhere").resolve() == ours.resolve(), (
        f"`import {package}` finds {found}, not {ours}: another package has this name. Install the project "
        f"into a virtual environment of its own (make install), or uninstall the other `{package}`."
    )


@pytest.mark.parametrize("name", ["ecology.agents", "ecology.scenarios", "ecology.lab", "torch"])
def test_ecology_knows_nobody_who_acts(name):
    """The world imports neither learners, nor scenarios, nor commands, nor torch; `python -m ecology` is a command."""
    outside = {path for path in importing(name, "ecology") if not path.startswith("ecology/lab/")}
    assert outside <= {"ecology/__main__.py"} if name == "ecology.lab" else outside == set()


@pytest.mark.parametrize("name", ["ecology.scenarios", "ecology.lab", "pymunk", "rerun"])
def test_agents_know_only_the_words_of_the_world(name):
    """Agents import neither scenarios, nor commands, nor the physics, nor the viewer."""
    assert importing(name, "agents") == set()


@pytest.mark.parametrize("name", ["ecology.agents", "ecology.lab", "torch", "rerun"])
def test_scenarios_know_only_the_words_of_the_world(name):
    """Scenarios import neither agents, nor commands, nor what is slow to load."""
    assert importing(name, "scenarios") == set()


def test_only_physics_imports_pymunk():
    """The solver stays behind one file."""
    assert set().union(*(importing("pymunk", package) for package in PACKAGES)) == {"ecology/physics.py"}


def test_only_the_viewer_imports_rerun():
    """The viewer stays behind those who record, draw, and look back; what they draw is plain data."""
    found = set().union(*(importing("rerun", package) for package in PACKAGES))
    names = ("rerun", "recording_file", "relay", "drawing", "layout", "readback", "screenshot", "hindsight")
    names = (*names, "overview")
    outside = {path for path in found if not path.startswith("ecology/observers/panels/")}
    assert outside == {f"ecology/observers/{name}.py" for name in names}


def test_only_one_module_imports_matplotlib():
    """What draws asks the one module that makes matplotlib load whatever MPLBACKEND says."""
    found = set().union(*(importing("matplotlib", package) for package in PACKAGES))
    assert found == {"ecology/observers/colour_scales.py", "ecology/observers/plotting.py"}


@pytest.mark.parametrize("name", ["scene", "viewer", "census", "frame", "page"])
def test_the_rest_of_those_who_watch_load_no_viewer(name, tmp_path):
    """Words about what is drawn, and the viewer's process, are to be had without Rerun's library."""
    loaded = loaded_by(f"import ecology.observers.{name}", tmp_path)
    for heavy in ("rerun", "matplotlib", "torch"):
        assert heavy not in loaded, f"ecology.observers.{name} loads {heavy}"


def modules():
    """Return the modules of all three packages: name -> syntax tree."""
    found = {}
    for folder, package in PACKAGES.items():
        for path in sorted((ROOT / folder).rglob("*.py")):
            parts = path.relative_to(ROOT / folder).with_suffix("").parts
            found[".".join([package, *parts]).removesuffix(".__init__")] = tree_of(path)
    return found


def at_import(body):
    """Yield the import statements in `body` that run when a module is imported."""
    for node in body:
        if isinstance(node, (ast.Import, ast.ImportFrom)):
            yield node
        elif isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            yield from at_import(node.orelse)
        elif not isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            for field in ("body", "orelse", "finalbody"):
                yield from at_import(getattr(node, field, []))
            for handler in getattr(node, "handlers", []):
                yield from at_import(handler.body)


def imported(nodes, known):
    """Return the modules among `known` that import statements name: those of `from a import b` as a.b, or else as a."""
    found = set()
    for node in nodes:
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            inner = {f"{node.module}.{alias.name}": alias.name for alias in node.names}
            found |= {name if name in known else node.module for name in inner}
    return found & known.keys()


def test_no_imports_go_in_circles():
    """No module imports one that imports it, directly or by way of others, while it is being imported."""
    known = modules()
    waiting = {name: imported(at_import(tree.body), known) - {name} for name, tree in known.items()}
    while free := {name for name, needs in waiting.items() if not needs}:
        waiting = {name: needs - free for name, needs in waiting.items() if name not in free}
    assert waiting == {}, "in a circle, or in need of one"


def test_no_module_uses_what_is_private_to_another():
    """A name with an underscore is used in its own module alone."""
    known = modules()
    for module, tree in known.items():
        names = {}  # of modules, as they are called here
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] == "ecology":
                private = [alias.name for alias in node.names if re.match("_[^_]", alias.name)]
                assert not private, f"{module} imports {private} from {node.module}"
                names |= {alias.asname or alias.name: f"{node.module}.{alias.name}" for alias in node.names}
            elif isinstance(node, ast.Import):
                names |= {alias.asname or alias.name: alias.name for alias in node.names}
        for node in ast.walk(tree):
            if isinstance(node, ast.Attribute) and re.match("_[^_]", node.attr):
                assert names.get(ast.unparse(node.value)) not in known, f"{module} uses {ast.unparse(node)}"


def test_randomness_is_handed_in():
    """No file draws from a global random stream: neither `random` nor numpy's or torch's global functions."""
    for package in PACKAGES:
        assert importing("random", package) == set()
        for path in (ROOT / package).rglob("*.py"):
            for node in ast.walk(tree_of(path)):
                if not isinstance(node, ast.Attribute):
                    continue
                if getattr(node.value, "attr", "") == "random" and ast.unparse(node.value) in (
                    "np.random",
                    "numpy.random",
                ):
                    assert node.attr in ("Generator", "SeedSequence", "default_rng", "BitGenerator"), path
                if node.attr == "manual_seed" and ast.unparse(node) == "torch.manual_seed":
                    raise AssertionError(f"{path} seeds torch's global stream")
