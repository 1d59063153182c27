"""A scene at scattered points, traced and compiled once for many calls."""

from collections.abc import Callable, Mapping

import numpy as np

from ..results import Variable
from ..runtime import all_cores
from ..sweep.axes import Returned, empty
from ..sweep.lanes import Lanes
from ..sweep.program import compiled, traced
from ..sweep.scheduler import run_lanes


class Sampler:
    """Calls a point at any values of its parameters: the numbers of a sweep's lanes.

    **Arguments:** `point`, `lanes`: as `sweep`'s; `names`: of the point's parameters.

    **Raises:** what `sweep` raises for a scene.
    """

    def __init__(
        self, point: Callable[..., Returned], names: tuple[str, ...], lanes: Lanes
    ):
        """Trace and compile the scene."""
        wide = lanes.precision == "float64"
        self.scene = traced(point, names, wide, lanes.batch_size)
        self.program = compiled(self.scene)
        self.threads, self.names = lanes.threads, names
        self.computed = 0  # lanes so far

    @property
    def variables(self) -> dict[str, Variable]:
        """What the scene returns; values are shapes and dtypes."""
        return self.scene.variables

    def __call__(
        self,
        values: Mapping[str, np.ndarray],
        on_batch: Callable[[int, float], object] = lambda *_: None,
    ) -> dict[str, np.ndarray]:
        """The results at points whose parameters have these values, point by point."""
        count = len(values[self.names[0]])
        records = np.empty(count, [(name, np.float64) for name in self.names])
        for name in self.names:
            records[name] = values[name]
        arrays = {n: empty(v, (count,)).copy() for n, v in self.variables.items()}
        if not count:
            return arrays

        def put(points: np.ndarray, results: list[np.ndarray], _: np.ndarray) -> None:
            for target, result in zip(arrays.values(), results, strict=True):
                target[points] = np.moveaxis(result, -1, 0)

        run_lanes(
            self.program,
            {"point": records},
            iter([np.arange(count)]),
            put,
            threads=self.threads or all_cores(),
            on_batch=on_batch,
        )
        self.computed += count
        return arrays
