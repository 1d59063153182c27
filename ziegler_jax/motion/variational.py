r"""A motion together with its derivatives: the variational equations as a fold.

Of each accepted step $y_1 = \Phi(y_0, p)$ the derivative with the step's length frozen
is taken, so that what comes out is the exact derivative of the discrete flow. With
set-valued friction a change of modes adds the jump of `saltation`.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp

from ..model.column import Column, joint_balance, vector_field
from ..model.set_valued import in_modes
from ..numerics.materialise import if_any_lane
from ..numerics.numbers import Vector4
from ..results import OUTCOME
from ..solvers import AbstractFold, Explicit, Step
from .integrate import Method, Motion, Run
from .saltation import saltation
from .scene import prepared
from .section import angles

TERMS = dfx.ODETerm(vector_field)


class Flow(NamedTuple):
    """The motion at the end of a span, and its k = 4 + n derivatives.

    Columns 0 to 3 are those in the start, the others in the n parameters.
    """

    y: Any  # (4,)
    slope: Any  # (4,) the right-hand side there
    extent: Any  # (3,) largest |phi1|, |phi2|, |phi2 - phi1|
    moved: Any  # (4, k)
    extent_moved: Any  # (3, k)
    arrived: Any  # whether the span was integrated to its end
    steps: Any


def flow(
    make: Callable[[Any], Column],
    parameters: Any,
    y0: Any,
    span: Any,
    method: Method,
    vary: bool = True,
) -> Flow:
    """Follow `make(parameters)` from y0 (4,) over a positive span, with derivatives.

    **Arguments:** `parameters`: shape (n,); `vary`: whether to differentiate in them.
    """
    motion = varied_motion(make, parameters, y0, span, method, vary)
    return flow_of(motion.advance(motion.begin()))


def varied_motion(
    make: Callable[[Any], Column],
    parameters: Any,
    y0: Any,
    span: Any,
    method: Method,
    vary: bool = True,
) -> Motion:
    """The motion that `flow` follows."""
    args, fold, method = varied(make, parameters, method, vary)
    start: Any = tuple(y0[i] for i in range(4))
    return Motion(args, start, fold, method, end=span)


def flow_of(run: Run) -> Flow:
    """Where such a motion ended, with its derivatives."""
    return Flow(
        jnp.stack(run.y),
        jnp.stack(run.solver.slope),
        jnp.stack(run.folded.extent),
        jnp.stack(run.folded.y),
        jnp.stack(run.folded.extent_moves),
        run.outcome == OUTCOME.complete,
        run.steps,
    )


def varied(
    make: Callable[[Any], Column], parameters: Any, method: Method, vary: bool = True
) -> tuple[Column, "Variational", Method]:
    """The prepared column, the fold that varies its motion, and the method for it."""
    args, which, moves = prepared(make(parameters)), (), ()
    if vary:
        which, moves = _moving(make, parameters)
    linearised = Linearised(method.solver, which, moves)
    if not args.sticks:  # else a step may be cut: its Jacobian is the fold's to find
        method = method._replace(solver=linearised)
    return args, Variational(linearised), method


def _moving(make: Callable, parameters: Any) -> tuple[tuple, tuple]:
    """Which leaves of the prepared column move, and their (4 + n,) derivatives."""
    leaves = jax.tree.leaves(prepared(make(parameters)))
    which = tuple(i for i, x in enumerate(leaves) if isinstance(x, jax.Array))

    def moving(p):
        leaves = jax.tree.leaves(prepared(make(p)))
        return [leaves[i] for i in which]

    zero = jnp.zeros(4, parameters.dtype)
    slopes = jax.jacfwd(moving)(parameters)
    return which, tuple(jnp.concatenate([zero, s]) for s in slopes)


class Linearised(eqx.Module):
    """A method whose steps come with their Jacobian, in place of integrals.

    Its error counts with the step's: a cycle however small has multipliers of size one.

    **Arguments:** `solver`; `args`: the prepared column; `which` of its leaves move;
    `moves`: their derivatives in k = 4 + n directions, (k,) each.
    """

    solver: Explicit
    which: tuple = eqx.field(static=True)
    moves: tuple

    def order(self, terms):
        """The method's."""
        return self.solver.order(terms)

    def error_order(self, terms):
        """The method's."""
        return self.solver.error_order(terms)

    def func(self, terms, t0, y0, args):
        """The right-hand side."""
        return self.solver.func(terms, t0, y0, args)

    def init(self, terms, t0, t1, y0, args):
        """The first stage of the first step."""
        return self.solver.init(terms, t0, t1, y0, args)

    def advance(self, terms, t0, t1, y0, args, first, integrand=None):
        """A step, and (peaks, their and its own rows of k derivatives)."""
        del first, integrand

        def over(y, moving):
            column = self.column(args, moving)
            first = vector_field(t0, y, column)
            y1, error, last, *_ = self.solver.advance(terms, t0, t1, y, column, first)
            peaks = _peaks(t1 - t0, y, first, y1, last)
            return (y1, peaks, error), last

        def along(dy, dp):
            at = y0, self.moving(args)
            return jax.jvp(over, at, (dy, dp), has_aux=True)

        step = jax.vmap(along, out_axes=(None, 0, None))
        (y1, peaks, error), slopes, last = step(self.unit(y0), list(self.moves))
        *slopes, errors = slopes
        # the state's columns alone: steps do not depend on what is differentiated
        worst = tuple(
            jnp.maximum(jnp.abs(e), jnp.max(jnp.abs(row[:4])))
            for e, row in zip(error, errors, strict=True)
        )
        return y1, worst, last, (peaks, *slopes), None

    def unit(self, y0: Vector4) -> tuple:
        """The state's unit vectors among the k directions."""
        k = self.moves[0].shape[0] if self.moves else 4
        rows = jnp.eye(4, k, dtype=y0[0].dtype)
        return tuple(rows[i] for i in range(4))

    def moving(self, args: Column) -> list:
        """The leaves that move."""
        # modes stand behind the leaves of a prepared column's friction
        leaves = jax.tree.leaves(_without_modes(args))
        return [leaves[i] for i in self.which]

    def column(self, args: Any, moving: list) -> Any:
        """The column with these leaves in place of its own."""
        leaves, tree = jax.tree.flatten(_without_modes(args))
        for i, x in zip(self.which, moving, strict=True):
            leaves[i] = x
        column = jax.tree.unflatten(tree, leaves)
        return in_modes(column, args.friction.modes) if args.sticks else column


