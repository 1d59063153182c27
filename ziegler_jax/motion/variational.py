r"""A motion together with its derivatives: the variational equations as a fold.

Of each accepted step $y_1 = \Phi(y_0, p)$ the derivative with the step's length frozen
is taken, so that what comes out is the exact derivative of the discrete flow. Its error
counts with the step's: a cycle however small has multipliers of size one.
"""

import abc
from collections.abc import Callable
from functools import partial, reduce
from typing import ClassVar, NamedTuple, cast

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..model.chain import accelerated, joint_angles, moved
from ..model.chain_of_rods import AbstractChain
from ..model.state import PhasePoint
from ..model.system import System
from ..numerics.numbers import Numbers, Scalar
from ..numerics.series import sum_of
from ..results import CODE
from ..solvers import AbstractFold, Explicit, Step, Taylor
from ..solvers.along import along_to, expand_along
from ..solvers.expansion import allowed
from .integrate import Motion, Run
from .options import Method
from .section import angles
from .tangents import past, push

Parameters = Float[Array, " n"]
Make = Callable[[Parameters], AbstractChain]  # a column of parameters
Row = Float[Array, " k"]  # derivatives along k directions
Rows = tuple[Row, ...]


NONE = 1e3  # of a motion in which nothing was watched for
# the number, and its derivatives along k directions
Nearest = tuple[Scalar, Scalar | Row]


class AbstractContact(eqx.Module):
    """A number that is watched at instants of a motion; the nearest to zero counts."""

    def begin(self, zero: Scalar, k: int) -> Nearest:
        """There was none yet."""
        return zero + NONE, jnp.zeros(k, jnp.result_type(zero))

    @abc.abstractmethod
    def lands(self, step: Step) -> Array:
        """Whether there is one at the step's end."""

    @abc.abstractmethod
    def landing(
        self, system: System, step: Step, dy: PhasePoint, dp: System | None
    ) -> tuple[Scalar, Scalar]:
        """The number there, and how it differs.

        **Arguments:** `system`: in the modes of the step; `dy`: a difference at its
        end, before the event; `dp`: how the system's numbers differ.
        """

    def turn(self, step: Step) -> tuple[Scalar, Array] | None:
        """Where within the step there is one, as a share of it, and whether; or None.

        `least` is the number there, which has no slope in time.
        """
        del step
        return None

    def least(self, step: Step, y: PhasePoint) -> Scalar:
        """The number of a state within the step, or its difference."""
        del step, y
        raise NotImplementedError


class Flow(NamedTuple):
    """The motion at the end of a span, and its derivatives, k of them.

    The first columns are those in the start, 4 of two rods, the others in the
    parameters.
    """

    y: Float[Array, " s"]
    slope: Float[Array, " s"]  # the right-hand side there
    extent: Float[Array, " a"]  # largest |phi1|, |phi2|, ..., |phi2 - phi1|, ...
    moved: Float[Array, "s k"]
    extent_moved: Float[Array, "a k"]
    arrived: Bool[Array, ""]  # whether the span was integrated to its end
    steps: Int[Array, ""]
    modes: Float[Array, ""]  # a number of the sequence of modes, 0 where there is none
    contact: Nearest | tuple[()] = ()  # what was watched


def varied_motion(
    make: Make,
    parameters: Parameters,
    y0: Float[Array, " s"],
    span: Scalar,
    method: Method,
    vary: bool = True,
    contact: AbstractContact | None = None,
) -> Motion["Varied"]:
    """The motion of `make(parameters)` from y0 over a positive span.

    **Arguments:** `parameters`: shape (n,); `vary`: whether to differentiate in them;
    `contact`: what to watch besides.
    """
    system, fold = varied(make, parameters, method.variational, vary)
    fold = Variational(fold.solver, fold.k, fold.moves, contact)
    start = PhasePoint(y0[i] for i in range(y0.size))
    return Motion(system, start, fold, method, end=span)


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
        jnp.asarray(0.0 * run.y[0] if isinstance(modes, tuple) else modes),
        run.folded.contact,
    )


