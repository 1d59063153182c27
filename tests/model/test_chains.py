"""A chain of n rods, and its rule of modes: against dense algebra and an old table."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ziegler_jax.model.chain import (
    accelerated,
    factored,
    holding_torques,
    joint_angles,
    moved,
    on_rods,
    solved,
    turned,
    welded,
)
from ziegler_jax.model.coulomb_torques import CoulombTorques, MassAndForces
from ziegler_jax.model.stick_slip_modes import modes_number, modes_of

SIZES = (2, 3, 4, 5)


def matrices(rng, n, count=20):
    """Positive definite ones, and their rows below the diagonal."""
    root = rng.normal(size=(count, n, n))
    dense = root @ root.transpose(0, 2, 1) + 0.3 * np.eye(n)
    rows = tuple(tuple(dense[:, i, j] for j in range(i + 1)) for i in range(n))
    return dense, rows


def vectors(rng, n, count=20):
    dense = rng.normal(size=(count, n))
    return dense, tuple(dense.T)


def in_joints(n):
    """B with omega = B u: what a joint turns."""
    return np.tril(np.ones((n, n)))


@pytest.mark.parametrize("n", SIZES)
def test_angles_and_torques_of_joints_and_rods(rng, n):
    dense, each = vectors(rng, n)
    inverse = np.linalg.inv(in_joints(n))
    np.testing.assert_allclose(np.stack(joint_angles(each), 1), dense @ inverse.T)
    np.testing.assert_allclose(np.stack(on_rods(each), 1), dense @ inverse)
    for (i, j), (s, c) in turned(tuple(map(jnp.asarray, each))).items():
        # measured 6.7e-16
        np.testing.assert_allclose(s, np.sin(each[i] - each[j]), rtol=0, atol=2e-14)
        np.testing.assert_allclose(c, np.cos(each[i] - each[j]), rtol=0, atol=2e-14)


@pytest.mark.parametrize("n", SIZES)
def test_a_free_chain_moves_as_dense_algebra_says(rng, n):
    """The solution, its derivative in all numbers, and M x."""
    (dense, rows), (b, right) = matrices(rng, n), vectors(rng, n)
    (ddense, drows), (db, dright) = matrices(rng, n), vectors(rng, n)
    x, dx = jax.jvp(jax.vmap(solved), (rows, right), (drows, dright))
    exact = np.linalg.solve(dense, b[..., None])
    slope = np.linalg.solve(dense, db[..., None] - ddense @ exact)
    # measured 3.0e-15 and 6.1e-15 of the largest, M x 1.0e-14
    for found, truth in ((x, exact), (dx, slope)):
        large = np.abs(truth).max()
        np.testing.assert_allclose(
            np.stack(found, 1), truth[..., 0], rtol=0, atol=2e-11 * large
        )
    np.testing.assert_allclose(np.stack(moved(rows, x), 1), b, rtol=0, atol=1e-11)


@pytest.mark.parametrize("n", SIZES)
def test_held_joints_are_a_smaller_matrix_whichever_are_held(rng, n):
    """Accelerations and holding torques of all 2^n sets, in the joints' own rates."""
    (dense, rows), (b, right) = matrices(rng, n), vectors(rng, n)
    turns = in_joints(n)
    inertia, forces = turns.T @ dense @ turns, b @ turns
    for stuck in itertools.product((False, True), repeat=n):
        free = [i for i in range(n) if not stuck[i]]
        u = np.zeros_like(b)
        if free:
            part = inertia[:, free][:, :, free]
            u[:, free] = np.linalg.solve(part, forces[:, free, None])[..., 0]
        torques = forces - np.einsum("lij,lj->li", inertia, u)
        flags = [jnp.asarray(s) for s in stuck]
        for known in (stuck, flags):  # now, and when it is traced
            x = accelerated(factored(rows, known), right, known)
            # measured 6.4e-14
            np.testing.assert_allclose(np.stack(x, 1), u @ turns.T, rtol=0, atol=1e-11)
            each = holding_torques(rows, right, x)
            np.testing.assert_allclose(np.stack(each, 1), torques, rtol=0, atol=1e-11)


