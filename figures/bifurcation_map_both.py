"""Where both friction laws differ: what `python -m ziegler_jax --law both` draws.

A few minutes; the stores go to a temporary folder.
"""

import shutil
import tempfile
from pathlib import Path

from ziegler_jax.__main__ import PICTURE, file_of, main

if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        if main(["--law", "both", "--out", folder]) == 0:
            picture = Path(folder) / file_of(PICTURE, "both")
            shutil.copy(picture, Path(__file__).parent)
