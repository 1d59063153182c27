"""A sweep refuses by name, value and rule, in a scene as outside."""

import functools
import time

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr

import ziegler_jax as zj
from ziegler_jax.results import AbstractResult
from ziegler_jax.sweep import assembly

WINDOWS = zj.Windows(transient=5.0, length=5.0, max_windows=2)
SHORT = {"windows": WINDOWS, "method": zj.Method(rtol=1e-4)}


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
        (lambda: quiet(x=1.0), ("at least one axis", "`x`", "number 1", "`x=[1]`")),
        (lambda: quiet(x=np.nan), ("`x`", "finite", "is nan.")),
        (
            lambda: zj.sweep(of_two, q=xr.DataArray([1.0, 2.0], dims="mu"), mu=3.0),
            ("`q`", "along `mu`", "number", "rename"),
        ),
        (lambda: quiet(x=["a"]), ("`x`", "'a'", "numbers")),
        (lambda: quiet(x=[1.0, 2.0, 1.0]), ("`x`", "once", "1 2 times", "unique")),
        (
            lambda: quiet(x=[1.0], batchsize=3),
            ("`batchsize`", "`point`", "takes x"),
        ),
        (lambda: quiet(x=[1.0], lane=3), ("`lane`", "`point`", "mean `lanes`")),
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
            ("Axis 1", "letters"),
        ),
        (lambda: zj.sweep(lambda x: {}, x=[1.0]), ("`point`", "empty")),
        (
            lambda: quiet(x=[1.0], where=lambda x: 1 / 0),
            ("`where`", "ZeroDivisionError"),
        ),
        (lambda: zj.sweep(lambda value: value, value=[1.0]), ("`value`", "unlike")),
        (
            lambda: quiet(x=[1.0], lanes=zj.Lanes(threads=0)),
            ("`threads`", "0", "at least 1"),
        ),
        (
            lambda: quiet(x=[1.0], lanes=zj.Lanes(threads=1.5)),
            ("`threads`", "1.5", "whole"),
        ),
        (
            lambda: quiet(x=[1.0], lanes=zj.Lanes(batch_size=0)),
            ("`batch_size`", "0", "at least 1"),
        ),
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
        return zj.settle(
            zj.uniform_rods(q, friction=friction), zj.State(), **SHORT, certify=False
        )

    refuses(lambda: zj.sweep(scene, q=[1.0]), "`mu_k`", "0.2", "at most `mu_s`")

    def coarse(q):
        return zj.settle(
            zj.uniform_rods(q), zj.State(), method=zj.Method(rtol=0.0), certify=False
        )

    refuses(lambda: zj.sweep(coarse, q=[1.0]), "`rtol`", "0", "positive")


# Names --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "name",
    ["a/b", "", "zarr.json", "x.partial", "a\0", "a" * 300, "2x", "sweep-record"],
)
@pytest.mark.parametrize("stored", [False, True], ids=["memory", "store"])
def test_there_is_one_rule_for_names(name, stored, path, refuses):
    options = {"store": path} if stored else {}
    rule = "letters, digits and underscores"
    axes = {name: [1.0, 2.0], "y": [1.0]}
    refuses(
        lambda: zj.sweep(lambda **k: sum(k.values()), axes=axes, **options),
        "Axis", repr(name), rule,
    )  # fmt: skip
    refuses(
        lambda: zj.sweep(lambda y: {name: y}, y=[1.0], **options),
        "Result", repr(name), rule,
    )  # fmt: skip
    assert not path.exists()


def test_names_of_any_script_and_of_options_are_stored(path):
    axes = {"φ": [0.5, 1.0], "progress": [1.0, 2.0], "c": [3.0]}
    found = zj.sweep(lambda **k: {"blocks": sum(k.values())}, axes=axes, store=path)
    assert found["φ"].values.tolist() == [0.5, 1.0]
    assert zj.open_sweep(path)["blocks"].values[1, 1, 0] == 6.0


def test_axes_that_share_a_dimension_must_be_as_long_as_each_other(refuses):
    x = xr.DataArray([1.0, 2.0], dims="sample")
    refuses(
        lambda: zj.sweep(of_two, q=x, mu=x[:1] + 1), "`mu`", "`sample`", "`q`", "1", "2"
    )
    twice = xr.DataArray([3.0, 3.0], dims="sample")
    # values that follow an axis may repeat, the axis itself may not
    refuses(
        lambda: zj.sweep(of_two, q=[1.0, 1.0], mu=twice.rename(sample="q")),
        "`q`", "once",
    )  # fmt: skip
    refuses(
        lambda: zj.sweep(
            of_two, q=twice.rename(sample="a b"), mu=x.rename(sample="a b")
        ),
        "'a b'",
    )


