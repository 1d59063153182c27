r"""Shots with second derivatives: a bundle of motions that differ a little.

What is wanted of a shot is not its Hessian but, along a few directions v,

$$\frac{d}{d\varepsilon} D(a + \varepsilon v) \Big|_0, \qquad
D = \frac{\partial\, \sigma y(T; y_0, p)}{\partial a}, \qquad a = (y_0, T, p),$$

all columns at once: by the symmetry of second derivatives it is the derivative of
$D v$ in all of a. A central difference of the derivatives of two motions gives it, the
motion itself between them in the same batch.
"""

from collections.abc import Callable
from typing import NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..model.chain_of_rods import AbstractChain
from ..motion.implicit import implicit, moving
from ..motion.integrate import Motion, Run
from ..motion.options import Method
from ..motion.variational import (
    AbstractContact,
    Flow,
    Make,
    Nearest,
    Varied,
    flow_of,
    varied_motion,
)
from ..numerics.resumable import Phase, place_of
from .shots import SHORTEST

# Of the difference. With 1e-10 for a step's tolerance the derivatives' noise is some
# 1e-9: the second ones are then good to four or five digits, which is what Newton's
# method gains in an iteration.
APART = 1e-5

Ambient = Float[Array, " a"]  # y0, T and the parameters


class Jet(NamedTuple):
    """The end of a shot and its derivatives in a = (y0, T, p), under the sign sigma."""

    y: Float[Array, " s"]
    first: Float[Array, "s a"]
    second: Float[Array, "k s a"]  # the change of `first` along each direction
    extent: Float[Array, " m"]
    modes: Float[Array, ""]
    contact: Nearest | tuple[()]  # what was watched, and its derivatives in a
    mixed: Bool[Array, ""]  # whether the motions beside it have other modes
    arrived: Bool[Array, ""]
    steps: Int[Array, ""]


class BundleRun(NamedTuple):
    """Where the motions of a bundle are."""

    runs: Run[Varied]  # (1 + 2 k,)

    @property
    def running(self) -> Bool[Array, ""]:
        """Whether one of them is on its way."""
        return jnp.any(self.runs.running)

    @property
    def steps(self) -> Int[Array, ""]:
        """Of all."""
        return jnp.sum(self.runs.steps, dtype=jnp.int32)

    @property
    def phase(self) -> Int[Array, ""]:
        """That of a loop of one."""
        return place_of(self.running)


class Bundle:
    """The shot from a, and one on each side of it along each direction.

    **Arguments:** `make`: the column of the parameters; `a` (s + 1 + n,), of s numbers
    of the state, the span and n parameters; `directions` (k, s + 1 + n); `method`: the
    budget is that of each motion; `numbers`: s, four of two rods.
    """

    def __init__(
        self,
        make: Make,
        a: Ambient,
        directions: Float[Array, "k a"],
        method: Method,
        contact: AbstractContact | None = None,
        numbers: int = 4,
    ):
        """Place them."""
        self.numbers = numbers
        moves = APART * directions
        self.starts = jnp.concatenate([a[None], a[None] + moves, a[None] - moves])
        self.make, self.method, self.contact = make, method, contact

    def _motion(self, a: Ambient) -> Motion[Varied]:
        s, watch = self.numbers, self.contact
        span, y0 = jnp.maximum(a[s], SHORTEST), a[:s]
        return varied_motion(
            self.make, a[s + 1 :], y0, span, self.method, contact=watch
        )

    def begin(self) -> BundleRun:
        """Before their first steps."""
        return BundleRun(jax.vmap(lambda a: self._motion(a).begin())(self.starts))

    @property
    def phases(self) -> list[Phase[BundleRun]]:
        """One: they are advanced by steps, together."""
        return [Phase(self._advance)]

    def _advance(self, run: BundleRun, max_steps: Int[Array, ""]) -> BundleRun:
        def one(a: Ambient, run: Run[Varied]) -> Run[Varied]:
            return self._motion(a).advance(run, max_steps)

        return BundleRun(jax.vmap(one)(self.starts, run.runs))


