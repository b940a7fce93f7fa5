"""Every notebook runs from top to bottom; it ends in its own assertions."""

import gc

import pytest
from support.cases import sweep
from support.places import NOTEBOOKS

GALLERY = sorted((NOTEBOOKS / "gallery").glob("*.ipynb"))


def test_there_are_notebooks():
    assert list(NOTEBOOKS.glob("*.ipynb"))


@pytest.mark.parametrize(
    "path", sweep([*GALLERY, *sorted(NOTEBOOKS.glob("*.ipynb"))]), ids=lambda path: path.stem
)
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
def test_notebook(path):
    nbformat = pytest.importorskip("nbformat")
    from nbclient import NotebookClient

    notebook = nbformat.read(path, as_version=4)
    assert any("assert" in cell.source for cell in notebook.cells[-2:])
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert all(cell.execution_count for cell in code), "commit the notebook as it was run"
    assert any(cell.outputs for cell in code)
    where = {"metadata": {"path": str(path.parent)}}
    NotebookClient(notebook, timeout=1800, kernel_name="python3", resources=where).execute()
    gc.collect()  # what notebooks leave behind is no matter of other tests
