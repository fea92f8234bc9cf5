"""The notebook of the documentation runs, and prints what stands in it.

`python python/tests/test_notebook.py` executes it and keeps its outputs.
"""

from pathlib import Path

import nbclient
import nbformat

NOTEBOOK = Path(__file__).parents[2] / "docs/notebook.ipynb"


def executed():
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    client = nbclient.NotebookClient(notebook, timeout=300, kernel_name="python3")
    client.execute(cwd=str(NOTEBOOK.parent))
    for cell in notebook.cells:
        # Times of the execution would change the file with every run.
        cell.metadata.pop("execution", None)
        # Packages warn of their own future there, one of them once a day.
        if cell.cell_type == "code":
            cell.outputs = [output for output in cell.outputs if output.get("name") != "stderr"]
    notebook.metadata["language_info"] = {"name": "python"}
    return notebook


def words(notebook):
    """Printed text and text of results, cell by cell; figures are compared by nobody."""
    return [
        [output.get("text", output.get("data", {}).get("text/plain")) for output in cell.outputs if "image/png" not in output.get("data", {})]
        for cell in notebook.cells
        if cell.cell_type == "code"
    ]


def test_the_notebook_prints_what_it_shows():
    shown = nbformat.read(NOTEBOOK, as_version=4)
    nbformat.validate(shown)
    assert any(words(shown)), "the notebook has no outputs"
    assert words(executed()) == words(shown)


if __name__ == "__main__":
    nbformat.write(executed(), NOTEBOOK)
