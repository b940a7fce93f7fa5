"""Every notebook runs from top to bottom; it ends in its own assertions."""

import gc

import pytest
from support.cases import sweep
from support.places import NOTEBOOKS

GALLERY = sorted((NOTEBOOKS / "gallery").glob("*.ipynb"))
LONG = sorted(NOTEBOOKS.glob("*.ipynb"))
#: Leaves a kernel as it was, but for what is imported and compiled.
ANEW = """\
%reset -f
import matplotlib.pyplot as plt
plt.close("all")
plt.rcdefaults()
%matplotlib inline
%reset -f
"""


@pytest.fixture(scope="module")
def warm():
    """A kernel in which the notebooks of the gallery run one after another."""
    manager = pytest.importorskip("jupyter_client").KernelManager(kernel_name="python3")
    manager.start_kernel(cwd=str(NOTEBOOKS / "gallery"))
    yield manager
    manager.shutdown_kernel(now=True)
    manager.cleanup_resources()


def test_there_are_notebooks():
    assert LONG
    assert GALLERY


def executed(path, manager=None):
    """Run a notebook as it was committed, in a kernel of its own unless one is given."""
    nbformat = pytest.importorskip("nbformat")
    from nbclient import NotebookClient

    notebook = nbformat.read(path, as_version=4)
    assert any("assert" in cell.source for cell in notebook.cells[-2:])
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert all(cell.execution_count for cell in code), "commit the notebook as it was run"
    assert any(cell.outputs for cell in code)
    if manager is not None:
        notebook.cells.insert(0, nbformat.v4.new_code_cell(ANEW))
    how = {"timeout": 1800, "kernel_name": "python3", "km": manager}
    client = NotebookClient(notebook, resources={"metadata": {"path": str(path.parent)}}, **how)
    client.execute()
    if manager is not None:
        client.kc.stop_channels()
    gc.collect()  # what notebooks leave behind is no matter of other tests


@pytest.mark.parametrize("path", sweep(LONG, 0), ids=lambda path: path.stem)
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
def test_notebook(path):
    executed(path)


@pytest.mark.parametrize("path", sweep(GALLERY, 0), ids=lambda path: path.stem)
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
def test_gallery(path, warm):
    executed(path, warm)
