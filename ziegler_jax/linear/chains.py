r"""The linear chain of any number of rods: its matrices, and where it loses stability.

About the equilibrium $\phi_e(q)$, $M \ddot x + C \dot x + K(q)\, x = 0$. Raised from
zero, the load takes the chain out of stability where

- undamped, two frequencies meet: $(K - \lambda M)\, x = 0$ has a double root with one
  eigenvector, and so there is a w with $(K - \lambda M)\, w = M x$;
- damped, a pair reaches the axis: $(K - \omega^2 M + i \omega C)\, x = 0$;
- a real eigenvalue passes zero: $K x = 0$.

The first such load is bracketed by the eigenvalues at loads 1 % apart, then by halves.
Newton's method on these equations, with one component of x held at 1, finds it
to rounding, and its last two steps carry derivatives: k steps from a root have those
up to order $2^k - 1$.

Source: A. P. Seyranian, A. A. Mailybaev, Multiparameter Stability Theory with
Mechanical Applications (2003), chapters 2 and 5.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from ..model.forces import OwnForces
from ..model.system import System
from ..numerics.materialise import tree_where
from ..numerics.numbers import Flag, Scalar
from ..results import CODE
from .matrices import (
    LEAP,
    Matrices,
    Vector,
    about,
    eigenvalues_of,
    equilibrium,
    nearer,
    of_first_order,
    springs,
    under,
)

# Loads that are looked at: so many, first so many to a unit, which turns the rods as
# much as the springs alone do; then each is greater by a share. That comes to ten
# million units. A loss of stability that ends again in between is passed over.
LOADS, PER_UNIT, SHARE = 2048, 1000, 0.01
HALVINGS = 40
# Of an eigenvalue: two frequencies have met where their squares are so far from real.
MET = 1e-4
ROUNDING = 1e-13  # of the largest rate: how far from the axis is on it
NEWTON_STEPS = 8  # without derivatives; two more have them
CLOSED = 1e-9  # what is left of the equations at a root, of their size


# ---- what is unstable


def _met(at: Matrices) -> Flag:
    """Whether, undamped, two frequencies have met."""
    squares = jnp.linalg.eigvals(jnp.linalg.solve(at.mass, at.stiffness))
    return jnp.any(jnp.abs(squares.imag) > MET * jnp.abs(squares))


def _grows(at: Matrices) -> Flag:
    """Whether, damped, an oscillation grows."""
    s = eigenvalues_of(at)
    noise = ROUNDING * jnp.max(jnp.abs(s))
    return jnp.any((s.real > noise) & (jnp.abs(s.imag) > noise))


def _falls(at: Matrices) -> Flag:
    """Whether an odd number of real eigenvalues has passed zero."""
    return jnp.linalg.slogdet(at.stiffness)[0] <= 0


Unstable = Callable[[Matrices], Flag]


class Bracket(NamedTuple):
    """Loads between which stability is lost, and the equilibrium at the lower."""

    there: Bool[Array, ""]
    low: Scalar
    high: Scalar
    angles: Vector


class Loads:
    """The chain at every load."""

    def __init__(self, system: System):
        """Work out what loads do not change."""
        self.system = system
        self.zero = jnp.zeros(system.joints, jnp.result_type(float))
        # of the upright chain K is K_0 + q K_1
        upright = eqx.tree_at(
            lambda s: (s.bent, s.across, s.own),
            system,
            (None, None, OwnForces()),
            is_leaf=lambda x: x is None,
        )
        load = jnp.zeros((), self.zero.dtype)
        self.none = about(under(upright, load), self.zero)
        self.by_load = (
            about(under(upright, load + 1), self.zero).stiffness - self.none.stiffness
        )

    def at(self, q: Scalar, angles: Vector, steps: int = 4) -> Matrices:
        """The matrices at a load; `angles`: near the equilibrium there."""
        if not self.system.displaced:
            stiffness = self.none.stiffness + q * self.by_load
            return self.none._replace(stiffness=stiffness)
        there = under(self.system, q)
        return about(there, nearer(there, angles, steps))

    def unit(self) -> Scalar:
        """A load that turns as much as the springs alone do; 1 where none turns."""
        n = self.system.joints
        upper = jnp.eye(n) - jnp.eye(n, k=-1)
        stiffness = upper.T @ (springs(self.system)[:, None] * upper)
        turned = jnp.sum(jnp.linalg.solve(stiffness, self.by_load) ** 2)
        return 1 / jnp.sqrt(jnp.where(turned > 0, turned, 1.0))


def _scan(
    loads: Loads, start: Vector, unstable: tuple[Unstable, Unstable], asked: int
) -> tuple[Bracket, Bracket]:
    """The first interval for each of two kinds, up to that of the one asked for."""
    unit = loads.unit() / PER_UNIT

    def look(state):
        k, low, angles, lost, brackets = state
        high = low + jnp.maximum(unit, SHARE * low)
        here, after = loads.at(high, angles), []
        lost |= jnp.max(jnp.abs(here.angles - angles)) > LEAP
        for bracket, kind in zip(brackets, unstable, strict=True):
            new = kind(here) & ~bracket.there & ~lost
            here_first = Bracket(jnp.asarray(True), low, high, angles)
            after.append(tree_where(new, here_first, bracket))
        return k + 1, high, here.angles, lost, tuple(after)

    def goes_on(state):
        k, *_, lost, brackets = state
        return (k < LOADS) & ~brackets[asked].there & ~lost

    zero = 0.0 * unit
    blank = Bracket(jnp.asarray(False), zero, zero + jnp.inf, start)
    begin = 0, zero, start, jnp.asarray(False), (blank, blank)
    return lax.while_loop(goes_on, look, begin)[-1]


def _halved(loads: Loads, bracket: Bracket, unstable: Unstable) -> Bracket:
    """The same interval, by halves."""

    def halve(_, b):
        middle = (b.low + b.high) / 2
        here = loads.at(middle, b.angles)
        lost = unstable(here)
        angles = jnp.where(lost, b.angles, here.angles)
        low, high = jnp.where(lost, b.low, middle), jnp.where(lost, middle, b.high)
        return b._replace(low=low, high=high, angles=angles)

    safe = bracket._replace(high=jnp.where(bracket.there, bracket.high, bracket.low))
    return lax.fori_loop(0, HALVINGS, halve, safe)


# ---- Newton's method on the boundary

Equations = Callable[[Float[Array, " m"]], Float[Array, " m"]]


def _root(equations: Callable, still: Callable, z: Float[Array, " m"]) -> tuple:
    """A root near z with its derivatives, and whether it is one.

    **Arguments:** `equations`: of z; `still`: the same without derivatives.
    """

    def step(function, z, closed: Flag = True):
        slope, value = jax.jacfwd(function)(z), function(z)
        # one that is no root has no derivative: not NaN, where another is chosen
        slope = jnp.where(closed, slope, jnp.eye(z.size))
        return z - jnp.linalg.solve(slope, jnp.where(closed, value, 0.0))

    z = lax.fori_loop(0, NEWTON_STEPS, lambda _, z: step(still, z), z)
    left = jnp.max(jnp.abs(still(z)))
    size = jnp.max(jnp.abs(jax.jacfwd(still)(z)) @ jnp.abs(z))
    closed = left < CLOSED * size
    z = lax.stop_gradient(jnp.where(closed, z, 1.0))
    for _ in range(2):
        z = step(equations, z, closed)
    return z, closed


def _held(x: Array) -> tuple[Array, Array]:
    """A vector whose largest component is 1, and which that is."""
    place = jnp.argmax(jnp.abs(x))
    return x / x[place], jnp.arange(x.size) == place


def _flutter_undamped(loads: Loads, still: Loads, at: Bracket) -> tuple:
    """Where two frequencies meet: load, frequency, whether Newton's method closes."""
    here, n = still.at(at.high, at.angles), still.system.joints
    squares, vectors = jnp.linalg.eig(jnp.linalg.solve(here.mass, here.stiffness))
    mine = jnp.argmax(jnp.abs(squares.imag) / jnp.abs(squares))
    x, place = _held(vectors[:, mine])
    square = squares[mine]
    w = x.imag / jnp.where(square.imag == 0, 1.0, square.imag)

    def equations(of, z):
        x, w, (square, q) = z[:n], z[n : 2 * n], z[2 * n :]
        mass, _, stiffness, _ = of.at(q, at.angles, 2)
        pencil = stiffness - square * mass
        ends = [jnp.sum(jnp.where(place, v, 0.0)) - one for v, one in ((x, 1), (w, 0))]
        return jnp.concatenate([pencil @ x, pencil @ w - mass @ x, jnp.stack(ends)])

    z = jnp.concatenate([x.real, w, jnp.stack([square.real, at.high])])
    z, closed = _root(partial(equations, loads), partial(equations, still), z)
    oscillates = z[-2] > 0
    frequency = jnp.sqrt(jnp.where(oscillates, z[-2], 1.0))
    return z[-1], jnp.where(oscillates, frequency, 0.0), closed


