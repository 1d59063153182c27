"""Laws of one's own, for own_laws.py."""

import jax.numpy as jnp

import ziegler_jax as zj

RATE = "sqrt(k/(m l^2))"


class Root(zj.AbstractRateFriction):
    rules = {"mu": "nonnegative", "v": "positive"}
    mu: float
    v: float

    def levers(self, u1, u2):
        one, two = (u / jnp.sqrt(u * u + self.v**2) for u in (u1, u2))
        return 0.1 * self.mu * one, 0.1 * self.mu * two

    def load_law(self):
        return zj.FollowerLoad()

    def rate_cut(self):
        return self.v


class Quadratic(zj.AbstractDamping):
    rules = {"c": "nonnegative"}
    c: float

    def matrix(self, cos_d, omega):
        c1, c2 = self.c * abs(omega[0]), self.c * abs(omega[1] - omega[0])
        return (c1 + c2, -c2), (-c2, c2)


class PeakRate(zj.AbstractObserver):
    name = "peak_rate"

    def init(self, column, t, y):
        return 0.0 * y[0]

    def step(self, column, state, step):
        return jnp.maximum(state, abs(step.y1[3] - step.y1[2]))

    def result(self, column, state, span, y):
        return {"peak_rate": zj.Variable(state, "largest rate of joint 2", RATE)}
