"""Who may know whom: read from what is loaded and from the source itself."""

import ast
import json
import subprocess
import sys
from pathlib import Path

import pytest

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


def imports(path):
    """Return the packages that a source file imports, wherever it does: top names, and "ecology.PART"."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
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
    loaded = loaded_by("import ecology", tmp_path)
    assert "ecology.env" in loaded
    for heavy in ("torch", "rerun", "matplotlib", "pyarrow", "ecology.agents", "ecology.scenarios"):
        assert heavy not in loaded, f"`import ecology` loads {heavy}"


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


@pytest.mark.parametrize("name", ["ecology.agents", "ecology.scenarios", "torch"])
def test_ecology_knows_nobody_who_acts(name):
    """The world imports neither learners nor scenarios nor torch."""
    assert importing(name, "ecology") == set()


@pytest.mark.parametrize("name", ["ecology.scenarios", "pymunk", "rerun"])
def test_agents_know_only_the_words_of_the_world(name):
    """Those who act import neither scenarios, nor the physics, nor the viewer."""
    assert importing(name, "agents") == set()


def test_only_physics_imports_pymunk():
    """The solver stays behind one file."""
    assert set().union(*(importing("pymunk", package) for package in PACKAGES)) == {"ecology/physics.py"}


def test_only_the_viewer_imports_rerun():
    """The viewer stays behind those who record, draw, and look back; what they draw is plain data."""
    found = set().union(*(importing("rerun", package) for package in PACKAGES))
    names = ("rerun", "relay", "drawing", "backdrop", "layout", "readback", "screenshot", "hindsight")
    assert found == {f"ecology/observers/{name}.py" for name in names}


def test_only_one_module_imports_matplotlib():
    """What draws asks the one module that makes matplotlib load whatever MPLBACKEND says."""
    found = set().union(*(importing("matplotlib", package) for package in PACKAGES))
    assert found == {"ecology/observers/plotting.py"}


@pytest.mark.parametrize("name", ["scene", "viewer", "census", "frame", "page"])
def test_the_rest_of_those_who_watch_load_no_viewer(name, tmp_path):
    """Words about what is drawn, and the viewer's process, are to be had without Rerun's library."""
    loaded = loaded_by(f"import ecology.observers.{name}", tmp_path)
    for heavy in ("rerun", "matplotlib", "torch"):
        assert heavy not in loaded, f"ecology.observers.{name} loads {heavy}"


def test_no_module_imports_what_is_private_to_another():
    """A name with an underscore is used in its own module alone."""
    for path in sorted((ROOT / "ecology" / "observers").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("ecology"):
                assert not [alias.name for alias in node.names if alias.name.startswith("_")], path


def test_randomness_is_handed_in():
    """No file draws from a global random stream: neither `random` nor numpy's or torch's global functions."""
    for package in PACKAGES:
        assert importing("random", package) == set()
        for path in (ROOT / package).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, ast.Attribute) and ast.unparse(node.value) in (
                    "np.random",
                    "numpy.random",
                ):
                    assert node.attr in ("Generator", "SeedSequence", "default_rng", "BitGenerator"), path
                if isinstance(node, ast.Attribute) and ast.unparse(node) == "torch.manual_seed":
                    raise AssertionError(f"{path} seeds torch's global stream")