def test_axes_that_share_a_dimension_must_have_the_same_places_there(refuses):
    q = xr.DataArray([1.0, 2.0], {"n": [0, 1]}, ("n",))
    mu = xr.DataArray([1.0, 2.0], {"n": [1, 0]}, ("n",))
    refuses(lambda: zj.sweep(of_two, q=q, mu=mu), "`mu`", "`n`", "xr.align")
    along_mu = q.drop_vars("n").rename(n="mu")
    refuses(lambda: zj.sweep(of_two, q=along_mu, mu=q), "`q`", "`mu`", "rename")


@pytest.mark.parametrize("own", [False, True], ids=["dict", "result"])
def test_dimensions_of_results_have_one_size_that_is_not_zero(own, refuses):
    def swept(**numbers):
        named = {
            name: zj.Variable(jnp.ones(shape), name, dims=dims)
            for name, (shape, dims) in numbers.items()
        }
        return zj.sweep(lambda x: Several(named) if own else named, x=[1.0, 2.0])

    parts = "`point`", "`w`", "2", "`v`", "3", "dimension `k`"
    refuses(lambda: swept(v=(3, ("k",)), w=(2, ("k",))), *parts)
    refuses(lambda: swept(v=(0, ("k",))), "`point`", "`v`", "none along `k`")
    joints = {"v": (3, ("joint",)), "w": (2, ("joint",))}
    refuses(lambda: swept(**joints), "`w`", "2", "`joint`", "coordinate", "3")
    refuses(lambda: swept(v=((2, 3), ("k",))), "`point`", "`v`", "(2, 3)", "('k',)")
    assert swept(v=(3, ("k",)), w=(3, ("k",))).w.shape == (2, 3)


class Several(AbstractResult):
    """A result of one's own."""

    named: dict
    settings: tuple = ()

    def variables(self):
        return self.named


# Room ---------------------------------------------------------------------------------


def test_what_would_not_fit_into_memory_is_refused_at_once(refuses, monkeypatch):
    many = np.arange(1e6)
    start = time.perf_counter()
    parts = "`store`", "GB", "free memory", 'store="map.zarr"'
    refuses(lambda: zj.sweep(of_two, q=many, mu=many[:100_000] + 1), *parts)
    refuses(
        lambda: zj.sweep(of_two, where=lambda q, mu: q > mu, q=many, mu=many),
        "`where`", *parts,
    )  # fmt: skip
    assert time.perf_counter() - start < 5  # before anything is compiled
    monkeypatch.setattr(assembly, "free_memory", lambda: 1000)
    refuses(lambda: quiet(x=np.arange(100.0)), "`store`", "800 bytes", "1000 bytes")
    monkeypatch.setattr(assembly, "free_memory", lambda: None)  # not known: go on
    assert quiet(x=np.arange(100.0)).value[99] == 99.0**2


def test_results_count_with_all_their_numbers(refuses, monkeypatch):
    def scene(x):
        return {name: x for name in "abcd"}

    monkeypatch.setattr(assembly, "free_memory", lambda: 5000)
    refuses(lambda: zj.sweep(scene, x=np.arange(100.0)), "results", "3200 bytes")

    def narrow(x):  # held as numbers that can be NaN
        return {name: x > 1 for name in "abcd"}

    refuses(lambda: zj.sweep(narrow, x=np.arange(100.0)), "results", "3200 bytes")


# Where JAX cannot trace ---------------------------------------------------------------


def branches(q):
    return q if q > 1.5 else -q


def gives_numpy(q):
    return np.sin(q)


def makes_float(q):
    return 2 * float(q)


def takes_from_list(q):
    return [1.0, 2.0][q.astype(int)]


@pytest.mark.parametrize(
    "scene, line, cure",
    [
        (branches, "return q if q > 1.5 else -q", "jnp.where"),
        (gives_numpy, "return np.sin(q)", "jnp.sin"),
        (makes_float, "return 2 * float(q)", "leave `float(...)` out"),
        (takes_from_list, "return [1.0, 2.0][q.astype(int)]", "jnp.asarray(table)[i]"),
    ],
)
def test_what_jax_cannot_trace_is_refused_with_its_line_and_a_cure(
    refuses, scene, line, cure
):
    refuses(lambda: zj.sweep(scene, q=[1.0]), "`point`", "of q", line, cure)


def test_a_sweep_inside_a_transformation_or_a_sweep_is_refused(refuses):
    def inner(x):
        def power(y):
            return x**y

        return zj.sweep(power, y=[1.0], progress=False).value.values[0]

    parts = "outside of JAX's transformations", "another sweep"
    refuses(lambda: zj.sweep(inner, x=[1.0]), *parts)
    refuses(lambda: jax.jit(inner)(1.0), *parts)
    refuses(lambda: jax.vmap(inner)(jnp.ones(2)), *parts)
    refuses(lambda: jax.jvp(inner, (1.0,), (1.0,)), *parts)


def test_a_points_own_type_error_is_its_own():
    def scene(x):
        raise TypeError("unhashable type: 'my own'")

    with pytest.raises(TypeError, match="my own"):
        zj.sweep(scene, x=[1.0])
