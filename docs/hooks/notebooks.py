"""Runs the notebooks of *Learn* and makes a page of each.

A notebook is a script in the percent format (`docs/learn/*.py`), which diffs well and
which the linters read. It runs from its first cell to its last on each build, in a
folder of its own; a cell that fails, or that warns, fails the build.
"""

import base64
import logging
import os
import re
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import jupytext
import nbformat
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError
from nbformat.v4 import new_code_cell

log = logging.getLogger("mkdocs.hooks.notebooks")

# Grids are small, so that programs which compile in half the time and run slower win;
# jaxlib 0.10's older emitter of fused loops saves another fifth
FIRST = """
import importlib.metadata, os, matplotlib
os.environ["JAX_DISABLE_MOST_OPTIMIZATIONS"] = "true"
os.environ["TF_CPP_MIN_LOG_LEVEL"] = "2"  # XLA's notes on the machine are no results
if importlib.metadata.version("jaxlib").startswith("0.10."):
    os.environ["XLA_FLAGS"] = "--xla_cpu_use_fusion_emitters=false"
matplotlib.rcParams["figure.dpi"] = 110
"""
LAST = """
import resource
whose = resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN
usages = [resource.getrusage(who) for who in whose]
print(sum(usage.ru_utime + usage.ru_stime for usage in usages))
"""
# what a call that draws gives back: the picture says it
DRAWN = re.compile(r"<Axes|\[?<matplotlib|array\(\[<Axes|\[?Text\(")
TIMEOUT = 900  # seconds for a cell, on a busy machine


class Ran(NamedTuple):
    """A notebook after its run, and the seconds that this took."""

    notebook: nbformat.NotebookNode
    wall: float
    cpu: float  # of its kernel and the kernel's own processes


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Put a page, its pictures and its notebook in the place of each script."""
    scripts = [f for f in files if re.fullmatch(r"learn/\w+\.py", f.src_uri)]
    names = [f.src_uri.removesuffix(".py") for f in scripts]
    # each is a process of its own, which mostly compiles, on one core
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        runs = list(pool.map(run, [f.content_string for f in scripts], names))
    for script, name, ran in zip(scripts, names, runs, strict=True):
        files.remove(script)
        log.info("%-22s %5.1f s, %5.1f s of processor", name, ran.wall, ran.cpu)
        text, pictures = page(ran, name.split("/")[-1])
        whole = nbformat.writes(ran.notebook)
        for uri, content in {
            f"{name}.md": text,
            f"{name}.ipynb": whole,
            **{f"learn/{picture}": data for picture, data in pictures.items()},
        }.items():
            files.append(File.generated(config, uri, content=content))
    log.info("%d notebooks: %.0f s of processor", len(runs), sum(r.cpu for r in runs))
    return files


def run(source: str, name: str) -> Ran:
    """Run it from its first cell to its last."""
    notebook = jupytext.reads(source, fmt="py:percent")
    cells = notebook.cells
    cells[:] = [new_code_cell(FIRST), *cells, new_code_cell(LAST)]
    notebook.metadata["kernelspec"] = {
        "name": "python3",
        "display_name": "Python 3",
        "language": "python",
    }
    began = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        client = NotebookClient(
            notebook,
            timeout=TIMEOUT,
            resources={"metadata": {"path": folder}},
            extra_arguments=["--log-level=ERROR"],
        )
        try:
            client.execute()
        except CellExecutionError as error:
            raise PluginError(f"A cell of docs/{name}.py fails.\n{error}") from error
    cpu = float(cells.pop().outputs[0].text)
    del cells[0]
    return Ran(notebook, time.monotonic() - began, cpu)


def page(ran: Ran, name: str) -> tuple[str, dict[str, bytes]]:
    """Its text as Markdown, and its pictures by name."""
    parts: list[str] = []
    pictures: dict[str, bytes] = {}
    heading = name
    for cell in ran.notebook.cells:
        if cell.cell_type == "markdown":
            parts.append(cell.source)
            heads = re.findall(r"^#+ (.+)$", cell.source, re.M)
            heading = heads[-1].replace("`", "") if heads else heading
            continue
        parts.append(f"```python\n{cell.source}\n```")
        for kind, content in shown(cell, name):
            if kind == "picture":
                picture = f"{name}_{len(pictures) + 1}.png"
                pictures[picture] = content
                parts.append(f"![{heading}]({picture})")
            else:
                parts.append(f"```{{.text .output}}\n{content}\n```")
    parts.append(
        f"---\n\nThis page is a notebook: [{name}.ipynb]({name}.ipynb). It ran for "
        f"{ran.wall:.0f} s, {ran.cpu:.0f} s of processor time, as this site was built."
    )
    return "\n\n".join(parts) + "\n", pictures


def shown(cell: nbformat.NotebookNode, name: str) -> list[tuple[str, str | bytes]]:
    """What a cell leaves to be seen: texts, pictures."""
    streams = {"stdout": "", "stderr": ""}
    rest: list[tuple[str, str | bytes]] = []
    for output in cell.outputs:
        if output.output_type == "stream":
            streams[output.name] += output.text
        elif "image/png" in output.get("data", {}):
            rest.append(("picture", base64.b64decode(output.data["image/png"])))
        elif "text/plain" in output.get("data", {}):
            text = output.data["text/plain"]
            if not DRAWN.match(text):
                rest.append(("text", text))
    if "Warning" in streams["stderr"]:
        log.warning("A cell of docs/learn/%s.py warns: %s", name, streams["stderr"])
    # of a bar that is drawn over itself, what stands in the end
    ends = [
        "\n".join(line.rstrip("\r").split("\r")[-1].rstrip() for line in s.split("\n"))
        for s in (streams["stderr"], streams["stdout"])
    ]
    texts = [text.strip("\n") for text in ends]
    return [("text", text) for text in texts if text] + rest
