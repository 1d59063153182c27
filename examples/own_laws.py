"""A friction law, a damping law and an observer of your own, in a sweep."""

import jax.numpy as jnp

import ziegler_jax as zj


class Root(zj.AbstractRateFriction):  # mu u / sqrt(u^2 + v^2), pins of radius 0.1
    mu: float

    def levers(self, u1, u2):
        return tuple(0.1 * self.mu * u / jnp.sqrt(u * u + 0.02**2) for u in (u1, u2))

    def rate_cut(self):
        return 0.02


class Quadratic(zj.AbstractDamping):  # c |u| u in joint 2
    c: float

    def matrix(self, cos_d, omega):
        c2 = self.c * abs(omega[1] - omega[0])
        return (c2, -c2), (-c2, c2)


class PeakRate(zj.AbstractObserver):
    name = "peak_rate"

    def step(self, system, state, step):
        return jnp.maximum(state, abs(step.y1[3] - step.y1[2]))

    def result(self, system, state, span, y):
        return {"peak_rate": zj.Variable(state, "rate of joint 2", "sqrt(k/(m l^2))")}


def point(q, mu):
    column = zj.uniform_rods(q, friction=Root(mu), damping=Quadratic(0.05))
    return zj.settle(column, zj.State(omega=(0, 0.3)), observers=(PeakRate(),))


ds = zj.sweep(point, q=jnp.linspace(1.5, 3, 8), mu=[0.05, 0.1, 0.2])
ds.pipe(zj.plot.map, "peak_rate", x="q", y="mu").figure.savefig("own_laws.png")
