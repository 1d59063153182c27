"""Scenes of several small blocks, for the tests of sweeps that are stored."""

import enum
import functools

import jax.numpy as jnp
import numpy as np

import ziegler_jax as zj

# A cheap scene of four blocks, and a small one with lanes in chunks.

FACTOR, TABLE = 3.0, np.linspace(0.0, 1.0, 5)


def helper(x):
    return x + 1.0


def point(x, y):
    table = jnp.asarray(TABLE, x.dtype)
    bent = jnp.interp(x, jnp.arange(5.0, dtype=x.dtype), table)
    regime = jnp.where(
        x > y, jnp.int8(zj.CODE.stable), jnp.int8(zj.CODE.marginal)
    )  # a variable of codes
    return {
        "sum": FACTOR * x + helper(y), "bent": bent, "flag": x > y, "regime": regime
    }  # fmt: skip


X, Y = np.linspace(0.0, 4.0, 8), np.linspace(0.0, 1.0, 5)
sweep = functools.partial(
    zj.sweep, point, x=X, y=Y, lanes=zj.Lanes(batch_size=4), progress=False
)


def settled(q, mu):
    friction = zj.SmoothCoulomb(mu, pin_radius=0.05, v_smooth=0.05)
    return zj.settle(
        zj.uniform_rods(q, friction=friction),
        zj.State(omega=(0.0, 0.3)),
        windows=zj.Windows(transient=20.0, length=10.0, max_windows=4),
        method=zj.Method(rtol=1e-4, atol=1e-4, max_steps=2000),
        certify=False,
    )


def certified(q, mu):
    friction = zj.SmoothCoulomb(mu, pin_radius=0.05, v_smooth=0.05)
    column = zj.uniform_rods(q, friction=friction)
    return zj.settle(column, zj.State(omega=(0.0, 0.3)))


Q, MU = np.linspace(1.5, 3.5, 9), np.array([0.05, 0.1, 0.2])


def same(one, other):
    """To the last bit, NaN like NaN, with the same labels."""
    timing = {"run_seconds", "points_per_second", "useful_step_fraction"}
    timing |= {"compile_seconds", "threads", "points", "points_done"}
    timing |= {"blocks", "blocks_done", "canary_checks", "canary_mismatches"}
    attrs = [
        {k: v for k, v in d.attrs.items() if k not in timing} for d in (one, other)
    ]
    assert attrs[0] == attrs[1]
    assert list(one.data_vars) == list(other.data_vars)
    for name in one.variables:
        assert one[name].attrs == other[name].attrs, name
        assert one[name].dtype == other[name].dtype, name
        assert one[name].values.tobytes() == other[name].values.tobytes(), name
    return True


class Opposite(enum.IntEnum):
    """The names of two codes, exchanged."""

    flutter = int(zj.CODE.stable)
    stable = int(zj.CODE.flutter)

    @property
    def sentence(self):
        return self.name
