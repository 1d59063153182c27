"""A friction law, a damping law and an observer of one's own, in a sweep."""

import jax.numpy as jnp
from laws import PeakRate, Quadratic, Root

import ziegler_jax as zj

POINTS = 8


def point(q, mu):
    friction, damping = Root(mu, 0.02), Quadratic(0.05)
    column = zj.uniform_rods(q, friction=friction, damping=damping)
    start = zj.State(omega=(0, 0.3))
    return zj.settle(column, start, observers=(PeakRate(),), certify=False)


ds = zj.sweep(point, q=jnp.linspace(1.5, 3, POINTS), mu=[0.05, 0.1, 0.2])
ds.zj.map("peak_rate", x="q", y="mu").figure.savefig("own_laws.png")
