"""A notebook as a user sees it: the bar, what results print, pictures."""

import sys
from pathlib import Path

import pytest

nbformat = pytest.importorskip("nbformat")
nbclient = pytest.importorskip("nbclient")
pytest.importorskip("ipykernel")

NOTEBOOK = Path(__file__).parents[1] / "examples" / "first_map.ipynb"


def outputs(notebook):
    """Streams together, and the data of each kind."""
    shown = [o for cell in notebook.cells for o in cell.get("outputs", [])]
    text = "".join(o.text for o in shown if o.output_type == "stream")
    return text, [o.data for o in shown if "data" in o]


def check(notebook):
    text, data = outputs(notebook)
    assert "255/255" in text and "100%" in text  # the bar, without being asked for
    assert "XLA" not in text and "Warning" not in text
    assert sum("image/png" in kinds for kinds in data) == 2
    said = [kinds["text/plain"] for kinds in data if "image/png" not in kinds]
    dataset, settled = said
    assert "joint_amplitude" in dataset and "outcome" in dataset
    assert settled.startswith("Settled\n") and "rad" in settled
    assert "cycle: its orbit is certified" in settled
    return text


@pytest.mark.filterwarnings("ignore")  # of the kernel's own machinery
def test_a_notebook_shows_bar_repr_and_picture(monkeypatch):
    kernel = Path(sys.prefix) / "share" / "jupyter"
    monkeypatch.setenv("JUPYTER_PATH", str(kernel))
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    check(notebook)  # as it stands in the repository
    for cell in notebook.cells:
        if cell.cell_type == "code":
            cell["outputs"] = []
    nbclient.NotebookClient(notebook, timeout=600).execute()
    assert "compiling the scene" in check(notebook)
