"""What a walk over derivatives needs: all of one function by one program.

Each number of a result is derived in each argument, and is right, NaN or refused.
Right is what central differences say, of two steps (Richardson's), within what these
two let expect.
"""

import dataclasses
import functools
from collections.abc import Callable, Mapping

import jax
import jax.numpy as jnp
import numpy as np

import ziegler_jax as zj

NUMBERS = {
    "q": 2.6, "m1": 1.0, "m2": 1.1, "l2": 0.9, "kappa": 1.2, "eta": 0.97,
    "c1": 0.02, "c2": 0.03, "mu_s": 0.1, "mu_k": 0.08, "pin": 0.1, "v": 0.05,
    "v_s": 0.3, "phi1": 0.05, "phi2": -0.02, "w1": 0.1, "w2": 0.3,
}  # fmt: skip


class P(dict):
    """Arguments by name, as attributes."""

    __getattr__ = dict.__getitem__


def smooth(p):
    return zj.SmoothCoulomb(
        p.mu_s, p.mu_k, pin_radius=p.pin, v_smooth=p.v, v_stribeck=p.v_s
    )


def dry(p):
    return zj.SetValuedCoulomb(p.mu_s, p.mu_k, pin_radius=p.pin)


def column(p, law=None, q=None):
    """A column all of whose numbers are arguments."""
    return zj.uniform_rods(
        p.q if q is None else q, m1=p.m1, m2=p.m2, l2=p.l2, kappa=p.kappa,
        follower=p.eta, damping=zj.Viscous(p.c1, p.c2),
        friction=None if law is None else law(p),
    )  # fmt: skip


def start(p):
    return zj.State((p.phi1, p.phi2), (p.w1, p.w2))


def given(*names, **others):
    """Some of the usual numbers, and others."""
    return {name: NUMBERS[name] for name in names} | others


OF_BARE = tuple(NUMBERS)[:8]
OF_SMOOTH = tuple(NUMBERS)[:13]
OF_DRY = tuple(NUMBERS)[:11]
OF_START = tuple(NUMBERS)[13:]


def fields(result):
    """All real and complex numbers of a result, by name; those of parts beside."""
    if isinstance(result, dict):
        parts = result
    elif dataclasses.is_dataclass(result):
        names = [f.name for f in dataclasses.fields(result)]
        parts = {n: getattr(result, n) for n in names}
    else:
        return {"": result}
    named = {}
    for name, part in parts.items():
        if part is None or isinstance(part, str):
            continue
        for inner, x in fields(part).items() if not _plain(part) else [("", part)]:
            if isinstance(x, tuple):
                x = jnp.stack(x) if x and _plain(x[0]) else None
            if _plain(x) and jnp.issubdtype(x.dtype, jnp.inexact):
                named[".".join(filter(None, (name, inner)))] = x
    return named


def _plain(x):
    return isinstance(x, jax.Array | np.ndarray)


@dataclasses.dataclass(frozen=True)
class Case:
    """A function of arguments, where to derive it, and what has no derivative.

    **Arguments:** `none`: the reasons, by (field, argument); a star is any. `rtol`: of
    a field's largest derivative in the argument; `least`: a change of a number that its
    own error makes; `step`: relative, of the differences; `batch`: the values for these
    have a program of their own, for derivatives that take long to run, not to compile.
    """

    function: Callable[[P], object]
    at: Mapping[str, float]
    none: Mapping[tuple[str, str], str] = dataclasses.field(default_factory=dict)
    rtol: float = 1e-5
    least: float = 1e-8
    step: float = 1e-4
    reverse: bool = False
    batch: bool = False

    def reason(self, field, argument):
        """Why there is none; None where there is one."""
        for name in (field, "*"):
            for other in (argument, "*"):
                if (name, other) in self.none:
                    return self.none[name, other]
        return None


@functools.cache
def program(function, names, reverse):
    """The fields' sizes, and values with derivatives, of the arguments' vector.

    One program: values, forward and, where promised, reverse.
    """
    shown = {}

    def row(x):
        by_name = fields(function(P(zip(names, x, strict=True))))
        parts = []
        for name, v in by_name.items():
            v = jnp.ravel(v)
            part = jnp.concatenate([v.real, v.imag]) if jnp.iscomplexobj(v) else v
            shown[name] = part.size
            parts.append(part)
        return jnp.concatenate(parts)

    @jax.jit
    def both(x):
        if reverse:  # one linear map, forward and transposed
            value, along = jax.linearize(row, x)
            back = jax.linear_transpose(along, x)
            backward = jax.vmap(lambda e: back(e)[0])(jnp.eye(value.size)).T
            return value, jax.vmap(along)(jnp.eye(x.size)), backward
        along = jax.vmap(lambda e: jax.jvp(row, (x,), (e,)), out_axes=(None, 0))
        value, forward = along(jnp.eye(x.size))
        return value, forward, forward

    return shown, both, jax.jit(jax.vmap(row))


def differences(values, x, step):
    """Central ones by Richardson, how far the two that make it are apart, the steps."""
    h = step * np.maximum(np.abs(x), 0.1)
    ways = [s * size * np.diag(h) for size in (1, 2) for s in (1, -1)]
    ends = values(np.concatenate([x + way for way in ways]))
    above, below, far_above, far_below = np.split(ends, 4)
    near, far = (
        (above - below) / (2 * h[:, None]),
        (far_above - far_below) / (4 * h[:, None]),
    )
    return (4 * near - far) / 3, np.abs(near - far), h


def verdicts(case):
    """What is wrong, the worst error of the rest, and how many are what."""
    names = tuple(case.at)
    shown, both, batch = program(case.function, names, case.reverse)
    x = np.array(list(case.at.values()), float)
    value, forward, backward = map(np.asarray, both(x))
    largest = np.nanmax(np.abs(forward))
    there = ~np.isnan(forward)  # both modes have their own program
    np.testing.assert_allclose(
        backward[there], forward[there], case.rtol, case.rtol * largest
    )
    values = batch if case.batch else lambda rows: [both(row)[0] for row in rows]
    exact_, doubts, steps = differences(lambda r: np.array(values(r)), x, case.step)
    wrong, worst, tally = [], 0.0, {"right": 0, "NaN": 0}
    for i, name in enumerate(names):
        exact, doubt, h, begin = exact_[i], doubts[i], steps[i], 0
        for field, size in shown.items():
            part = slice(begin, begin := begin + size)
            got, want = forward[i, part], exact[part]
            reason = case.reason(field, name)
            if np.isnan(value[part]).all():
                lost = np.isnan(got) | (got == 0)
                reason = "not a number itself"
            else:
                lost = np.isnan(got)
            if reason is not None and (got == 0).all() and (want == 0).all():
                reason = None  # it does not depend on that
            if lost.any() or reason is not None:
                tally["NaN"] += 1
                if reason is None or not lost.all():
                    wrong.append((field, name, reason or "NaN", got, want))
                continue
            size_ = np.max(np.abs(want)) + case.least / h / case.rtol
            off = (np.abs(got - want) - doubt[part]).max() / size_
            worst = max(worst, off)
            tally["right"] += 1
            if not off <= case.rtol:
                wrong.append((field, name, f"off by {off:.1e}", got, want))
    return wrong, worst, tally
