"""Which sweep a store belongs to: another is refused by name."""

import gc
import json
import os
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import stored
import xarray as xr
from stored import Opposite, X, Y, point, same, settled, sweep

import ziegler_jax as zj
from ziegler_jax.results import REGIMES
from ziegler_jax.sweep import grid, program, provenance

pytestmark = pytest.mark.usefixtures("small_blocks")


def rubbed(x):
    """A question that holds nothing of the user's own: JAX keeps its trace."""
    law = zj.SmoothCoulomb(0.3 * x, pin_radius=0.05, v_smooth=0.011)
    windows = zj.Windows(transient=0.0, length=5.0, max_windows=1)
    start = zj.State(omega=(0.0, 0.3))
    column = zj.uniform_rods(1.0, friction=law)
    return zj.settle(column, start, windows=windows, certify=False)


def test_another_sweep_is_refused_by_name_and_replaced_on_demand(
    path, refuses, monkeypatch
):
    sweep(store=path)
    others = [
        ({"x": X[:-1]}, ("axis `x`", "8 values", "7")),
        ({"y": Y * (1 + 1e-15)}, ("axis `y`",)),
        ({"x": np.where(X == X[3], X[3] + 1e-12, X)}, ("axis `x`", "between")),
        ({"axes": {"y": Y, "x": X}, "x": None, "y": None}, ("axes x, y", "y, x")),
        ({"where": lambda x, y: x + y > 1}, ("other points",)),
        ({"lanes": zj.Lanes(5)}, ("batch_size 4", "5")),
    ]
    for change, parts in others:
        options = {"x": X, "y": Y, "lanes": zj.Lanes(4), "progress": False, **change}
        options = {k: v for k, v in options.items() if v is not None}
        refuses(
            lambda options=options: zj.sweep(point, store=path, **options),
            "`store`", str(path), *parts, "overwrite",
        )  # fmt: skip
    with monkeypatch.context() as patch:
        known = provenance.metadata.version
        patch.setattr(
            provenance.metadata, "version",
            lambda name: "9.9" if name == "ziegler_jax" else known(name),
        )  # fmt: skip
        refuses(lambda: sweep(store=path), "numbers by ziegler_jax", "9.9")
    assert sweep(store=zj.Store(path, overwrite=True), x=X[:-1]).x.size == 7
    assert zj.open_sweep(path).attrs["points_done"] == 35


def labelled(units="m", of_axis="s", codes=REGIMES, name="length"):
    """A sweep whose numbers are the same whatever these are."""

    def made(x):
        code = jnp.where(x > 0.5, jnp.int8(zj.CODE.stable), jnp.int8(zj.CODE.flutter))
        return {
            "z": zj.Variable(2.0 * x, name, units),
            "code": zj.Variable(code, "code", codes=codes),
        }

    x = xr.DataArray([0.0, 1.0], dims="x", attrs={"units": of_axis})
    return lambda path: zj.sweep(made, x=x, store=path, progress=False)


@pytest.mark.parametrize(
    "change, words",
    [
        ({"units": "mm"}, ("`z`", "units", "'m'", "'mm'")),
        ({"of_axis": "ms"}, ("`x`", "units", "'s'", "'ms'")),
        ({"codes": tuple(Opposite)}, ("`code`", "flag_values", "[0, 40, 42]")),
    ],
)
def test_a_store_in_other_units_or_codes_is_another_sweeps(
    path, refuses, change, words
):
    """No digest has them: they are in no equation."""
    first = labelled()(path)
    refuses(lambda: labelled(**change)(path), "`store`", str(path), *words, "overwrite")
    again = labelled(name="the same, in other words")(path)
    assert same(first, again) and first.z.attrs["units"] == "m"


def test_numbers_in_a_unit_that_looks_like_a_date_stay_numbers(path):
    stored = labelled(units="days since 2000-01-01", of_axis="days since 1900-01-01")
    for ds in (stored(path), stored(path), zj.open_sweep(path)):
        assert ds.z.dtype == ds.x.dtype == np.float64
        assert ds.z.values.tolist() == [0.0, 2.0]
        assert ds.z.attrs["units"] == "days since 2000-01-01"
        assert ds.x.attrs["units"] == "days since 1900-01-01"


@pytest.mark.parametrize("change", ["constant", "table", "helper"])
def test_a_scene_is_known_by_its_program(path, refuses, monkeypatch, change):
    """What the source does not show: each of them changes a number somewhere."""
    sweep(store=path)
    if change == "constant":
        monkeypatch.setattr(stored, "FACTOR", 3.0000000001)
    elif change == "table":  # in place: neither its name nor its identity changes
        monkeypatch.setattr(stored, "TABLE", stored.TABLE.copy())
        sweep(store=path)
        stored.TABLE[3] += 1e-12
    else:
        monkeypatch.setattr(stored, "helper", lambda x: x + 1.0000001)
    refuses(lambda: sweep(store=path), "`store`", "another scene")