def _flutter_damped(loads: Loads, still: Loads, at: Bracket) -> tuple:
    """Where a pair reaches the axis; else as `_flutter_undamped`."""
    here, n = still.at(at.high, at.angles), still.system.joints
    values, vectors = jnp.linalg.eig(of_first_order(here))
    mine = jnp.argmax(jnp.where(values.imag > 0, values.real, -jnp.inf))
    x, place = _held(vectors[:n, mine])

    def equations(of, z):
        real, imag, (omega, q) = z[:n], z[n : 2 * n], z[2 * n :]
        mass, damping, stiffness, _ = of.at(q, at.angles, 2)
        assert damping is not None
        pencil, turned = stiffness - omega**2 * mass, omega * damping
        ends = [
            jnp.sum(jnp.where(place, v, 0.0)) - one for v, one in ((real, 1), (imag, 0))
        ]
        return jnp.concatenate(
            [pencil @ real - turned @ imag, pencil @ imag + turned @ real, *_rows(ends)]
        )

    z = jnp.concatenate(
        [x.real, x.imag, jnp.stack([jnp.abs(values[mine].imag), at.high])]
    )
    z, closed = _root(partial(equations, loads), partial(equations, still), z)
    return z[-1], jnp.abs(z[-2]), closed


def _rows(numbers: list) -> list:
    return [jnp.stack([x]) for x in numbers]


