"""The documentation: its tables are current, its commands are spelt as the program spells them, its code runs."""

from __future__ import annotations

import importlib.util
import json
import re
import shlex
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest
import typer.main

import ecology
from ecology import scenarios
from ecology.lab.cli import app

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(DOCS.rglob("*.md"))]
NOTEBOOKS = sorted((DOCS / "notebooks").glob("*.ipynb"))
NAMES = [path.relative_to(ROOT).as_posix() for path in PAGES]
WORDS = 1_500  # of the README at most


@pytest.fixture(scope="module")
def generate() -> Iterator[ModuleType]:
    """Return docs/generate.py as a module."""
    spec = importlib.util.spec_from_file_location("generate", DOCS / "generate.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["generate"] = module
    spec.loader.exec_module(module)
    yield module
    del sys.modules["generate"]


def blocks(path: Path, kind: str) -> list[str]:
    """Return the code blocks of a kind on a page."""
    return re.findall(rf"^```{kind}\n(.*?)^```", path.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)


def test_a_comment_of_a_long_field_is_in_its_table(generate: ModuleType) -> None:
    """The formatter splits a long field over several lines, and its comment stands on one of them."""
    about = {field.name: field.about for field in generate.fields_of(ecology.Need)}
    assert about["feeds"]
    assert about["weight"]


def test_every_generated_part_is_on_a_page(generate: ModuleType) -> None:
    """No table is left out, so a new scenario needs its page."""
    used = {part[1] for path in PAGES for part in generate.PART.findall(path.read_text(encoding="utf-8"))}
    assert used == set(generate.PARTS)


@pytest.mark.parametrize("name", scenarios.names())
def test_every_scenario_has_its_page(name: str) -> None:
    """A scenario has a page with its tables and a picture, and stands in the gallery and in the README."""
    page = (DOCS / "scenarios" / f"{name}.md").read_text(encoding="utf-8")
    assert f"<!-- generated: scenario {name} -->" in page
    assert f"(../images/{name}.png)" in page
    assert f"(images/{name}.png)" in (DOCS / "gallery.md").read_text(encoding="utf-8")
    assert f"`{name}`" in (ROOT / "README.md").read_text(encoding="utf-8")


def test_every_picture_is_in_the_gallery() -> None:
    """The gallery shows all pictures, each with a caption of its own below it."""
    shown = re.findall(r"!\[.+\]\(images/(.+)\)\n\n\*", (DOCS / "gallery.md").read_text(encoding="utf-8"))
    assert sorted(shown) == sorted(path.name for path in (DOCS / "images").iterdir())


def test_every_command_is_in_the_readme() -> None:
    """The table of commands names all that there are."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    for command in app.registered_commands:
        assert f"`ecology {command.name}" in text, command.name


def test_the_readme_is_short() -> None:
    """A README is read to its end; the rest is on the site."""
    assert len((ROOT / "README.md").read_text(encoding="utf-8").split()) <= WORDS


@pytest.mark.parametrize("path", PAGES, ids=NAMES)
def test_links_lead_somewhere(path: Path) -> None:
    """A link within the repository leads to a file; anchors are checked by the build of the site."""
    for link in re.findall(r"\]\(([^)#\s]+)(?:#[\w-]*)?\)", path.read_text(encoding="utf-8")):
        if not link.startswith(("http:", "https:")):
            assert (path.parent / link).exists(), link


@pytest.mark.parametrize("path", PAGES + NOTEBOOKS, ids=[*NAMES, *(path.name for path in NOTEBOOKS)])
def test_commands_are_spelt_as_the_program_spells_them(path: Path) -> None:
    """Every `ecology` command in a code block has options that exist, with values that they take."""
    group = typer.main.get_command(app)
    if path.suffix == ".ipynb":
        lines = [line for code in code_cells(path) for line in code.splitlines()]
    else:
        lines = "\n".join(blocks(path, "sh")).replace("\\\n", " ").splitlines()
    for line in lines:
        words = shlex.split(re.sub(r"\$\w+", "0", line.strip().lstrip("!")), comments=True)
        if words[:1] == ["ecology"] and words[1:] and words[1] != "--help":
            name, rest = words[1], words[2:]
            command = group.commands[name]  # type: ignore[attr-defined]
            command.make_context(name, rest).close()


def code_cells(path: Path) -> list[str]:
    """Return the code of a notebook, cell by cell."""
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    return ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.name)
def test_notebooks_were_executed_from_top_to_bottom(path: Path) -> None:
    """A notebook is kept as `make notebooks` leaves it: cells in order, without an error, with pictures."""
    cells = [cell for cell in json.loads(path.read_text(encoding="utf-8"))["cells"] if cell["cell_type"] == "code"]
    assert [cell["execution_count"] for cell in cells] == [*range(1, len(cells) + 1)]
    outputs = [output for cell in cells for output in cell["outputs"]]
    assert all(output["output_type"] != "error" for output in outputs)
    assert any("image/png" in output.get("data", {}) for output in outputs)


GUIDES = ("python", "libraries", "bodies", "interventions", "archipelagos")


@pytest.mark.parametrize("name", ["README.md", *(f"docs/guides/{name}.md" for name in GUIDES)])
def test_the_code_of_a_page_runs(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The Python blocks of a page run, one after the other; parts of a scenario stand there without imports."""
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {"__name__": "page"}
    if name.endswith(("bodies.md", "interventions.md")):
        names |= {word: getattr(ecology, word) for word in ecology.__all__}
    for code in blocks(ROOT / name, "python"):
        exec(compile(code, name, "exec"), names)
