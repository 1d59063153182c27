"""A point that is traced and compiled once, for many sweeps and calls."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Collection, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from ..numerics.rules import instance
from ..results import Variable
from ..runtime import all_cores
from .grid import check_signature
from .pool import Lanes, run_lanes
from .program import Compiled, compiled, traced
from .returned import Returned, empty


class Program:
    """A point, traced and compiled once.

    ```python
    program = zj.Program(point)
    ds = zj.sweep(program, q=np.linspace(1, 4, 31), mu=[0.1, 0.2])
    results = program(q=[2.0, 2.6, 3.1], mu=0.1)  # a dict of arrays
    ```

    The program has the attributes, tables and globals that the point reads as they were
    when it was made. `sweep(point)` always traces the point anew; `sweep(program)`
    never does, and begins at once. Results equal those of `sweep(point)` to the last
    bit.

    **Arguments:**

    - `point`: as `sweep`'s.
    - `names`: the parameters that vary, which are numbers; None: those of the point
        without a default. Others keep their defaults.
    - `lanes`: as `sweep`'s. A sweep of the program may have other threads.

    **Raises:** `ValueError` for a point that does not name its numbers, or that JAX
    cannot trace, with the line and a cure.
    """

    def __init__(
        self,
        point: Callable[..., Returned],
        *,
        names: Sequence[str] | None = None,
        lanes: Lanes = Lanes(),
    ):
        """Trace the point."""
        instance("lanes", lanes, Lanes)
        if not callable(point):
            raise ValueError(f"Argument `point` must be a function, but is {point!r}.")
        if names is None:
            names = _without_default(point)
        check_signature(point, [*names], "point")
        self.scene = traced(point, tuple(names), lanes.batch_size)
        self._lanes, self._compiled = lanes, None

    def __repr__(self) -> str:
        """Its parameters, what it returns, and its digest."""
        returns = ", ".join(self.variables)
        takes = ", ".join(self.names)
        return f"Program({takes} -> {returns}; {self.digest[:12]})"

    @property
    def names(self) -> tuple[str, ...]:
        """Its parameters."""
        return self.scene.names

    @property
    def variables(self) -> dict[str, Variable]:
        """The variables that it returns; values are shapes and dtypes."""
        return self.scene.variables

    @property
    def digest(self) -> str:
        """A hash of what it computes: the `scene_digest` of its sweeps."""
        return self.scene.digest

    def compiled(self) -> Compiled:
        """The program, compiled when it is first asked for."""
        if self._compiled is None:
            now = compiled(self.scene)
            self._compiled = now._replace(compile_seconds=0.0)
            return now
        return self._compiled

    def check(self, axes: Collection[str], lanes: Lanes) -> None:
        """Refuse a sweep over other parameters, or in batches of another size.

        **Raises:** `ValueError`.
        """
        if set(axes) != set(self.names):
            raise ValueError(
                f"Axes of a program must be its parameters, {', '.join(self.names)}, "
                f"but are {', '.join(axes)}."
            )
        given, own = lanes.batch_size, self._lanes.batch_size
        if given not in (own, None):
            raise ValueError(
                f"Argument `lanes` must have the program's `batch_size`, {own!r}, but "
                f"has {given!r}."
            )

    def __call__(self, **values: ArrayLike) -> dict[str, np.ndarray]:
        """The results at points whose parameters have these values.

        **Arguments:** each parameter by name: numbers, or arrays that broadcast against
        each other.

        **Returns:** by name arrays of their shape, and behind it that of the result.

        **Raises:** `ValueError` for a parameter that is missing, unknown or not a
        finite number.
        """
        if set(values) != set(self.names):
            raise ValueError(
                f"A program must be given its parameters, {', '.join(self.names)}, "
                f"but is given {', '.join(values) or 'none'}."
            )
        arrays = {name: np.asarray(x) for name, x in values.items()}
        for name, x in arrays.items():
            if x.dtype.kind not in "biuf" or not np.isfinite(x).all():
                raise ValueError(
                    f"Parameter `{name}` must be of finite numbers, but is "
                    f"{values[name]!r}."
                )
        try:
            alike = np.broadcast_arrays(*arrays.values())
        except ValueError:
            shapes = ", ".join(f"`{n}` {x.shape}" for n, x in arrays.items())
            raise ValueError(
                f"Parameters must broadcast against each other, but have the shapes "
                f"{shapes}."
            ) from None
        shape = alike[0].shape
        flat = {name: x.ravel() for name, x in zip(arrays, alike, strict=True)}
        results = self.at(flat)
        return {n: x.reshape((*shape, *x.shape[1:])) for n, x in results.items()}

    def at(
        self,
        values: Mapping[str, np.ndarray],
        on_batch: Callable[[int, float], object] = lambda *_: None,
    ) -> dict[str, np.ndarray]:
        """The results point by point; `on_batch` is told of points as they end."""
        count = len(values[self.names[0]])
        floats = {name: np.asarray(values[name], float) for name in self.names}
        arrays = {n: empty(v, (count,)).copy() for n, v in self.variables.items()}
        if not count:
            return arrays

        def put(points: np.ndarray, results: list[np.ndarray], _: np.ndarray) -> None:
            for target, result in zip(arrays.values(), results, strict=True):
                target[points] = np.moveaxis(result, -1, 0)

        run_lanes(
            self.compiled(),
            lambda points: {name: x[points] for name, x in floats.items()},
            iter([np.arange(count)]),
            put,
            threads=self._lanes.threads or all_cores(),
            on_batch=on_batch,
        )
        return arrays


def _without_default(point: Callable[..., object]) -> list[str]:
    """The names of the parameters that a point must be given.

    **Raises:** `ValueError` where it has none.
    """
    try:
        parameters = inspect.signature(point).parameters.values()
    except (TypeError, ValueError):
        parameters = ()
    kinds = inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY
    names = [p.name for p in parameters if p.kind in kinds and p.default is p.empty]
    if not names:
        raise ValueError(
            "Argument `point` must name the numbers that vary, as `def point(q, mu)` "
            f"does, but is {point!r}: give `names`."
        )
    return names