def jet_of(run: BundleRun, sign: Float[Array, ""]) -> Jet:
    """The jet of a bundle whose motions have all ended."""
    flow = cast(Flow, jax.vmap(flow_of)(run.runs))
    y, s = sign * flow.y, flow.y.shape[1]
    first = sign * jnp.concatenate(
        [flow.moved[:, :, :s], flow.slope[:, :, None], flow.moved[:, :, s:]], axis=2
    )
    k = (flow.y.shape[0] - 1) // 2
    second = (first[1 : k + 1] - first[k + 1 :]) / (2 * APART)
    arrived = jnp.all(flow.arrived)
    y = jnp.where(arrived, y[0], jnp.nan)
    steps = jnp.sum(flow.steps, dtype=jnp.int32)
    contact = ()
    if flow.contact:
        value, moves = (jnp.asarray(x)[0] for x in flow.contact)
        zero = jnp.zeros(1, moves.dtype)  # it does not depend on when the shot ends
        contact = value, jnp.concatenate([moves[:s], zero, moves[s:]])
    mixed = jnp.any(flow.modes != flow.modes[0])
    ends = flow.extent[0], flow.modes[0], contact, mixed, arrived, steps
    return Jet(y, first[0], second, *ends)


def blank_jet(k: int, a: int, dtype: np.dtype, contact: AbstractContact | None) -> Jet:
    """A jet of k directions in a numbers that has not been computed."""

    def none(*shape: int) -> Float[Array, "..."]:
        return jnp.zeros(shape, dtype)

    no = jnp.asarray(False)
    watched = () if contact is None else (none(), none(a))
    ends = none(3), none(), watched, no, no, jnp.zeros((), jnp.int32)
    return Jet(none(4), none(4, a), none(k, 4, a), *ends)


def follow_bundle(bundle: Bundle, sign: Float[Array, ""]) -> Jet:
    """The jet of a bundle that is followed at once."""
    budget = jnp.asarray(bundle.method.max_steps, jnp.int32)
    return jet_of(bundle.phases[0].advance(bundle.begin(), budget), sign)


Jets = Callable[[Ambient, Float[Array, "k a"]], Jet]


# ---- what a cycle's numbers carry


def carried_extent(
    column: AbstractChain,
    y0: Float[Array, " s"],
    span: Float[Array, ""],
    method: Method,
) -> Float[Array, " m"]:
    """Zeros that carry the derivatives of a motion's largest angles.

    In the start and the column; they stand still within the span, so that its length
    is no matter.
    """
    (p, make), s = moving(column, y0.dtype), y0.size

    def slope(
        a: Float[Array, " a"], span: Float[Array, ""], method: Method
    ) -> Float[Array, "m a"]:
        motion = varied_motion(make, a[s:], a[:s], span, method)
        flow = flow_of(motion.advance(motion.begin()))
        return flow.extent_moved * jnp.where(flow.arrived, 1.0, jnp.nan)

    return implicit((s - 1,), slope, jnp.concatenate([y0, p]), span, method)


def carried_monodromy(
    column: AbstractChain,
    y0: Float[Array, " s"],
    span: Float[Array, ""],
    method: Method,
) -> Float[Array, "s s"]:
    r"""Zeros that carry the derivatives of $\partial y(T) / \partial y_0$.

    In the start, the span and the column: central differences, good to some five
    digits; NaN where the motions beside it stick and slip in another order.
    """
    (p, make), s = moving(column, y0.dtype), y0.size

    def slope(a: Ambient, method: Method) -> Float[Array, "s s a"]:
        along = jnp.eye(s, a.size, dtype=a.dtype)
        bundle = Bundle(make, a, along, method, numbers=s)
        jet = follow_bundle(bundle, jnp.ones((), a.dtype))
        mark = jnp.where(jet.arrived & ~jet.mixed, 1.0, jnp.nan)
        return jnp.swapaxes(jet.second, 0, 1) * mark

    return implicit((s, s), slope, jnp.concatenate([y0, span[None], p]), method)
