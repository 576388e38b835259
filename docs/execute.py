"""Execute the notebooks, each in an empty folder, and keep their output: `make notebooks`."""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

import nbformat
from nbclient import NotebookClient

HERE = Path(__file__).parent
KEPT = ("kernelspec", "language_info")  # of the metadata: the rest depends on the machine


def execute(path: Path) -> nbformat.NotebookNode:
    """Return the notebook at `path` with the output that its cells give now; what fails raises."""
    notebook = nbformat.read(path, as_version=4)
    with tempfile.TemporaryDirectory() as folder:
        NotebookClient(notebook, timeout=600, resources={"metadata": {"path": folder}}).execute()
    notebook.metadata = {key: value for key, value in notebook.metadata.items() if key in KEPT}
    for cell in notebook.cells:
        cell.metadata = {}
    return notebook


def main() -> None:
    """Execute the notebooks that are named, or all."""
    os.environ["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"  # `!ecology` is this one
    os.environ["COLUMNS"] = "100"
    for path in map(Path, sys.argv[1:]) if sys.argv[1:] else sorted((HERE / "notebooks").glob("*.ipynb")):
        nbformat.write(execute(path), path)
        print(f"written: {path.name}")


if __name__ == "__main__":
    main()