def varied(
    make: Make, parameters: Parameters, solver: Explicit | Taylor, vary: bool = True
) -> tuple[System, "Variational"]:
    """The system, and the fold that varies its motion."""
    system, moves = make(parameters).system(), None
    if vary:
        zero = jnp.zeros(2 * system.joints, parameters.dtype)
        arrays = jax.tree.map(lambda x: isinstance(x, jax.Array), system)
        slopes = jax.jacfwd(lambda p: eqx.filter(make(p).system(), arrays))(parameters)
        moves = jax.tree.map(lambda s: jnp.concatenate([zero, s]), slopes)
    k = 2 * system.joints + (parameters.size if vary else 0)
    return system, Variational(solver, k, moves)


class Varied(NamedTuple):
    """Variations of the state, and the largest angles with theirs; k directions."""

    y: PhasePoint  # of rows
    extent: Numbers
    extent_moves: Rows
    modes: Scalar | tuple[()]  # set-valued friction: a number of the events so far
    contact: Nearest | tuple[()] = ()


class Variational(AbstractFold[Varied]):
    """The variational equations along a motion, with its largest angles.

    **Arguments:** `solver`; `k`: the directions, of state and numbers; `moves`: the
    derivatives of the system's numbers along them, (k,) each, None where they do not
    move.
    """

    needs_slope: ClassVar[bool] = True

    solver: Explicit | Taylor
    k: int = eqx.field(static=True)
    moves: System | None
    contact: AbstractContact | None = None

    def init(self, system, t0, y0):
        """Unit vectors, and the start's own angles."""
        del t0
        rows = self.unit(y0)
        if system.sticks:
            rows = PhasePoint.of(rows.phi, _stopped(system, y0, rows.omega))
        angles = *y0.phi, *joint_angles(y0.phi)[1:]
        signs = [jnp.where(x < 0, -1.0, 1.0) for x in angles]
        turned = *rows.phi, *joint_angles(rows.phi)[1:]
        return Varied(
            rows,
            tuple(jnp.abs(x) for x in angles),
            tuple(s * row for s, row in zip(signs, turned, strict=True)),
            0.0 * y0[0] if system.sticks else (),
            () if self.contact is None else self.contact.begin(0.0 * y0[0], self.k),
        )

    def outcome(self, state):
        """None: it only watches."""
        del state
        return jnp.asarray(CODE.not_computed, jnp.int32)

    def unit(self, y0: PhasePoint) -> PhasePoint:
        """The state's unit vectors among the k directions."""
        rows = jnp.eye(len(y0), self.k, dtype=jnp.result_type(y0[0]))
        return PhasePoint(rows[i] for i in range(len(y0)))

    def advance(self, solver, t0, t1, y0, system, first, state):
        """A step, and (peaks, their and its own rows of k derivatives)."""
        del first, state

        def along(v, dp):
            (f0, [df0]), (y1, [dy]), (error, [de]), (f1, [df1]) = push(
                solver, system, t0, t1, y0, [v], dp
            )
            turns, ends = partial(_peaks, t1 - t0), (y0, f0, y1, f1)
            peaks, dpeaks = jax.jvp(turns, ends, (v, df0, dy, df1))
            return (y1, error, f1, peaks), (dy, de, dpeaks)

        step = jax.vmap(along, out_axes=(None, 0))
        (y1, error, f1, peaks), (dy, errors, dpeaks) = step(self.unit(y0), self.moves)
        # the state's columns alone: steps do not depend on what is differentiated
        worst = PhasePoint(
            jnp.maximum(jnp.abs(e), jnp.max(jnp.abs(row[: len(y0)])))
            for e, row in zip(error, cast(Rows, errors), strict=True)
        )
        return y1, worst, f1, (peaks, dy, dpeaks), None

    def expand(self, system, y0, order, token, state):
        """The series of a step, and of unit differences along all directions."""
        del state
        rows = self.unit(y0)
        vectors = [jax.tree.map(lambda row, i=i: row[i], rows) for i in range(self.k)]
        return expand_along(system, y0, order, token, vectors, self.moves)

    def allowed(self, motion, along, rtol, atol):
        """As long as the series of the motion and of the state's directions allow."""
        each = [allowed(one, rtol, atol) for one in (motion.y, *along[: len(motion.y)])]
        return reduce(jnp.minimum, each)

    def _rows(self, step: Step):
        """As `advance`'s integrals, of a step of Taylor's and its differences."""
        rows = jax.tree.map(lambda *x: jnp.stack(x), *step.moved)

        def turns(series):
            return tuple(p.extremum() for p in angles(step._replace(series=series)))

        def along(series):
            return jax.jvp(turns, (step.series,), (series,))

        peaks, dpeaks = jax.vmap(along, out_axes=(None, 0))(rows.series)
        return peaks, rows.y1, dpeaks

    def step(self, system, state, step):
        """Carry the variations over the step, and over the event at its end."""
        jacobians = step.integrals
        if step.moved:
            jacobians = self._rows(step)
        elif step.modes:  # it may have been cut
            ends = step.t0, step.t1, step.y0
            *_, jacobians, _ = self.advance(self.solver, *ends, system, step.f0, state)
        peaks, *jacobians = jacobians

        def carry(row):  # the step's Jacobian times what was, and the parameters' own
            size = len(state.y)
            before = sum_of([row[i] * state.y[i] for i in range(size)])
            return jnp.asarray(before).at[size:].add(row[size:])

        dy, dpeaks = (
            PhasePoint(map(carry, jacobians[0])),
            (*map(carry, jacobians[1]),),
        )

        def beyond(v, dp):
            return past(system, step, (v,), dp)[0]

        contact = self._contact(system, state, step, dy)
        turn = self.contact and self.contact.turn(step)
        if self.contact and turn:
            there = self.contact, *turn
            contact = self._within(there, system, state, step, carry, contact)
        dy = jax.vmap(beyond)(dy, self.moves)
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
        self, system: System, state: Varied, step: Step, dy: PhasePoint
    ) -> Nearest | tuple[()]:
        """The watch after the step; `dy`: the differences before the event."""
        watch = self.contact
        if watch is None:
            return ()

        def landing(dy, dp):
            return watch.landing(system, step, dy, dp)

        new = jax.vmap(landing, out_axes=(None, 0))(dy, self.moves)
        return nearer(new, cast(Nearest, state.contact), watch.lands(step))

    def _within(
        self,
        there: tuple[AbstractContact, Scalar, Array],
        system: System,
        state: Varied,
        step: Step,
        carry: Callable[[Row], Row],
        before: Nearest | tuple[()],
    ) -> Nearest:
        """At an instant within the step: the same step, only as far as there."""
        watch, share, turns = there
        h = share * (step.t1 - step.t0)
        if step.series:
            y = along_to(step.series, h)
            moved = [along_to(one.series, h) for one in step.moved]
            rows = jax.tree.map(lambda *x: jnp.stack(x), *moved)
        else:
            ends = step.t0, step.t0 + h, step.y0
            y, *_, (_, rows, _), _ = self.advance(
                self.solver, *ends, system, step.f0, state
            )
        # it stands still there: that it turns earlier or later changes nothing
        moved = watch.least(step, PhasePoint(map(carry, cast(Rows, rows))))
        return nearer((watch.least(step, y), moved), cast(Nearest, before), turns)


