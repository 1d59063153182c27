"""A sweep notices that something its point refers to has changed."""

import functools
import json

import numpy as np
import pytest

import ziegler_jax as zj


def once(scene):
    return float(zj.sweep(scene, x=[2.0], progress=False).value.item())


FACTOR = 1.0
OPTIONS = {"inner": [1.0]}


def scaled(x):
    return FACTOR * x


def by_options(x):
    return OPTIONS["inner"][0] * x


def by_helper(x):
    return scaled(x)


class Scale:
    """A callable object; not hashable if it were compared by value."""

    __hash__ = None  # type: ignore[assignment]

    def __init__(self):
        self.factor = 1.0

    def __call__(self, x):
        return self.factor * x


def change_options(monkeypatch):
    monkeypatch.setitem(OPTIONS, "inner", [5.0])


def change_factor(monkeypatch):
    monkeypatch.setitem(globals(), "FACTOR", 5.0)


@pytest.mark.parametrize(
    "scene, change",
    [
        (scaled, change_factor),
        (by_helper, change_factor),
        (by_options, change_options),
        (functools.partial(lambda a, x: a * scaled(x), 1.0), change_factor),
    ],
    ids=["a number", "a helper's number", "a dict's list", "a partial's"],
)
def test_what_has_changed_in_place_is_another_scene(scene, change, monkeypatch):
    assert once(scene) == 2.0
    change(monkeypatch)
    assert once(scene) == 10.0


def test_an_array_that_changed_in_place_is_another_scene():
    table = np.ones(3)

    def scene(x):
        return table.sum() * x / 3

    assert once(scene) == 2.0
    table *= 5.0
    assert once(scene) == 10.0


def test_an_objects_attribute_that_changed_is_another_scene():
    scale = Scale()
    assert once(scale) == 2.0
    scale.factor = 5.0
    assert once(scale) == 10.0


TRACED = iter(range(100))  # counts, and looks the same to the sweep


def test_what_has_not_changed_is_not_traced_again():
    def scene(x):
        return next(TRACED) * OPTIONS["inner"][0] * x

    assert once(scene) == once(scene)


def test_constants_of_a_scene_are_recorded():
    def scene(x):
        return FACTOR * OPTIONS["inner"][0] * x

    found = zj.sweep(scene, x=[2.0], progress=False)
    assert json.loads(found.attrs["scene_constants"]) == {
        "FACTOR": FACTOR,
        "OPTIONS": OPTIONS,
    }
