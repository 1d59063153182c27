r"""A motion together with its derivatives: the variational equations as a fold.

Of each accepted step $y_1 = \Phi(y_0, p)$ the derivative with the step's length frozen
is taken, so that what comes out is the exact derivative of the discrete flow. Its error
counts with the step's: a cycle however small has multipliers of size one.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple, cast

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..model.column import Column, joint_balance
from ..model.set_valued import FrozenCoulomb
from ..numerics.numbers import Numbers, Pair, Scalar, Traced, Traced4, Vector4
from ..results import CODE
from ..solvers import AbstractFold, Explicit, Step
from .contact import AbstractContact, Dip, Nearest, nearer
from .integrate import Motion, Run
from .options import Method
from .scene import prepared
from .section import angles
from .tangents import past, push

Parameters = Float[Array, " n"]
Make = Callable[[Parameters], Column]  # a column of parameters
Row = Float[Array, " k"]  # derivatives along k directions
Rows = tuple[Row, ...]


class Flow(NamedTuple):
    """The motion at the end of a span, and its k = 4 + n derivatives.

    Columns 0 to 3 are those in the start, the others in the n parameters.
    """

    y: Float[Array, "4"]
    slope: Float[Array, "4"]  # the right-hand side there
    extent: Float[Array, "3"]  # largest |phi1|, |phi2|, |phi2 - phi1|
    moved: Float[Array, "4 k"]
    extent_moved: Float[Array, "3 k"]
    arrived: Bool[Array, ""]  # whether the span was integrated to its end
    steps: Int[Array, ""]
    modes: Float[Array, ""]  # a number of the sequence of modes, 0 where there is none
    contact: Nearest | tuple[()] = ()  # what was watched


def varied_motion(
    make: Make,
    parameters: Parameters,
    y0: Float[Array, "4"],
    span: Scalar,
    method: Method,
    vary: bool = True,
    contact: AbstractContact | None = None,
) -> Motion["Varied"]:
    """The motion of `make(parameters)` from y0 (4,) over a positive span.

    **Arguments:** `parameters`: shape (n,); `vary`: whether to differentiate in them;
    `contact`: what to watch besides.
    """
    args, fold = varied(make, parameters, cast(Explicit, method.solver), vary)
    fold = Variational(fold.solver, fold.k, fold.moves, contact)
    start = tuple(y0[i] for i in range(4))
    return Motion(args, cast(Traced4, start), fold, method, end=span)


def flow_of(run: "Run[Varied]") -> Flow:
    """Where such a motion ended, with its derivatives."""
    modes = run.folded.modes
    return Flow(
        jnp.stack(run.y),
        jnp.stack(run.solver.slope),
        jnp.stack(run.folded.extent),
        jnp.stack(run.folded.y),
        jnp.stack(run.folded.extent_moves),
        run.outcome == CODE.complete,
        run.steps,
        0.0 * jnp.asarray(run.y[0]) if isinstance(modes, tuple) else modes,
        run.folded.contact,
    )


def varied(
    make: Make, parameters: Parameters, solver: Explicit, vary: bool = True
) -> tuple[Column, "Variational"]:
    """The prepared column, and the fold that varies its motion."""
    column, moves = prepared(make(parameters)), None
    if vary:
        zero = jnp.zeros(4, parameters.dtype)
        arrays = jax.tree.map(lambda x: isinstance(x, jax.Array), column)
        slopes = jax.jacfwd(lambda p: eqx.filter(prepared(make(p)), arrays))(parameters)
        moves = jax.tree.map(lambda s: jnp.concatenate([zero, s]), slopes)
    return column, Variational(solver, 4 + (parameters.size if vary else 0), moves)


class Varied(NamedTuple):
    """Variations of the state, and the largest angles with theirs; k directions."""

    y: Rows  # four
    extent: Numbers  # three
    extent_moves: Rows  # three
    modes: Traced | tuple[()]  # set-valued friction: a number of the events so far
    contact: Nearest | tuple[()] = ()


class Variational(AbstractFold[Varied]):
    """The variational equations along a motion, with its largest angles.

    **Arguments:** `solver`; `k`: the directions, 4 + n; `moves`: the derivatives of the
    prepared column's numbers along them, (k,) each, None where they do not move.
    """

    solver: Explicit
    k: int = eqx.field(static=True)
    moves: Column | None
    contact: AbstractContact | None = None

    def init(self, column, t0, y0):
        """Unit vectors, and the start's own angles."""
        del t0
        rows = self.unit(y0)
        if column.sticks:
            rows = (*rows[:2], *_stopped(column, y0, rows[2], rows[3]))
        angles = y0[0], y0[1], y0[1] - y0[0]
        signs = [jnp.where(x < 0, -1.0, 1.0) for x in angles]
        turned = rows[0], rows[1], rows[1] - rows[0]
        return Varied(
            rows,
            tuple(jnp.abs(x) for x in angles),
            tuple(s * row for s, row in zip(signs, turned, strict=True)),
            0.0 * y0[0] if column.sticks else (),
            () if self.contact is None else self.contact.begin(0.0 * y0[0], self.k),
        )

    def outcome(self, state):
        """None: it only watches."""
        del state
        return jnp.asarray(CODE.not_computed, jnp.int32)

    def unit(self, y0: Traced4) -> Rows:
        """The state's unit vectors among the k directions."""
        rows = jnp.eye(4, self.k, dtype=y0[0].dtype)
        return tuple(rows[i] for i in range(4))

    def advance(self, solver, terms, t0, t1, y0, column, first, state):
        """A step, and (peaks, their and its own rows of k derivatives)."""
        del terms, first, state

        def along(v, dp):
            (f0, [df0]), (y1, [dy]), (error, [de]), (f1, [df1]) = push(
                solver, column, t0, t1, y0, [v], dp
            )
            turns, ends = partial(_peaks, t1 - t0), (y0, f0, y1, f1)
            peaks, dpeaks = jax.jvp(turns, ends, (v, df0, dy, df1))
            return (y1, error, f1, peaks), (dy, de, dpeaks)

        step = jax.vmap(along, out_axes=(None, 0))
        (y1, error, f1, peaks), (dy, errors, dpeaks) = step(self.unit(y0), self.moves)
        # the state's columns alone: steps do not depend on what is differentiated
        worst = tuple(
            jnp.maximum(jnp.abs(e), jnp.max(jnp.abs(row[:4])))
            for e, row in zip(error, cast(Rows, errors), strict=True)
        )
        return y1, worst, f1, (peaks, dy, dpeaks), None

    def step(self, column, state, step):
        """Carry the variations over the step, and over the event at its end."""
        jacobians = step.integrals
        if step.modes:  # it may have been cut
            ends = step.t0, step.t1, step.y0
            *_, jacobians, _ = self.advance(
                self.solver, None, *ends, column, step.f0, state
            )
        peaks, *jacobians = jacobians

        def carry(row):  # the step's Jacobian times what was, and the parameters' own
            before = cast(jax.Array, sum(row[i] * state.y[i] for i in range(4)))
            return before.at[4:].add(row[4:])

        dy, dpeaks = (tuple(map(carry, rows)) for rows in jacobians)

        def beyond(v, dp):
            return past(column, step, (v,), dp)[0]

        contact = self._contact(column, state, step, dy)
        if isinstance(self.contact, Dip):
            contact = self._dip(
                self.contact, column, state, step, carry, cast(Nearest, contact)
            )
        dy = cast(Rows, jax.vmap(beyond)(dy, self.moves))
        extent, moves = [], []
        for old, dold, new, dnew in zip(
            state.extent, state.extent_moves, peaks, dpeaks, strict=True
        ):
            larger = jnp.abs(new) > old
            extent.append(jnp.where(larger, jnp.abs(new), old))
            moves.append(jnp.where(larger, jnp.sign(new) * dnew, dold))
        modes = events_number(state.modes, step)
        return Varied(dy, tuple(extent), tuple(moves), modes, contact), jnp.inf, False

    def _contact(
        self, column: Column, state: Varied, step: Step, dy: Rows
    ) -> Nearest | tuple[()]:
        """What is watched, after the step; `dy`: its differences before the event."""
        watch = self.contact
        if watch is None:
            return ()

        def landing(dy, dp):
            return watch.landing(column, step, dy, dp)

        new = jax.vmap(landing, out_axes=(None, 0))(dy, self.moves)
        return nearer(new, cast(Nearest, state.contact), watch.lands(step))

    def _dip(
        self,
        watch: Dip,
        column: Column,
        state: Varied,
        step: Step,
        carry: Callable[[Row], Row],
        before: Nearest,
    ) -> Nearest:
        """Where slip turns within the step: the same step, only as far as there."""
        share, turns = watch.turn(step)
        ends = step.t0, step.t0 + share * (step.t1 - step.t0), step.y0
        y, *_, (_, rows, _), _ = self.advance(
            self.solver, None, *ends, column, step.f0, state
        )
        # it stands still there: that it turns earlier or later changes nothing
        moved = watch.least(step, cast(Traced4, tuple(map(carry, rows))))
        return nearer((watch.least(step, y), moved), before, turns)


