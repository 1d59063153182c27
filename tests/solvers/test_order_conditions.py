"""The tables are those of methods: order conditions, up to rounding."""

import itertools

import diffrax as dfx
import numpy as np
import pytest

from ziegler_jax.solvers import tableaus


def trees(order):
    """Rooted trees of `order` nodes, each a sorted tuple of its subtrees."""
    if order == 1:
        return [()]
    found = set()
    for parts in partitions(order - 1):
        for subtrees in itertools.product(*(trees(part) for part in parts)):
            found.add(tuple(sorted(subtrees)))
    return sorted(found)


def partitions(n, largest=None):
    largest = n if largest is None else largest
    if n == 0:
        yield ()
    for first in range(min(n, largest), 0, -1):
        for rest in partitions(n - first, first):
            yield (first, *rest)


def size(tree):
    return 1 + sum(map(size, tree))


def density(tree):
    return size(tree) * np.prod([density(t) for t in tree], initial=1.0)


def stages(tree, a):
    """What the stages make of a tree: products of A times its subtrees' values."""
    value = np.ones(len(a))
    for subtree in tree:
        value = value * (a @ stages(subtree, a))
    return value


def residual(b, a, order):
    return max(abs(b @ stages(t, a) - 1 / density(t)) for t in trees(order))


@pytest.mark.parametrize("name, embedded", [("Calvo7", 5), ("Vern9", 8)])
def test_all_order_conditions_hold_and_the_next_order_fails(name, embedded):
    tableau, order, _ = tableaus.ALL[name]
    b = np.asarray(tableau.b_sol)
    a = np.zeros((b.size, b.size))
    for i, row in enumerate(tableau.a_lower, 1):
        a[i, :i] = row
    np.testing.assert_allclose(a.sum(1)[1:], tableau.c, atol=1e-13)
    assert [len(trees(p)) for p in (4, 7, 9)] == [4, 48, 286]
    for p in range(1, order + 1):
        # measured 4e-14 (Vern9's rows have entries of 36)
        assert residual(b, a, p) < 1e-12, p
    assert residual(b, a, order + 1) > 1e-8
    other = b - np.asarray(tableau.b_error)
    for p in range(1, embedded + 1):
        assert residual(other, a, p) < 1e-12, p
    assert residual(other, a, embedded + 1) > 1e-8


@pytest.mark.parametrize(
    "name, tableau, unseen",
    [
        ("Tsit5", dfx.Tsit5.tableau, []),
        ("Dopri8", dfx.Dopri8.tableau, []),
        ("Calvo7", tableaus.CALVO7.tableau, [8]),  # as its docstring warns
        ("Vern9", tableaus.VERN9.tableau, []),
    ],
)
def test_an_error_estimate_sees_each_stage_that_moves_the_state(name, tableau, unseen):
    """Else a step is accepted of which that stage alone met another torque."""
    weights, seen = np.abs(tableau.b_sol), np.abs(tableau.b_error)
    assert np.flatnonzero((weights > 0) & (seen < 1e-12)).tolist() == unseen, name
