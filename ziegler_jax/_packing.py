"""Many small arrays as few: what a compiled batch takes and gives."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np


class Packing:
    """Many small arrays a lane as one array a dtype: a call then has few arguments."""

    def __init__(self, shapes: Sequence[Any]):
        """Lay out leaves of these shapes and dtypes."""
        self.shapes = [(tuple(s.shape), np.dtype(s.dtype)) for s in shapes]
        self.dtypes = sorted({dtype for _, dtype in self.shapes}, key=str)
        self.places = []  # which vector, and where in it
        used = [0] * len(self.dtypes)
        for shape, dtype in self.shapes:
            which = self.dtypes.index(dtype)
            first, used[which] = used[which], used[which] + int(np.prod(shape))
            self.places.append((which, slice(first, used[which])))
        self.used = used

    def pack(self, leaves: Sequence[Any]) -> tuple[jax.Array, ...]:
        """One vector a dtype."""
        pairs = list(zip(leaves, self.shapes, strict=True))
        return tuple(
            jnp.concatenate([jnp.ravel(leaf) for leaf, (_, d) in pairs if d == dtype])
            for dtype in self.dtypes
        )

    def unpack(self, packed: Sequence[Any]) -> list[Any]:
        """The leaves again; lanes, if any, stand behind, and stay there."""
        pairs = zip(self.shapes, self.places, strict=True)
        return [
            packed[which][place].reshape(shape + packed[which].shape[1:])
            for (shape, _), (which, place) in pairs
        ]

    def zeros(self) -> tuple[jax.Array, ...]:
        """What `pack` returns, with nothing in it."""
        pairs = zip(self.used, self.dtypes, strict=True)
        return tuple(jnp.zeros(used, dtype) for used, dtype in pairs)

    def empty(self, lanes: int) -> tuple[np.ndarray, ...]:
        """Zeros for a batch that has not started."""
        pairs = zip(self.used, self.dtypes, strict=True)
        return tuple(np.zeros((used, lanes), dtype) for used, dtype in pairs)
