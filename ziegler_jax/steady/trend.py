"""How large a motion's returns are as time goes on: does it grow, does it last?

At a few times the largest return since the last of them is looked at. A motion endures,
though no cycle is certain yet, whose largest returns grow by more than 1 % three times
in a row, or have not fallen by 1 % nine times in a row, while time grows sevenfold at
least, and rose at some of them: one that falls steadily, however slowly, does not
(`benchmarks/a13_certified_truth.py onsets` follows such motions on).
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Int

from ..numerics.materialise import tree_where
from ..numerics.numbers import Flag, Scalar
from ..results import CODE

GROWTH, FALL = 1.01, 0.99
GROWN, LASTED, RISEN = 3, 9, 2  # times in a row, and of these
NEARLY = 0.01  # a motion whose returns come nearer than this is slow, not aperiodic


class Trend(NamedTuple):
    """The trend of the largest returns."""

    peak: Scalar  # the largest since the last time
    before: Scalar  # and between the two times before
    whence: Scalar  # the same where it began to last
    grew: Scalar  # at how many times in a row
    lasted: Scalar
    rose: Scalar  # at how many of the last ones

    def after(self, size: Scalar, timed: Flag) -> "Trend":
        """One return more; `timed`: whether one of the times is over."""
        peak = jnp.maximum(self.peak, size)
        grows, lasts = peak > GROWTH * self.before, peak > FALL * self.whence
        rises = jnp.where(peak > self.before, 1.0, 0.0)
        after = Trend(
            peak=0.0 * peak,
            before=peak,
            whence=jnp.where(lasts, self.whence, peak),
            grew=jnp.where(grows, self.grew + 1, 0.0),
            lasted=jnp.where(lasts, self.lasted + 1, 0.0),
            rose=jnp.where(lasts, self.rose + rises, 0.0),
        )
        return tree_where(timed, after, self._replace(peak=peak))

    @property
    def endures(self) -> Flag:
        """Whether the motion will not come to rest."""
        return (self.grew >= GROWN) | self._lasts

    @property
    def _lasts(self) -> Flag:
        return (self.lasted >= LASTED) & (self.rose >= RISEN)

    def kind(self, nearest: Scalar, unstable: Flag) -> Int[Array, ""]:
        """Of which kind the motion is, if nothing is certain.

        **Arguments:** `nearest`: about the smallest distance of its last returns;
        `unstable`: whether an unstable cycle was met.
        """
        kind = jnp.where(nearest < NEARLY, CODE.slow, CODE.aperiodic)
        kind = jnp.where(jnp.isfinite(nearest), kind, CODE.no_passages)
        kind = jnp.where(self._lasts, CODE.lasting, kind)
        kind = jnp.where(self.grew >= GROWN, CODE.growing, kind)
        return jnp.where(unstable, CODE.unstable_near, kind)


def no_trend(zero: Scalar) -> Trend:
    """Before the first return."""
    return Trend(zero, zero + jnp.inf, zero + jnp.inf, zero, zero, zero)
