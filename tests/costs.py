"""What each test costs: processor seconds, and how they part.

    python -m pytest --costs=table.md

writes a table, a row for a file, dearest first. `traced` and `compiled` are seconds by
JAX's own monitoring: of jaxprs and their lowering, and of XLA. What is left of a test's
time is running, the test's own Python, and the processes that it starts.
"""

import os
import time
from collections import defaultdict

import jax
import pytest

# two durations of one kind that overlap are nested: the outer holds the inner
KIND = {
    "/jax/core/compile/jaxpr_trace_duration": "traced",
    "/jax/core/compile/jaxpr_to_mlir_module_duration": "traced",
    "/jax/core/compile/backend_compile_duration": "compiled",
}
_spans = defaultdict(list)


def _listen(event, duration, **_):
    kind = KIND.get(event)
    if kind is None:
        return
    end = time.perf_counter()
    spans = _spans[kind]
    while spans and spans[-1][0] >= end - duration:
        spans.pop()
    spans.append((end - duration, end))


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
        begun = _processor()
        item.user_properties.append(("costs", cost := {}))
        cost["begun"] = begun
        return (yield)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_teardown(self, item):
        result = yield
        (cost,) = [value for name, value in item.user_properties if name == "costs"]
        cost["all"] = _processor() - cost.pop("begun")
        for kind, spans in _spans.items():
            cost[kind] = sum(end - start for start, end in spans)
        return result

    def pytest_runtest_logreport(self, report):
        """Of each test once, its processes' reports come to the one that writes."""
        if report.when == "teardown":
            for name, cost in report.user_properties:
                if name == "costs":
                    self.rows.append((report.nodeid, cost))

    def pytest_sessionfinish(self, session):
        """The table, where the tests' reports have come together."""
        if not hasattr(session.config, "workerinput"):
            with open(self.path, "w") as file:
                file.write(table(self.rows))


def table(rows):
    """Of (test, cost) pairs, by file, dearest first."""
    files = defaultdict(lambda: defaultdict(float))
    for test, cost in rows:
        for name in (test.split("::")[0], "all of them"):
            files[name]["tests"] += 1
            for kind, seconds in cost.items():
                files[name][kind] += seconds
    lines = ["| file | tests | seconds | traced | compiled | dearest test |"]
    lines += ["|---|---|---|---|---|---|"]
    for name, cost in sorted(files.items(), key=lambda pair: -pair[1]["all"]):
        own = [(c["all"], test) for test, c in rows if test.split("::")[0] == name]
        most, test = max(own, default=(None, ""))
        dearest = f"{most:.1f} {test.split('::', 1)[1]}" if test else ""
        lines.append(
            f"| {name} | {cost['tests']:.0f} | {cost['all']:.1f} | "
            f"{cost['traced']:.1f} | {cost['compiled']:.1f} | {dearest} |"
        )
    return "\n".join(lines) + "\n"


def pytest_configure(config):
    """With `--costs` alone is anything listened to."""
    path = config.getoption("--costs")
    if path:
        jax.monitoring.register_event_duration_secs_listener(_listen)
        config.pluginmanager.register(Costs(path))
