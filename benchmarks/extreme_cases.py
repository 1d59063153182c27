"""The cases of `c0_extreme`: scenes at the edge, and what is expected of each."""

import math
from typing import NamedTuple

Q_CRITICAL = (18 - 2 * math.sqrt(7)) / 5
FLUTTER_ENDS = (18 + 2 * math.sqrt(7)) / 5
# uniform rods with tau = 0.03 under q = 2, kicked at 0.3
USUAL = {
    "q": 2.0, "a": 4 / 3, "b": 1 / 2, "d": 1 / 3, "kappa": 1.0, "eta": 1.0, "c": 0.0,
    "mu_s": 0.03, "mu_k": 0.03, "v_stribeck": 0.1, "v_smooth": 0.05,
    "phi1": 0.0, "phi2": 0.0, "omega1": 0.0, "omega2": 0.3, "span": 20.0, "tol": 1e-8,
}  # fmt: skip
ENDED = ("unsettled", "stuck")  # followed to the end of the span
SPENT = "budget_spent"
OVERFLOWS = ("not_finite", "step_vanished")
NOTES = {  # why a case is not as expected, by its name
    "tolerance 1e-2": "one step may err by a tenth of this motion, whose rates are "
    "about 0.1; so soon nothing is left of its phase.",
    **dict.fromkeys(
        ("v_smooth 1e-4", "v_smooth 1e-5"),
        "Calvo7's error estimate gives its last stage no weight. A step of which that "
        "stage alone falls into the layer is accepted, whatever it errs. Whether one "
        "comes up is chance: of neighbouring tolerances a third have one.",
    ),
}


class Case(NamedTuple):
    """A scene, and the outcomes that are right."""

    name: str
    numbers: dict
    outcomes: tuple = ENDED
    explicit: tuple = ()  # further outcomes that are right for explicit methods


def case(name, outcomes=ENDED, explicit=(), **numbers):
    return Case(name, USUAL | numbers, outcomes, explicit)


def smooth():
    for k in range(2, 9):
        may = (SPENT,) if k > 4 else ()
        yield case(f"v_smooth 1e-{k}", v_smooth=10.0**-k, explicit=may)
    yield case("v_stribeck 0.1 v_smooth", v_stribeck=0.005, mu_s=0.06)
    yield case("mu_s = mu_k")
    yield case("mu_s = 100 mu_k", mu_s=0.3, mu_k=0.003)
    for tau in (0.0, 1e-12, 10.0):
        yield case(f"tau {tau:g}", mu_s=tau, mu_k=tau)


def loads():
    bare = {"mu_s": 0.0, "mu_k": 0.0}
    yield case("q = 0", q=0.0)
    yield case("q = 0, no friction", q=0.0, **bare)
    for side in (-1, 1):
        q = Q_CRITICAL * (1 + side * 1e-12)
        yield case(f"q = q_cr (1 {'+' if side > 0 else '-'} 1e-12)", q=q, **bare)
    yield case("q at the end of flutter", q=FLUTTER_ENDS, **bare)
    yield case("q = 10", q=10.0, span=5.0)
    yield case("q = 100", q=100.0, span=2.0)
    yield case("q = 1e4", q=1e4, span=0.2)
    yield case("q = 10, turned over", ("escaped",), q=10.0, span=1e3, escape=math.pi)


def parts():
    for c in (0.0, 1e-12, 1e3):
        yield case(f"c = {c:g}", c=c, explicit=(SPENT,) if c > 1 else ())
    b = math.sqrt(1 - 1e-12)
    yield case(
        "inertia a d - b^2 = 1e-12", a=1.0, b=b, d=1.0, span=1.0, explicit=(SPENT,)
    )
    yield case("inertia a d = b^2", ("invalid",), a=1.0, b=1.0, d=1.0)
    for m2 in (1e-6, 1e6):
        rods = {"a": 1 / 3 + m2, "b": m2 / 2, "d": m2 / 3}
        yield case(f"m2 / m1 = {m2:g}", **rods, span=0.2 if m2 < 1 else 20.0)
    for kappa in (1e-6, 1e6):
        yield case(f"kappa = {kappa:g}", kappa=kappa, span=20.0 if kappa < 1 else 1.0)
    for eta in (-1.0, 0.0, 0.5, 2.0):
        yield case(f"eta = {eta:g}", eta=eta)


def starts():
    still = {"omega2": 0.0}
    yield case("start at rest", ("stuck",), **still)
    edge = {"phi2": 0.03, "phi1": 0.0, "q": 1.0, **still}
    yield case("start on the sticking set's edge", **edge)
    turn = 2 * math.pi
    yield case("both rods at phi + 2 pi", phi1=turn, phi2=turn)
    yield case("rod 2 at phi + 2 pi", phi2=turn)
    yield case("angles of 1e6", phi1=1e6, phi2=-1e6, span=1e-3)
    yield case("rates of 1e4", omega1=1e4, omega2=-1e4, span=0.01)
    yield case("a start that is not finite", ("invalid",), omega2=math.inf)
    yield case("a rate whose square overflows", OVERFLOWS, omega2=1e200)
    nan = {"q": math.nan}
    yield case("a load that is NaN", ("invalid",), **nan)


def tolerances():
    for k in range(2, 15, 2):
        yield case(f"tolerance 1e-{k}", tol=10.0**-k)
    yield case("tolerance 1e-17", tol=1e-17)


CASES = [*smooth(), *loads(), *parts(), *starts(), *tolerances()]
