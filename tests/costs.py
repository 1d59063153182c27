"""What each test costs: seconds of processor time, and what JAX does in them.

    python -m pytest -n 0 --costs=table.md

writes a table, a row for a file, dearest first. `seconds` is processor time, of the
processes that a test starts too. `tracing` and `compiling` are seconds of the clock by
JAX's own monitoring, each without the other where one is within the other, and summed
over threads: where nothing else computes they are parts of the first number, and the
rest is running and the test's own Python.
"""

import os
import threading
import time
from collections import defaultdict

import jax
import pytest

KIND = {
    "/jax/core/compile/jaxpr_trace_duration": "tracing",
    "/jax/core/compile/jaxpr_to_mlir_module_duration": "tracing",
    "/jax/core/compile/backend_compile_duration": "compiling",
}
_spans = defaultdict(list)  # by thread: (start, length), of what no other holds
_seconds = defaultdict(float)


def _listen(event, duration, **_):
    kind = KIND.get(event)
    if kind is None:
        return
    spans, start = _spans[threading.get_ident()], time.perf_counter() - duration
    within = 0.0
    while spans and spans[-1][0] >= start:
        within += spans.pop()[1]
    spans.append((start, duration))
    _seconds[kind] += duration - within


def _processor():
    now = os.times()
    return now.user + now.system + now.children_user + now.children_system


class Costs:
    """Gathers a row a test, and writes the table at the end."""

    def __init__(self, path):
        self.path = path
        self.rows = []

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item):
        """A module's fixtures are charged to the test that first asks for them."""
        _spans.clear()
        _seconds.clear()
        item.user_properties.append(("costs", {"seconds": -_processor()}))
        return (yield)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_teardown(self, item):
        """The last of a test: its report takes the costs along."""
        try:
            return (yield)
        finally:
            cost = dict(item.user_properties)["costs"]
            cost["seconds"] += _processor()
            cost.update(_seconds)

    def pytest_runtest_logreport(self, report):
        """Of each test once, its processes' reports come to the one that writes."""
        cost = dict(report.user_properties).get("costs")
        if report.when == "teardown" and cost is not None:
            self.rows.append((report.nodeid, cost))

    def pytest_sessionfinish(self, session):
        """The table, where the tests' reports have come together."""
        if not hasattr(session.config, "workerinput"):
            text = table(self.rows)
            with open(self.path, "w") as file:
                file.write(text)


def table(rows):
    """Of (test, cost) pairs, by file, dearest first."""
    files = defaultdict(lambda: defaultdict(float))
    for test, cost in rows:
        for name in (test.split("::")[0], "all of them"):
            files[name]["tests"] += 1
            for kind, seconds in cost.items():
                files[name][kind] += seconds
    lines = ["| file | tests | seconds | tracing | compiling | dearest test |"]
    lines += ["|---|---|---|---|---|---|"]
    for name, cost in sorted(files.items(), key=lambda pair: -pair[1]["seconds"]):
        own = [(c["seconds"], test) for test, c in rows if test.split("::")[0] == name]
        most, test = max(own, default=(0.0, ""))
        dearest = f"{most:.1f} {test.split('::', 1)[1]}" if test else ""
        lines.append(
            f"| {name} | {cost['tests']:.0f} | {cost['seconds']:.1f} | "
            f"{cost['tracing']:.1f} | {cost['compiling']:.1f} | {dearest} |"
        )
    return "\n".join(lines) + "\n"


def pytest_configure(config):
    """With `--costs` alone is anything listened to."""
    path = config.getoption("--costs")
    if path:
        jax.monitoring.register_event_duration_secs_listener(_listen)
        config.pluginmanager.register(Costs(path))
