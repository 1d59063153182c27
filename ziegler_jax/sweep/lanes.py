"""How the lanes of a sweep run, as a value."""

from dataclasses import dataclass

from ..numerics.numbers import whole_number


@dataclass(frozen=True)
class Lanes:
    """How the lanes of a sweep run.

    **Arguments:**

    - `batch_size`: lanes a batch. None is 8192 for points that follow no motion, and
        else 128 (64 or 32 for sweeps of no more than two of these), or 384 where
        `configure_cpu()` was needed and not called. It is rounded up to a multiple of
        32, whole vectors of a processor: so a lane's result depends
        neither on its batch mates nor on its place. Another batch size is another
        program; those of 32, 64 and 128 lanes gave the same bits wherever they were
        compared, others are equal to rounding.
    - `threads`: None uses every core that the process may use.

    **Raises:** `ValueError` for what breaks a rule.
    """

    batch_size: int | None = None
    threads: int | None = None

    def __post_init__(self):
        """Check them."""
        for name in ("batch_size", "threads"):
            if getattr(self, name) is not None:
                whole_number(name, getattr(self, name))