def test_a_scene_is_the_same_whatever_jax_has_forgotten_of_it():
    """Else no store went on, and no worker agreed, after many other sweeps.

    What JAX has forgotten it traces anew, and what it has not it keeps: two parts that
    are alike are then one object or two.
    """

    def digest():
        return program.traced(rubbed, ("x",), None).digest

    first, traced = digest(), 0
    gc.unfreeze()  # else it shows none of them
    caches = [x for x in gc.get_objects() if type(x).__name__ == "WeakrefLRUCache"]
    gc.freeze()  # as `conftest` does
    for cache in caches:
        if cache.cache_info().currsize:
            cache.cache_clear()
            assert digest() == first
            traced += 1
    jax.clear_caches()
    assert digest() == first
    assert traced > 5  # measured 15


def test_a_table_that_changed_in_place_is_computed_with(path, monkeypatch):
    monkeypatch.setattr(stored, "TABLE", stored.TABLE.copy())
    before = sweep(store=path)["bent"].values
    stored.TABLE[:] *= 2
    after = sweep(store=zj.Store(path, overwrite=True))["bent"].values
    np.testing.assert_allclose(after, 2 * before, rtol=1e-12, atol=0)


SCENES = {point: ("x", "y"), settled: ("q", "mu"), stored.certified: ("q", "mu")}


def digests():
    return [
        program.traced(scene, names, None).digest for scene, names in SCENES.items()
    ]


ELSEWHERE = """
import sys, threading
sys.path[:0] = {path!r}
import stored
import test_store_identity as here
thread = threading.Thread(target=lambda: print(*here.digests()))
thread.start()
thread.join()
"""
LESS = "AVX512F AVX512CD AVX512_SKX AVX512_CLX AVX512_CNL AVX512_ICL AVX512_SPR"


def test_a_scenes_digest_is_the_same_in_other_processes_threads_and_processors():
    """BLAS and NumPy without AVX-512, AVX2 and FMA gave some numbers other bits."""
    less = {"NPY_DISABLE_CPU_FEATURES": f"{LESS} AVX2 FMA3 X86_V3 X86_V4"}
    less |= {"OPENBLAS_CORETYPE": "Prescott"}
    less |= {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-AVX512F,-AVX"}
    environment = {**os.environ, **less, "PYTHONHASHSEED": "5", "XLA_FLAGS": ""}
    folder = Path(__file__).parent
    text = ELSEWHERE.format(path=[str(folder), str(folder.parent)])
    done = subprocess.run(
        [sys.executable, "-c", text],
        env=environment, capture_output=True, text=True, timeout=200,
    )  # fmt: skip
    assert done.stdout.split() == digests(), done.stderr


def test_a_scene_is_known_by_its_digest_in_dataset_and_store(path):
    found = sweep(store=path)
    assert found.attrs["scene_digest"] == digests()[0]
    assert zj.open_sweep(path).attrs["scene_digest"] == digests()[0]


def test_a_batching_rule_of_the_users_own_is_a_part_of_the_scene():
    """It is no equation of a point, which is traced without a batch."""

    def scene(factor):
        @jax.custom_batching.custom_vmap
        def scaled(x):
            return 2.0 * x

        @scaled.def_vmap
        def of_a_batch(axis_size, batched, x):
            return factor * x, True

        return program.traced(scaled, ("x",), None).digest

    assert scene(3.0) == scene(3.0) != scene(5.0)


def test_every_setting_is_refused_by_name():
    settings = {"rtol": 1e-4, "solver": "Tsit5", "max_windows": 4}
    blocks = grid.Grid(xr.Dataset(coords={"x": X, "y": Y}))
    scene = program.traced(point, ("x", "y"), 4)

    def of(settings):
        return provenance.identity(scene._replace(attributes=settings), blocks)

    there = json.loads(json.dumps(of(settings=settings)))
    assert provenance.difference(there, of(settings=settings)) is None
    for name, value in {"rtol": 1e-5, "solver": "Dopri8", "max_windows": 5}.items():
        said = provenance.difference(there, of(settings={**settings, name: value}))
        assert said == f"has {name} {settings[name]}, and this sweep {value}"


@pytest.mark.parametrize(
    "options, parts",
    [
        ({"store": 3}, ("`store`", "3")),
        ({"lanes": 8}, ("`lanes`", "`Lanes`", "8")),
        ({"client": 3}, ("`client`", "3")),
    ],
)
def test_wrong_options_are_refused(refuses, options, parts):
    refuses(lambda: sweep(**options), *parts)


def test_a_folder_of_something_else_is_left_alone(tmp_path, refuses):
    (tmp_path / "thesis.txt").write_text("years of work")
    for again in (False, True):
        refuses(
            lambda a=again: sweep(store=zj.Store(tmp_path, overwrite=a)),
            "`store`",
            "is none",
        )
    assert (tmp_path / "thesis.txt").read_text() == "years of work"
    refuses(lambda: zj.open_sweep(tmp_path / "nothing"), "`store`", "nothing")
    refuses(lambda: sweep(store=tmp_path / "thesis.txt"), "`store`", "thesis")


def test_a_half_deleted_store_can_be_overwritten(path):
    sweep(store=path)
    (path / "zarr.json").unlink()
    assert same(sweep(store=zj.Store(path, overwrite=True)), sweep())