class Varied(NamedTuple):
    """Variations of the state, and the largest angles with theirs; k directions."""

    y: tuple  # four arrays (k,)
    extent: tuple  # three numbers
    extent_moves: tuple  # three arrays (k,)


class Variational(AbstractFold):
    """The variational equations along a motion, with its largest angles."""

    method: Linearised

    def integrand(self, column):
        """Nothing: the method offers its Jacobian in its place."""
        del column
        return None

    def init(self, column, t0, y0):
        """Unit vectors, and the start's own angles."""
        del t0
        rows = self.method.unit(y0)
        if column.sticks:
            rows = (*rows[:2], *_stopped(column, y0, rows[2], rows[3]))
        angles = y0[0], y0[1], y0[1] - y0[0]
        signs = [jnp.where(x < 0, -1.0, 1.0) for x in angles]
        turned = rows[0], rows[1], rows[1] - rows[0]
        return Varied(
            rows,
            tuple(jnp.abs(x) for x in angles),
            tuple(s * row for s, row in zip(signs, turned, strict=True)),
        )

    def outcome(self, state):
        """None: it only watches."""
        del state
        return jnp.asarray(OUTCOME.not_computed, jnp.int32)

    def step(self, column, state, step):
        """Carry the variations over the step, and over the event at its end."""
        found = step.integrals
        if step.modes:
            ends = step.t0, step.t1, step.y0
            *_, found, _ = self.method.advance(TERMS, *ends, column, step.f0)
        peaks, *jacobians = found

        def carry(row):  # the step's Jacobian times what was, and the parameters' own
            before: Any = sum(row[i] * state.y[i] for i in range(4))
            return before.at[4:].add(row[4:])

        dy, dpeaks = (tuple(map(carry, rows)) for rows in jacobians)
        if step.modes:
            dy = (*dy[:2], *column.friction.hold(dy[2], dy[3]))
            event = step.event[0] > 0

            def passed(dy):
                of, along = self.method, list(self.method.moves)
                numbers = of.moving(column)
                jump = saltation(column, step, numbers, lambda x: of.column(column, x))
                pairs = zip(jax.vmap(jump)(dy, along), dy, strict=True)
                return tuple(jnp.where(event, new, old) for new, old in pairs)

            dy = if_any_lane(event, passed, dy)
        extent, moves = [], []
        for old, dold, new, dnew in zip(
            state.extent, state.extent_moves, peaks, dpeaks, strict=True
        ):
            larger = jnp.abs(new) > old
            extent.append(jnp.where(larger, jnp.abs(new), old))
            moves.append(jnp.where(larger, jnp.sign(new) * dnew, dold))
        return Varied(dy, tuple(extent), tuple(moves)), jnp.inf, False


def _without_modes(args: Any) -> Any:
    return in_modes(args, None) if args.sticks else args


def _stopped(column: Any, y: Vector4, dw1: Any, dw2: Any) -> tuple[Any, Any]:
    """Variations of the rates where joints stick at the start.

    A joint that is set off a little is stopped at once, by an impulse of its friction:
    the momenta across it are kept.
    """
    f = joint_balance(column, y)
    stuck1, stuck2 = (m == 0 for m in column.friction.modes)
    both = ((f.a + f.h) * dw1 + (f.h + f.d) * dw2) / (f.a + 2 * f.h + f.d)
    second = jnp.where(stuck1, dw2 + f.h / f.d * dw1, dw2)
    still = stuck1 & stuck2
    first = jnp.where(stuck1, 0.0, jnp.where(stuck2, both, dw1))
    return first, jnp.where(still, 0.0, jnp.where(stuck2, both, second))


def _peaks(h: Any, y0: Vector4, f0: Vector4, y1: Vector4, f1: Vector4) -> tuple:
    """Where phi1, phi2, phi2 - phi1 turn within a step, else at its end."""
    step = Step(0.0 * h, h, y0, y1, f0, f1, ())
    return tuple(path.extremum() for path in angles(step))