def test_rates_of_joints_at_rest_are_exactly_zero(rng):
    _, rates = vectors(rng, 4)
    rest = (True, False, True, True)
    u = joint_angles(welded(rest, rates))
    for still, x, w in zip(rest, u, joint_angles(rates), strict=True):
        assert (np.asarray(x) == 0).all() if still else np.abs(x).min() > 0
        assert np.abs(w).min() > 0


def test_modes_are_read_from_their_number():
    for n in (1, 2, 3, 4):
        for modes in itertools.product((-1.0, 0.0, 1.0), repeat=n):
            number = jnp.asarray(modes_number(modes))
            assert tuple(map(float, modes_of(number, n))) == modes


def rule_by_table(mass, right, kinetic, static, given, rest):
    """Of two joints: the thirteen rows by which version 0.2 chose."""
    (a, h, d), (r1, r2) = mass, right
    whole = a + 2 * h + d

    def holds1(t2):
        return r1 + t2 - h * (r2 - t2) / d

    def holds2(t1):
        return r2 - (h + d) * (r1 + r2 - t1) / whole

    def side(torque):
        return np.where(torque == 0, 1.0, np.sign(torque))

    hold1, hold2 = r1 + r2, r2
    up1, up2 = holds1(kinetic[1]), holds2(kinetic[0])
    down1, down2 = holds1(-kinetic[1]), holds2(-kinetic[0])
    first, second = side(hold1), side(hold2)
    beside1 = np.where(given[1] > 0, up1, down1)
    beside2 = np.where(given[0] > 0, up2, down2)
    alone1 = np.where(np.abs(beside1) <= static[0], 0.0, side(beside1))
    alone2 = np.where(np.abs(beside2) <= static[1], 0.0, side(beside2))
    fits1 = np.abs(np.where(second > 0, up1, down1)) <= static[0]
    fits2 = np.abs(np.where(first > 0, up2, down2)) <= static[1]
    over = np.abs(hold1) - static[0] >= np.abs(hold2) - static[1]
    zero = 0.0 * h
    fits = (np.abs(hold1) <= static[0]) & (np.abs(hold2) <= static[1])
    rows = [(fits, zero, zero)]
    for one, two in (static, kinetic):
        slips1 = (np.abs(hold1) > one) & fits2
        slips2 = (np.abs(hold2) > two) & fits1
        rows += [
            (slips1 & (over | ~slips2), first, zero),
            (slips2, zero, second),
            ((up1 > one) & (up2 > two), zero + 1, zero + 1),
            ((down1 > one) & (-up2 > two), zero + 1, zero - 1),
            ((-up1 > one) & (down2 > two), zero - 1, zero + 1),
            ((-down1 > one) & (-down2 > two), zero - 1, zero - 1),
        ]
    agree, ones, twos = (np.stack(x) for x in zip(*rows, strict=True))
    assert agree[:, rest[0] & rest[1]].any(axis=0).all()
    row, lane = agree.argmax(axis=0), np.arange(h.size)
    m1, m2 = ones[row, lane], twos[row, lane]
    m1 = np.where(rest[0], np.where(rest[1], m1, alone1), given[0])
    m2 = np.where(rest[1], np.where(rest[0], m2, alone2), given[1])
    return m1, m2


def scenes(rng, n, count):
    dense, rows = matrices(rng, n, count)
    right = tuple(2 * rng.normal(size=(n, count)))
    kinetic = rng.uniform(0.05, 1, (n, count))
    falls = np.where(rng.random(count) < 0.5, 1.0, rng.uniform(1, 4, (n, count)))
    given = rng.choice([-1.0, 1.0], (n, count))
    rest = rng.random((n, count)) < 0.7
    return dense, rows, right, kinetic, kinetic * falls, given, rest


@jax.jit
@jax.vmap
def chosen(rows, right, kinetic, static, given, rest):
    law, n = CoulombTorques(static=static, kinetic=kinetic), len(right)
    balance = MassAndForces(rows, right)
    return modes_of(law.chosen(balance, given, rest, [0.0] * n), n)


