"""A sweep refuses by name, value and rule, in a scene as outside."""

import functools

import jax.numpy as jnp
import numpy as np
import pytest

import ziegler_jax as zj

SHORT = {"transient": 5.0, "window": 5.0, "max_windows": 2, "rtol": 1e-4, "atol": 1e-4}


def square(x):
    return x * x


def of_two(q, mu):
    return q * mu


def pair_of(x):
    return jnp.stack([x, x])


quiet = functools.partial(zj.sweep, square, progress=False)


@pytest.mark.parametrize(
    "call, parts",
    [
        (lambda: quiet(x=[0.0, np.nan]), ("`x`", "nan", "finite", "index 1")),
        (lambda: quiet(x=[np.inf]), ("`x`", "inf", "finite", "index 0")),
        (lambda: quiet(x=[]), ("`x`", "empty")),
        (lambda: quiet(x=np.ones((2, 2))), ("`x`", "(2, 2)", "one dimension")),
        (lambda: quiet(x=1.0), ("`x`", "()", "one dimension")),
        (lambda: quiet(x=["a"]), ("`x`", "'a'", "numbers")),
        (lambda: quiet(), ("at least one axis",)),
        (lambda: quiet(y=[1.0]), ("`y`", "`point`", "takes x")),
        (lambda: quiet(x=[1.0], y=[1.0]), ("`y`", "`point`", "takes x")),
        (lambda: quiet(x=[1.0], axes={"x": [1.0]}), ("`x`", "twice")),
        (lambda: zj.sweep(of_two, q=[1.0]), ("`mu`", "`point`", "axes are q")),
        (lambda: zj.sweep(3.0, x=[1.0]), ("`point`", "3.0", "function")),
        (lambda: zj.sweep(pair_of, x=[1.0]), ("`point`", "`value`", "(2,)")),
        (
            lambda: zj.sweep(lambda x: {"a": x, "b": pair_of(x)}, x=[1.0]),
            ("`point`", "`b`", "(2,)", "dimensions"),
        ),
        (lambda: zj.sweep(lambda x: "no", x=[1.0]), ("`point`", "`value`", "str")),
        (lambda: zj.sweep(lambda x: None, x=[1.0]), ("`point`", "`value`", "None")),
        (lambda: zj.sweep(lambda x: (x, x), x=[1.0]), ("`point`", "`value`", "tuple")),
        (
            lambda: zj.sweep(lambda value: value, value=[1.0]),
            ("`value`", "unlike a result"),
        ),
        (lambda: quiet(x=np.array([1 + 1j])), ("`x`", "real numbers")),
        (lambda: quiet(x=["1.5"]), ("`x`", "real numbers")),
        (
            lambda: quiet(x=np.ma.array([1.0, 2.0], mask=[0, 1])),
            ("`x`", "real numbers"),
        ),
        (lambda: zj.sweep(square, axes=3), ("`axes`", "map names", "3")),
        (
            lambda: zj.sweep(lambda **n: 1.0, axes={1: [1.0]}),
            ("`axes`", "strings", "1"),
        ),
        (lambda: zj.sweep(lambda x: {}, x=[1.0]), ("`point`", "empty")),
        (
            lambda: quiet(x=[1.0], where=lambda x: 1 / 0),
            ("`where`", "ZeroDivisionError"),
        ),
        (lambda: zj.sweep(lambda value: value, value=[1.0]), ("`value`", "unlike")),
        (lambda: quiet(x=[1.0], threads=0), ("`threads`", "0", "at least 1")),
        (lambda: quiet(x=[1.0], threads=1.5), ("`threads`", "1.5", "whole")),
        (lambda: quiet(x=[1.0], batch_size=0), ("`batch_size`", "0", "at least 1")),
        (lambda: quiet(x=[1.0], precision="float16"), ("`precision`", "float16")),
        (lambda: quiet(x=[1.0], where=3), ("`where`", "3", "function")),
        (lambda: quiet(x=[1.0], where=lambda y: y > 0), ("`x`", "`where`", "takes y")),
        (lambda: quiet(x=[1.0], where=lambda x: x), ("`where`", "float64", "booleans")),
        (lambda: quiet(x=[1.0], where=lambda x: x > 2), ("`where`", "leaves none")),
        (
            lambda: quiet(x=[1.0, 2.0], where=lambda x: 0 < x < 3),
            ("`where`", "broadcast", "ambiguous"),
        ),
        (
            lambda: quiet(x=[1.0, 2.0], where=lambda x: np.ones(3, bool)),
            ("`where`", "broadcast"),
        ),
    ],
)
def test_a_wrong_argument_is_refused_by_name_value_and_rule(refuses, call, parts):
    refuses(call, *parts)


def test_a_values_rule_breaks_inside_a_scene_as_outside(refuses):
    def scene(q):
        friction = zj.SmoothCoulomb(
            0.1, 0.2, pin_radius=0.1, v_stribeck=0.1, v_smooth=0.01
        )
        return zj.settle(zj.uniform_rods(q, friction=friction), zj.State(), **SHORT)

    refuses(lambda: zj.sweep(scene, q=[1.0]), "`mu_k`", "0.2", "at most `mu_s`")

    def coarse(q):
        return zj.settle(zj.uniform_rods(q), zj.State(), **SHORT | {"rtol": 0.0})

    refuses(lambda: zj.sweep(coarse, q=[1.0]), "`rtol`", "0", "positive")
