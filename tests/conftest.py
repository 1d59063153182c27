"""What all tests share: 64 bits, strict promotion, how XLA compiles, and helpers."""

import gc
import json
import os
from importlib.metadata import version
from pathlib import Path

import jax
import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, settings
from jax._src import compiler
from tiers import of_the_night, reason_of, turn_of

from ziegler_jax import runtime
from ziegler_jax.sweep import grid, program

pytest_plugins = ["costs"]

# as `configure_cpu` does: a quarter of what a branch takes to compile
if runtime._WITHOUT not in (_flags := os.environ.get("XLA_FLAGS", "")):
    _flags += f" --{runtime._WITHOUT}={runtime._PASS}"
    os.environ["XLA_FLAGS"] = _flags.strip()

if version("jaxlib").startswith("0.10."):
    # where its most costly passes are left out, so is its later emitter of fused loops:
    # a curve of folds takes 30 s of processor time, without the passes 22 s, now 11 s
    _get_compile_options = compiler.get_compile_options

    def _without_the_later_emitter(*args, **kwargs):
        options = _get_compile_options(*args, **kwargs)
        debug = options.executable_build_options.debug_options
        if debug.xla_llvm_disable_expensive_passes:
            another = ("xla_cpu_use_fusion_emitters", False)
            options.env_option_overrides = [*options.env_option_overrides, another]
        return options

    compiler.get_compile_options = _without_the_later_emitter

jax.config.update("jax_enable_x64", True)
# no silent change of dtype or rank anywhere in the package
jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")

# 32 lanes an example; `--hypothesis-profile=full` draws 10 000 a test and method
for profile, examples in (("few", 3), ("full", 313)):
    settings.register_profile(
        profile, max_examples=examples, deadline=None, database=None, derandomize=True,
        suppress_health_check=list(HealthCheck), phases=[Phase.generate],
    )  # fmt: skip
settings.load_profile("few")


def pytest_addoption(parser):
    """How the suite is compiled, and whether its costs are written down."""
    parser.addoption("--optimised", action="store_true", help="compile as for users")
    parser.addoption("--night", action="store_true", help="large draws as well")
    parser.addoption("--costs", metavar="FILE", help="a table of what each test costs")


def pytest_configure(config):
    """Nearly all of the suite's time is XLA's: less without its most costly passes."""
    quick = not config.getoption("--optimised")
    jax.config.update("jax_disable_most_optimizations", quick)


@pytest.hookimpl(tryfirst=True)  # then they are deselected by their marks
def pytest_collection_modifyitems(config, items):
    """The second tier is that of `tiers.py`, and so is what is left to the night."""
    for item in items:
        if of_the_night(item.nodeid) and not config.getoption("--night"):
            item.add_marker(pytest.mark.skip(reason="a large draw: --night"))
        if reason := reason_of(item.nodeid):
            item.add_marker(pytest.mark.slow(reason))
    items.sort(key=lambda item: turn_of(item.nodeid))


def pytest_collection_finish():
    """The collector walks what will not go away, again and again, while JAX traces.

    With its usual thresholds it took a sixth to a quarter of the time of a trace.
    """
    gc.freeze()
    gc.set_threshold(100_000, 20, 100)


@pytest.fixture(scope="module")
def optimised(request):
    """XLA compiles as for users: for claims about bits, and for long runs.

    Of whole files, by their `pytestmark`: what was compiled before is not used, nor is
    it by other files.
    """
    _compile_as_for_users(True)
    yield
    _compile_as_for_users(request.config.getoption("--optimised"))


def _compile_as_for_users(do):
    program._cache.clear()
    jax.clear_caches()
    jax.config.update("jax_disable_most_optimizations", not do)


REFERENCE = Path(__file__).parent / "reference"


@pytest.fixture(scope="session")
def reference():
    """Reads a reference motion by its name."""

    def read(name: str) -> dict[str, np.ndarray]:
        with np.load(REFERENCE / f"{name}.npz") as file:
            return dict(file)

    return read


@pytest.fixture
def rng():
    """Random numbers that are the same in every run."""
    return np.random.default_rng(20250101)


@pytest.fixture
def refuses():
    """A ValueError whose one sentence holds every given part."""

    def check(call, *parts: str) -> None:
        with pytest.raises(ValueError) as caught:
            call()
        sentence = str(caught.value)
        for part in parts:
            assert part in sentence, f"{part!r} is not in: {sentence}"

    return check


@pytest.fixture
def told(caplog):
    """What sweeps have told their logger of blocks so far."""
    caplog.set_level("INFO", "ziegler_jax.sweep")

    def blocks():
        own = (r for r in caplog.records if r.name == "ziegler_jax.sweep")
        return [json.loads(record.getMessage()) for record in own]

    return blocks


@pytest.fixture
def small_blocks(monkeypatch):
    """Sweeps of a few points then have several blocks."""
    monkeypatch.setattr(grid, "POINTS_A_BLOCK", 10)


@pytest.fixture
def path(tmp_path):
    """Where a sweep is stored."""
    return tmp_path / "map.zarr"