def nearer(new: Nearest, old: Nearest, there: Array) -> Nearest:
    """The one of two that is nearer to zero; `there`: whether the new one is one."""
    closer = there & (jnp.abs(new[0]) < jnp.abs(old[0]))
    return jnp.where(closer, new[0], old[0]), jnp.where(closer, new[1], old[1])


def events_number(modes: Scalar | tuple[()], step: Step) -> Scalar | tuple[()]:
    """A number of the sequence of modes after a step; of another one it is another.

    But by rare chance; () where no joint sticks.
    """
    if isinstance(modes, tuple):
        return ()
    assert step.event
    joint, after = step.event
    number = sum_of([joint, *(3.0 ** (i + 1) * m for i, m in enumerate(after))])
    met = 0.7 * modes + (number + 14.0)
    return jnp.where(joint > 0, met, modes)


def _stopped(system: System, y: PhasePoint, rates: Numbers) -> Numbers:
    """Variations of the rates where joints stick at the start.

    A joint that is set off a little is stopped at once, by an impulse of its friction:
    the momenta across it are kept.
    """
    law, balance = system.law, system.balance(y)
    momenta = moved(balance.mass, rates)
    return accelerated(law.factored(balance.mass), momenta, law.stuck)


def _peaks(
    h: Scalar, y0: PhasePoint, f0: PhasePoint, y1: PhasePoint, f1: PhasePoint
) -> Numbers:
    """Where the rods' and joints' angles turn within a step, else at its end."""
    step = Step(0.0 * h, h, y0, y1, f0, f1, ())
    return tuple(path.extremum() for path in angles(step))
