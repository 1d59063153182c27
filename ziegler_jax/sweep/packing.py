"""The numbers of a lane as few arrays: one for each kind of number.

Lanes are the last axis: a call then has few arguments, and a lane is a column.
"""

from collections.abc import Iterable, Sequence
from itertools import groupby
from typing import TypeVar

import jax
import jax.core
import jax.numpy as jnp
import numpy as np
from jax import lax

Packed = TypeVar("Packed", jax.Array, np.ndarray)
Run = tuple[int, slice]  # rows of one of the arrays
GAP = 4  # so few rows between two leaves are read with them


class Packing:
    """Many small arrays a lane as one array: a call then has few arguments.

    Flags and whole numbers of up to 32 bits travel as float64, which holds them, where
    there is one; what is left stands in an array a dtype.
    """

    def __init__(self, shapes: Iterable[jax.ShapeDtypeStruct | jax.core.ShapedArray]):
        """Lay out leaves of these shapes and dtypes."""
        self.shapes = [(tuple(s.shape), np.dtype(s.dtype)) for s in shapes]
        wide = any(dtype == np.float64 for _, dtype in self.shapes)
        travels = [_held(dtype) if wide else dtype for _, dtype in self.shapes]
        self.dtypes = sorted(set(travels), key=str)
        self.places = [(0, slice(0))] * len(self.shapes)  # which array, and where in it
        self.used = [0] * len(self.dtypes)
        # those of a kind stand together
        self.order = sorted(
            range(len(self.shapes)), key=lambda i: (travels[i], str(self.shapes[i][1]))
        )
        for i in self.order:
            shape, which = self.shapes[i][0], self.dtypes.index(travels[i])
            first = self.used[which]
            self.used[which] += int(np.prod(shape))
            self.places[i] = which, slice(first, self.used[which])

    def pack(self, leaves: Sequence[jax.Array]) -> tuple[jax.Array, ...]:
        """The arrays of leaves that have their lanes behind.

        Rows of lanes are put one below the other: a vector for each lane would be
        gathered number by number. Those of a kind change it together.
        """
        parts: list[list[jax.Array]] = [[] for _ in self.dtypes]
        for _, alike in groupby(self.order, lambda i: self.shapes[i][1]):
            alike = list(alike)
            rows = [leaves[i].reshape(-1, leaves[i].shape[-1]) for i in alike]
            which = self.places[alike[0]][0]
            parts[which].append(jnp.concatenate(rows).astype(self.dtypes[which]))
        return tuple(map(jnp.concatenate, parts))

    def put(
        self,
        packed: Sequence[jax.Array],
        leaves: Sequence[jax.Array | None],
        lane: jax.Array | None = None,
    ) -> tuple[jax.Array, ...]:
        """The arrays with new leaves, of all lanes or of one; None: as they were.

        New rows that stand together are put there together: each on its own is one loop
        more to be compiled.
        """
        arrays, first = list(packed), np.int32(0) if lane is None else lane
        new = {i: x for i, x in enumerate(leaves) if x is not None}
        for (which, is_new), alike in groupby(
            self.order, lambda i: (self.places[i][0], i in new)
        ):
            if is_new:
                alike = list(alike)
                begin = np.int32(self.places[alike[0]][1].start)
                rows = [
                    new[i].reshape(-1, new[i].shape[-1] if lane is None else 1)
                    for i in alike
                ]
                block = jnp.concatenate([x.astype(self.dtypes[which]) for x in rows])
                arrays[which] = lax.dynamic_update_slice(
                    arrays[which], block, (begin, first)
                )
        return tuple(arrays)

    def runs(self, places: Iterable[int]) -> list[Run]:
        """Where these leaves stand, with few rows between them."""
        runs: list[Run] = []
        mine = [self.places[i] for i in places]
        for which, first, end in sorted((i, x.start, x.stop) for i, x in mine):
            if runs and runs[-1][0] == which and first <= runs[-1][1].stop + GAP:
                first = runs.pop()[1].start
            runs.append((which, slice(first, end)))
        return runs

    def unpack(self, packed: Sequence[Packed]) -> list[Packed]:
        """The leaves again; lanes stand behind, and stay there."""
        return [self.leaf(packed, place) for place in range(len(self.shapes))]

    def leaf(
        self, packed: Sequence[Packed], place: int, runs: Sequence[Run] = ()
    ) -> Packed:
        """One of them; `runs`: what `packed` holds, where that is not all."""
        (shape, dtype), (which, rows) = self.shapes[place], self.places[place]
        whole = [(i, slice(0, used)) for i, used in enumerate(self.used)]
        first, array = next(
            (run.start, array)
            for (here, run), array in zip(runs or whole, packed, strict=True)
            if here == which and run.start <= rows.start and rows.stop <= run.stop
        )
        array = array[rows.start - first : rows.stop - first]
        return array.reshape(shape + array.shape[1:]).astype(dtype)

    def empty(self, lanes: int) -> tuple[np.ndarray, ...]:
        """Zeros for so many lanes."""
        pairs = zip(self.used, self.dtypes, strict=True)
        return tuple(np.zeros((used, lanes), dtype) for used, dtype in pairs)


def _held(dtype: np.dtype) -> np.dtype:
    """float64 where it holds every number of a dtype, else that dtype."""
    fits = dtype.itemsize <= 4 and np.can_cast(dtype, np.float64)
    return np.dtype(np.float64) if fits else dtype


def some_number(arrays: Iterable[jax.Array]) -> jax.Array | None:
    """One of the floats of packed arrays; None if they hold none."""
    for array in arrays:
        if jnp.issubdtype(array.dtype, jnp.floating) and array.size:
            return array[(0,) * array.ndim]
    return None