def events_number(modes: Traced | tuple[()], step: Step) -> Traced | tuple[()]:
    """A number of the sequence of modes after a step; of another one it is another.

    But by rare chance; () where no joint sticks.
    """
    if isinstance(modes, tuple):
        return ()
    assert step.event
    joint, (m1, m2) = step.event
    met = 0.7 * modes + (joint + 3.0 * m1 + 9.0 * m2 + 14.0)
    return jnp.where(joint > 0, met, modes)


def _stopped(column: Column, y: Vector4, dw1: Row, dw2: Row) -> tuple[Row, Row]:
    """Variations of the rates where joints stick at the start.

    A joint that is set off a little is stopped at once, by an impulse of its friction:
    the momenta across it are kept.
    """
    f = joint_balance(column, y)
    modes = cast(Pair, cast(FrozenCoulomb, column.friction).modes)
    stuck1, stuck2 = (m == 0 for m in modes)
    both = ((f.a + f.h) * dw1 + (f.h + f.d) * dw2) / (f.a + 2 * f.h + f.d)
    second = jnp.where(stuck1, dw2 + f.h / f.d * dw1, dw2)
    still = stuck1 & stuck2
    first = jnp.where(stuck1, 0.0, jnp.where(stuck2, both, dw1))
    return first, jnp.where(still, 0.0, jnp.where(stuck2, both, second))


def _peaks(h: Traced, y0: Traced4, f0: Traced4, y1: Traced4, f1: Traced4) -> Numbers:
    """Where phi1, phi2, phi2 - phi1 turn within a step, else at its end."""
    step = Step(0.0 * h, h, y0, y1, f0, f1, ())
    return tuple(path.extremum() for path in angles(step))
