"""Tasks of a batch system, each with a store of its own: their union is the map."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import stored

import ziegler_jax as zj

TASKS = 3
TASK = """
import os
import numpy as np
import stored, ziegler_jax as zj
task = int(os.environ["SLURM_ARRAY_TASK_ID"])
x = np.array_split(stored.X, {tasks})[task]
zj.sweep(stored.point, x=x, y=stored.Y, store=f"map_{{task}}.zarr", progress=False)
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Stores that three processes wrote at once; a fourth was one of them again."""
    folder = tmp_path_factory.mktemp("array")
    code = TASK.format(tasks=TASKS)
    here = os.pathsep.join(map(str, [Path(stored.__file__).parent, Path.cwd()]))

    def start(task):
        environment = {**os.environ, "PYTHONPATH": here, "SLURM_ARRAY_TASK_ID": task}
        return subprocess.Popen(
            [sys.executable, "-c", code], cwd=folder, env=environment,
            stderr=subprocess.PIPE, text=True,
        )  # fmt: skip

    for process in [*map(start, "012"), start("1")]:
        _, said = process.communicate(timeout=300)
        # the fourth may meet the second at work, and is told so
        assert process.returncode == 0 or "must not be written to" in said, said
    return folder


def test_the_union_of_the_tasks_stores_is_the_map_to_the_last_bit(folder):
    paths = sorted(folder.glob("map_*.zarr"))
    assert len(paths) == TASKS
    found = zj.merge(*map(zj.open_sweep, paths))
    whole = zj.sweep(stored.point, x=stored.X, y=stored.Y, progress=False)
    assert found["sum"].dims == whole["sum"].dims
    assert found.attrs["scene_digest"] == whole.attrs["scene_digest"]
    for name in whole.data_vars:
        np.testing.assert_array_equal(found[name], whole[name], err_msg=str(name))
    assert found.attrs["points"] == whole["sum"].size
