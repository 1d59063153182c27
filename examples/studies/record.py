"""What both studies share: the options of the command line, and where results go."""

import argparse
import json
import platform
import subprocess
import time
from importlib import metadata
from pathlib import Path

import jax
import matplotlib

import ziegler_jax as zj

HERE = Path(__file__).parent
LOOK = {"font.size": 12, "axes.titlesize": 12, "legend.frameon": False}


def begin(about):
    """The options; 64 bits, all cores, pictures into files."""
    about = about.splitlines()[0]
    parser = argparse.ArgumentParser(description=about)
    parser.add_argument("--small", action="store_true", help="a small grid, for a try")
    parser.add_argument("--out", type=Path, default=HERE, help="folder of the results")
    zj.configure_cpu()
    jax.config.update("jax_enable_x64", True)
    matplotlib.use("Agg")
    matplotlib.rcParams.update(LOOK)
    return parser


def commit():
    """The commit that last changed the package, and whether it has been changed."""

    def git(*arguments):
        command = ["git", "-C", str(Path(zj.__file__).parent), *arguments]
        done = subprocess.run(command, capture_output=True, text=True)
        return done.stdout.strip() if done.returncode == 0 else ""

    changed = " and changes" if git("status", "--porcelain", ".") else ""
    return (git("log", "-1", "--format=%H", ".") or "unknown") + changed


def save(figure, result, out, script):
    """The picture, and a line of figures with what they belong to."""
    name = Path(script).stem
    versions = {x: metadata.version(x) for x in ("ziegler_jax", "jax")}
    figures = {key: _short(value) for key, value in result.items()}
    origin = {"commit": commit(), "python": platform.python_version(), **versions}
    origin["process_cpu_s"] = _short(time.process_time())
    line = json.dumps({"study": name, **figures, **origin})
    print(line)
    out.mkdir(parents=True, exist_ok=True)
    (out / f"{name}.json").write_text(line + "\n")
    figure.savefig(out / f"{name}.png", dpi=120, bbox_inches="tight")


def _short(value):
    """Four digits of numbers, in whatever they lie."""
    if isinstance(value, dict):
        return {key: _short(x) for key, x in value.items()}
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [_short(x) for x in value]
    return float(f"{value:.4g}") if isinstance(value, float) else value
