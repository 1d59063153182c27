"""What all tests share: 64 bits, strict promotion, how XLA compiles, and helpers."""

import gc
import os
from pathlib import Path

import jax
import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, settings

from ziegler_jax.sweep import partition, program

pytest_plugins = ["costs"]

# Nearly all of the suite's time is XLA's. It compiles in a third of it without its most
# costly passes and, on jaxlib 0.10, with the emitter that later versions have alone (a
# curve of folds: 30 s, 22 s and 11 s of processor time). An option that a jaxlib does
# not know does nothing here. Processes that tests start compile as a user's do.
_FLAGS = os.environ.get("XLA_FLAGS")
if "xla_backend_extra_options" not in (_FLAGS or ""):
    _SOONER = "--xla_backend_extra_options=xla_cpu_disable_new_fusion_emitters=true"
    os.environ["XLA_FLAGS"] = f"{_FLAGS or ''} {_SOONER}".strip()
    jax.devices()  # reads them
    del os.environ["XLA_FLAGS"]
    if _FLAGS is not None:
        os.environ["XLA_FLAGS"] = _FLAGS
jax.config.update("jax_disable_most_optimizations", True)

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
    """How hard stores are attacked: see test_stores_under_attack."""
    parser.addoption("--faults", choices=("few", "all"), default="few")
    parser.addoption("--costs", metavar="FILE", help="a table of what each test costs")


def pytest_collection_finish():
    """The collector walks what will not go away, again and again, while JAX traces.

    With its usual thresholds it took a sixth to a quarter of the time of a trace.
    """
    gc.freeze()
    gc.set_threshold(100_000, 20, 100)


@pytest.fixture(scope="session")
def all_faults(request):
    """Whether every attack is to be tried."""
    return request.config.getoption("--faults") == "all"


@pytest.fixture(scope="module")
def optimised():
    """XLA compiles as for users: for long runs, and for claims about their bits.

    What was compiled before is not used, nor is it by other tests.
    """
    _compile_as_users(True)
    yield
    _compile_as_users(False)


def _compile_as_users(do):
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
def small_blocks(monkeypatch):
    """Sweeps of a few points then have several blocks."""
    monkeypatch.setattr(partition, "POINTS_A_BLOCK", 10)


@pytest.fixture
def path(tmp_path):
    """Where a sweep is stored."""
    return tmp_path / "map.zarr"
