"""Keys of values: equal where they hold the same, none where they may hold anything."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

import ziegler_jax as zj
from ziegler_jax.model.damping import AbstractDamping
from ziegler_jax.motion.observers import AbstractObserver
from ziegler_jax.own_values import own_values

START, SPACE = zj.State(omega=(0.0, 0.3)), SimpleNamespace(factor=1.0)


class Own:
    """An object of the user's."""


@dataclasses.dataclass
class Data:
    factor: float = 1.0


OWN, DATA = Own(), Data()


def helper(x):
    return x


class OwnDamping(AbstractDamping):
    def matrix(self, cos_d, omega):
        zero = 0.0 * cos_d
        return (zero, zero), (zero, zero)

    def valid(self):
        return True


class OwnObserver(AbstractObserver):
    name = "own"

    def step(self, column, state, step):
        return state

    def result(self, column, state, span, y):
        return {"own": zj.Variable(state, "nothing")}


@pytest.mark.parametrize(
    "one, other",
    [
        (0.0, -0.0),
        (1.0, 1),
        (1, True),
        ([1.0], (1.0,)),
        ({"a": 1.0}, {"b": 1.0}),
        (np.float64(1.0), np.float32(1.0)),
        (np.ones(2), np.ones((2, 1))),
        (START, zj.State(omega=(0.0, 0.4))),
        (zj.Windows(), zj.Windows(length=30.0)),
        (zj.OUTCOME.cycle, int(zj.OUTCOME.cycle)),
        (zj.Explicit(), zj.Explicit(zj.tableaus.CALVO7[0], 7)),
    ],
)
def test_values_that_differ_anywhere_have_keys_of_their_own(one, other):
    assert own_values(one) == own_values(one) != own_values(other)
    assert None not in (own_values(one), own_values(other))


def test_an_array_that_is_changed_in_place_has_another_key():
    table = np.ones(3)
    before = own_values({"table": table})
    table[1] = 2.0
    assert own_values({"table": table}) != before


@pytest.mark.parametrize(
    "value",
    [
        OWN,
        OwnDamping(),
        OwnObserver(),
        helper,
        zj.settle,
        lambda x: x,
        SPACE,
        DATA,
        object(),
    ],
)
def test_what_may_read_anything_has_no_key(value):
    assert own_values(value) is None
    assert own_values({"inside": [(value,)]}) is None
