"""Which method follows a motion, and what of friction it has to know."""

from ..model.column import check_autonomous
from ..model.system import System
from ..numerics.numbers import Scalar
from ..numerics.rules import instance
from ..solvers import Explicit, Rosenbrock, Taylor
from .options import Method, Solver, complete

REST_RATE = 1e-6  # without friction there is no rate of the column's own


def usual_method(system: System) -> Taylor | Explicit:
    """The method where none is named: Taylor's if there are series, else Tsit5."""
    return Taylor() if system.has_series else Explicit()


def explicit_method(
    question: str, method: Method, usual: Explicit | None = None
) -> Method:
    """The method where derivatives are carried along, or sections watched for.

    **Raises:** `ValueError` for a solver that is not explicit.
    """
    solver = check_explicit(question, method)
    if solver is None:
        solver = Explicit() if usual is None else usual
    return complete(question, method, solver)


def tangent_method(
    question: str, method: Method, system: System, usual: Explicit | None = None
) -> Method:
    """The method where tangents go along.

    **Arguments:** `usual`: what is taken where none is named; None: Taylor's if there
    are series, else Tsit5.

    **Raises:** `ValueError` for one that carries none, or cannot follow the column.
    """
    instance("method", method, Method)
    if isinstance(method.solver, Rosenbrock):
        check_explicit(question, method)
    return method_of(question, method, system, usual or usual_method(system))


def check_explicit(question: str, method: Method) -> Explicit | None:
    """The explicit solver, if one is named.

    **Raises:** `ValueError` for another.
    """
    instance("method", method, Method)
    solver = method.solver
    if solver is not None and not isinstance(solver, Explicit):
        raise ValueError(
            "Argument `solver` must be an explicit method of diffrax, `Explicit(...)` "
            f"or None in `{question}`, but is `{solver.name}`."
        )
    return solver


def method_of(question: str, method: Method, system: System, usual: Solver) -> Method:
    """The method of any motion.

    **Raises:** `ValueError` for one that cannot follow the column.
    """
    instance("method", method, Method)
    check_autonomous(question, system)
    solver = method.solver
    if isinstance(solver, Taylor) and not system.has_series:
        raise ValueError(
            "Argument `solver` may be `Taylor(...)` with `SetValuedCoulomb` friction "
            "alone, and not with the load `JointReaction()`, a damping law or forces "
            f"of one's own, but is {solver.name}."
        )
    if isinstance(solver, Rosenbrock) and system.sticks:
        raise ValueError(
            "Argument `solver` must be `Taylor()` or explicit with `SetValuedCoulomb` "
            "friction, which is not stiff, but is `Rosenbrock()`."
        )
    return complete(question, method, usual if solver is None else solver)


def layer_of(system: System, method: Solver | None) -> Scalar | None:
    """The width of the friction layer that a stiff method's steps resolve."""
    return system.rate_cut if isinstance(method, Rosenbrock) else None


def rate_cut_of(system: System) -> Scalar | None:
    """The rate below which a joint is at rest; None: by modes."""
    return REST_RATE if system.friction is None else system.rate_cut
