"""The main job's picture, bifurcation_map.png: what `python -m ziegler_jax` draws.

About a minute; the store goes to a temporary folder.
"""

import shutil
import tempfile
from pathlib import Path

from ziegler_jax.__main__ import PICTURE, main

if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        if main(["--out", folder]) == 0:
            shutil.copy(Path(folder) / PICTURE, Path(__file__).parent)
