"""Every notebook runs from top to bottom; it ends in its own assertions."""

import gc
from pathlib import Path

import pytest
from workspace import sweep

NOTEBOOKS = Path(__file__).parents[2] / "notebooks"


GALLERY = sorted((NOTEBOOKS / "gallery").glob("*.ipynb"))


def test_there_are_notebooks():
    assert list(NOTEBOOKS.glob("*.ipynb"))


@pytest.mark.parametrize("path", sweep([*GALLERY, *sorted(NOTEBOOKS.glob("*.ipynb"))]), ids=lambda path: path.stem)
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
def test_notebook(path):
    nbformat = pytest.importorskip("nbformat")
    from nbclient import NotebookClient

    notebook = nbformat.read(path, as_version=4)
    assert any("assert" in cell.source for cell in notebook.cells[-2:])
    assert all(cell.outputs or "assert" in cell.source for cell in notebook.cells[-4:]
               if cell.cell_type == "code"), "commit the notebook with its outputs"  # fmt: skip
    where = {"metadata": {"path": str(path.parent)}}
    NotebookClient(notebook, timeout=1800, kernel_name="python3", resources=where).execute()
    gc.collect()  # what notebooks leave behind is no matter of other tests