def test_the_sentence_chooses_as_the_table_of_two_joints(rng):
    _, rows, right, kinetic, static, given, rest = scenes(rng, 2, 40_000)
    parts = tuple(kinetic), tuple(static), tuple(given), tuple(rest)
    ours = np.stack(chosen(rows, right, *parts))
    (a,), (h, d) = rows
    table = np.stack(rule_by_table((a, h, d), right, kinetic, static, given, rest))
    np.testing.assert_array_equal(ours, table)
    assert len(np.unique(ours[:, rest.all(axis=0)], axis=1).T) == 9


def overload(dense, right, static, rest, modes):
    """By how much the joints that are to slip would be overloaded if all were held."""
    n = right.size
    torques = in_joints(n).T @ right
    return sum(abs(torques[i]) - static[i] for i in range(n) if rest[i] and modes[i])


def consistent(dense, right, kinetic, static, given, rest, modes, least):
    """Whether modes agree with the law, by dense algebra."""
    n = right.size
    turns = in_joints(n)
    inertia, forces = turns.T @ dense @ turns, turns.T @ right
    for i in range(n):
        if not rest[i]:
            if modes[i] != given[i]:
                return False
            continue
        beside = [j for j in range(n) if j != i and modes[j] != 0]
        left = forces - np.where(np.arange(n) == i, 0.0, modes) * kinetic
        u = np.zeros(n)
        if beside:
            u[beside] = np.linalg.solve(inertia[np.ix_(beside, beside)], left[beside])
        torque = left[i] - inertia[i] @ u
        fits = (
            abs(torque) <= static[i] if modes[i] == 0 else modes[i] * torque > least[i]
        )
        if not fits:
            return False
    return True


# one program each; 27 modes of three joints
@pytest.mark.parametrize("n, count", [(2, 800), (3, 400)])
def test_fewest_joints_slip_and_the_most_overloaded(rng, n, count):
    """Of all modes that agree, by dense algebra, static level first."""
    dense, rows, right, kinetic, static, given, rest = scenes(rng, n, count)
    parts = tuple(kinetic), tuple(static), tuple(given), tuple(rest)
    ours = np.stack(chosen(rows, right, *parts), 1)
    ties = levels = 0
    for k in range(count):
        one = (
            dense[k], np.stack(right)[:, k], kinetic[:, k], static[:, k], given[:, k],
            rest[:, k],
        )  # fmt: skip
        for level, least in enumerate((one[3], one[2])):  # static, kinetic
            levels += level
            agree = [
                m for m in itertools.product((-1.0, 0.0, 1.0), repeat=n)
                if consistent(*one, np.array(m), least)
            ]  # fmt: skip
            if agree:
                break
        fewest = min(np.count_nonzero(m) for m in agree)
        agree = [m for m in agree if np.count_nonzero(m) == fewest]
        over = [overload(*one[:2], one[3], one[5], m) for m in agree]
        best = [m for m, x in zip(agree, over, strict=True) if x > max(over) - 1e-9]
        assert tuple(ours[k]) in best, (k, ours[k], agree, over)
        ties += len(agree) > 1 and len(best) == 1
    assert ties > 0 and levels > 0, (ties, levels)


def test_of_joints_overloaded_alike_the_first_slips():
    """Both are held by 0.21 of 0.2, and either may slip beside the other at rest."""
    mass, right = ((4 / 3,), (0.5, 1 / 3)), (0.0, 0.21)
    law = CoulombTorques(static=(0.2, 0.2), kinetic=(0.1, 0.1))
    alike = MassAndForces(mass, tuple(map(jnp.asarray, right)))
    still = law.in_modes((0, 0)).holding(alike).torques
    assert still[0] == still[1] == 0.21
    at_rest = [jnp.asarray(True)] * 2
    number = law.chosen(alike, [jnp.asarray(0.0)] * 2, at_rest, [0.0, 0.0])
    assert tuple(map(float, modes_of(number, 2))) == (1.0, 0.0)
    # more overloaded is the second alone
    more = alike._replace(right=(jnp.asarray(-0.005), jnp.asarray(0.21)))
    number = law.chosen(more, [jnp.asarray(0.0)] * 2, at_rest, [0.0, 0.0])
    assert tuple(map(float, modes_of(number, 2))) == (0.0, 1.0)
