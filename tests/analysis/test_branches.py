"""Special points of a branch of cycles: on multipliers that are known; misuse."""

import jax
import jax.numpy as jnp
import numpy as np

import ziegler_jax as zj
from ziegler_jax import SPECIAL
from ziegler_jax.analysis import march


def hidden(rng, total, product, third):
    """A (4, 4) with multipliers 1, a, b, third, where a + b = total, a b = product."""
    block = jnp.zeros((4, 4)).at[0, 0].set(1.0).at[3, 3].set(third)
    block = block.at[1, 2].set(-product).at[2, 1].set(1.0).at[2, 2].set(total)
    basis = np.eye(4) + 0.3 * rng.standard_normal((4, 4))
    return jnp.asarray(basis) @ block @ jnp.asarray(np.linalg.inv(basis))


def test_the_tests_are_the_products_over_the_multipliers(rng):
    for total, product, third in rng.standard_normal((20, 3)):
        a, b = np.roots([1, -total, product])
        c = third
        exact = (a * b - 1) * (a * c - 1) * (b * c - 1)
        exact = exact, (1 + a) * (1 + b) * (1 + c), (1 - a) * (1 - b) * (1 - c)
        found = march.products(hidden(rng, total, product, third))
        # measured 7e-15
        np.testing.assert_allclose(found, np.real(exact), rtol=0, atol=1e-12)


class KnownRoad(march.Road):
    """A straight branch from 0 to 1 whose multipliers are linear in the parameter."""

    def __init__(self, path):
        self.path = path
        self.first = jnp.array([0.0, 1.0, 0.0, 1.0, 0.0])
        self.scale = jnp.ones(5)
        self.step, self.bounds, self.direction = jnp.asarray(1.2), (-1.0, 1.0), 1
        self.failure, self.left = jnp.asarray(0), jnp.asarray(1000)

    def correct(self, x0, row, left):
        """The predicted point: the branch has no bends."""
        at = self.path[:, 0] + self.path[:, 1] * x0[4]
        moved = hidden(np.random.default_rng(1), *at)
        tangent = jnp.zeros(5).at[4].set(1.0)
        tests = jnp.stack([tangent[4], *march.products(moved)])
        none = jnp.zeros(3), moved, jnp.zeros((4, 5))
        point = march.Kept(x0, tangent, *none, tests)
        return point, jnp.asarray(True), jnp.asarray(1), left


def test_special_points_are_found_where_multipliers_pass_the_unit_circle():
    """The first step goes past all of them."""
    # sum, product of a pair, the third: at the start, and by how much they grow
    paths = {
        "a complex pair at 0.3, the third at -1 at 0.75": [(1, 0), (0.7, 1), (0.5, -2)],
        "2 and 1/2 are no torus": [(2.5, 0), (0.7, 0.5), (0.3, 0)],
        "reciprocal at 0.16, one is 1 at 0.5": [
            (2.01, -0.06),
            (0.98 * 1.03, -0.98 * 0.06),
            (0.3, 0),
        ],
        "one is -1 at 0.25, where the other is 0.2": [(-0.7, -0.4), (-0.1, -0.4)]
        + [(0.1, 0)],
    }

    @jax.jit
    @jax.vmap
    def follow(path):
        end = KnownRoad(path).follow(40, 3, (True,) * 4, False)
        return end.kind, end.special.x[:, 4]

    kind, place = follow(np.array(list(paths.values()), float))
    torus, flip, pitchfork = SPECIAL.torus, SPECIAL.flip, SPECIAL.pitchfork
    assert kind.tolist() == [
        [torus, flip, 0],
        [0, 0, 0],
        [pitchfork, 0, 0],
        [flip, 0, 0],
    ]
    known = [0.3, 0.75, 0.5, 0.25]
    found = [place[0, 0], place[0, 1], place[2, 0], place[3, 0]]
    np.testing.assert_allclose(found, known, rtol=0, atol=1e-8)


def test_bad_arguments_are_named(refuses):
    guess = zj.State(omega=(0.0, 0.3))

    def make(q):
        return zj.uniform_rods(q, damping=zj.Viscous(0.1, 0.1))

    def follow(make=make, guess=guess, start=2.0, **options):
        return lambda: zj.continue_cycle(make, guess, start, **options)

    def fold(**options):
        return lambda: zj.cycle_fold(make, guess, 2.0, **options)

    refuses(follow(make=make(2.0)), "`make_column`", "function of one number")
    refuses(follow(make=lambda q: q), "`make_column`", "must return a `Column`")
    refuses(follow(guess=(0, 0.3)), "`guess`", "`State`", "(0, 0.3)")
    refuses(follow(start=np.array([1.0, 2.0])), "`start`", "single number", "(2,)")
    refuses(follow(start=jnp.ones(2)), "`start`", "single number", "(2,)")
    refuses(follow(bounds=(3.0, 1.0)), "`bounds`", "increase", "(3.0, 1.0)")
    refuses(follow(bounds=(2.1, 3.0)), "`bounds`", "hold `start`", "(2.1, 3.0)", "2.0")
    refuses(follow(bounds=1.0), "`bounds`", "two numbers", "1.0")
    refuses(follow(direction=0), "`direction`", "1 or -1", "0")
    refuses(follow(step=-0.1), "`step`", "positive", "-0.1")
    refuses(follow(points=0), "`points`", "at least 1", "0")
    refuses(follow(loops=1.5), "`loops`", "whole number", "1.5")
    refuses(fold(max_points=0), "`max_points`", "at least 1", "0")
    refuses(fold(bounds=(3.0, 1.0)), "`bounds`", "increase")
    refuses(
        lambda: zj.periodic_orbit(make(2.0), guess, period=-1.0),
        "`period`", "positive", "-1",
    )  # fmt: skip
    refuses(lambda: zj.periodic_orbit(make(2.0), (0, 1)), "`guess`", "`State`")
