"""The configuration of the documentation site, built by `make docs`."""

from __future__ import annotations

import dataclasses
import re
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))

import generate

import ecology

project = "ecology"
author = "the ecology sandbox authors"
version = release = ecology.__version__

extensions = ["myst_nb", "sphinx.ext.autodoc"]
exclude_patterns = ["_build"]
root_doc = "index"

smartquotes = False  # `--option` keeps its hyphens

html_theme = "furo"
html_title = f"ecology {release}"
html_copy_source = False
html_show_copyright = False

myst_enable_extensions = ["attrs_inline"]
myst_heading_anchors = 3
nb_execution_mode = "off"  # notebooks are kept with their output; `make notebooks` renews it

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
python_maximum_signature_line_length = 100


def as_rst(lines: list[str]) -> list[str]:
    """Return a plain-text docstring as reStructuredText: `code` is code, an indented paragraph is shown as it is."""
    result: list[str] = []
    for paragraph in re.split(r"\n\s*\n", "\n".join(lines)):
        if paragraph.startswith(" "):
            result += ["::", "", *("   " + line for line in paragraph.splitlines()), ""]
            continue
        parts = re.split(r"`+([^`]+)`+", paragraph)
        for i, part in enumerate(parts):
            parts[i] = f"``{part}``" if i % 2 else re.sub(r"([\\*|]|_\b)", r"\\\1", part)
        result += [*"".join(parts).splitlines(), ""]
    return result


def describe(_app: object, what: str, _name: str, value: object, _options: object, lines: list[str]) -> None:
    """Convert a docstring, and list the fields of a dataclass below it."""
    lines[:] = as_rst(lines)
    if what == "class" and dataclasses.is_dataclass(value) and isinstance(value, type):
        for field in generate.fields_of(value):
            default = f", default ``{field.default}``" if field.default else ""
            lines += [f"- ``{field.name}`` (``{field.kind}``{default}): {as_rst([field.about])[0]}".rstrip(" :")]
        lines.append("")


def shorten(*event: Any) -> list[str | None]:
    """Return a signature in which an array is an array, whatever it holds."""
    *_, signature, back = event
    arrays = r"~?numpy\.ndarray\[tuple\[[^\]]*\], ~?numpy\.dtype\[[^\]]*\]\]"
    texts = [None if each is None else re.sub(arrays, "numpy.ndarray", each) for each in (signature, back)]
    return [None if each is None else each.replace("<factory>", "{}") for each in texts]


def setup(app: object) -> None:
    """Connect to Sphinx."""
    app.connect("autodoc-process-docstring", describe)  # type: ignore[attr-defined]
    app.connect("autodoc-process-signature", shorten)  # type: ignore[attr-defined]