def _divergence(loads: Loads, still: Loads, at: Bracket) -> tuple:
    """Where K x = 0; else as `_flutter_undamped`."""
    here, n = still.at(at.high, at.angles), still.system.joints
    x, place = _held(jnp.linalg.svd(here.stiffness)[2][-1])

    def equations(of, z):
        stiffness = of.at(z[n], at.angles, 2).stiffness
        end = jnp.sum(jnp.where(place, z[:n], 0.0)) - 1
        return jnp.concatenate([stiffness @ z[:n], end[None]])

    z = jnp.concatenate([x, jnp.reshape(at.high, 1)])
    z, closed = _root(partial(equations, loads), partial(equations, still), z)
    return z[-1], jnp.zeros_like(z[-1]), closed


@partial(jax.jit, static_argnames="kind")
def first_loss(
    system: System, valid: Flag, kind: str
) -> tuple[Scalar, Scalar, Int[Array, ""]]:
    """The first load of this kind, its frequency, and the code."""
    still = Loads(lax.stop_gradient(system))
    loads, none = Loads(system), jnp.zeros((), jnp.result_type(float))
    start, there = equilibrium(under(still.system, none))
    begin = still.at(none, start)
    damped = begin.damping is not None
    none = jnp.all(begin.damping == 0) if begin.damping is not None else True

    def flutters(at: Matrices) -> Flag:
        if not damped:
            return _met(at)
        return jnp.where(none, _met(at), _grows(at))

    kinds = flutters, _falls
    asked = 1 if kind == "divergence" else 0
    brackets = [
        _halved(still, bracket, of)
        for bracket, of in zip(
            _scan(still, begin.angles, kinds, asked), kinds, strict=True
        )
    ]
    mine, other = brackets[asked], brackets[1 - asked]
    if kind == "divergence":
        q, frequency, closed = _divergence(loads, still, mine)
    else:
        q, frequency, closed = _flutter_undamped(loads, still, mine)
        if damped:
            one = _flutter_damped(loads, still, mine)
            q, frequency, closed = (
                jnp.where(none, a, b)
                for a, b in zip((q, frequency, closed), one, strict=True)
            )
    before = other.there & (other.high < mine.high)
    code = jnp.where(before, CODE.preceded, CODE.found)
    if damped and kind == "flutter":
        code = jnp.where(none & ~before, CODE.undamped, code)
    code = jnp.where(closed, code, CODE.double_root)
    code = jnp.where(mine.there, code, CODE.no_load)
    unstable = flutters(begin) | _falls(begin)
    code = jnp.where(unstable, CODE.unstable_at_zero, code)
    good = (
        valid
        & there
        & jnp.all(jnp.isfinite(begin.stiffness))
        & (begin.damping is None or jnp.all(jnp.isfinite(begin.damping)))
        & jnp.isfinite(loads.unit())
    )
    code = jnp.where(good, code, CODE.invalid).astype(jnp.int32)
    mark = jnp.where(code >= int(CODE.preceded), 1.0, jnp.nan)
    return q * mark, frequency * mark, code
