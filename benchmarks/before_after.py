"""Another checkout of the package against this one: seconds, compiling, errors.

    git worktree add ../before COMMIT
    python benchmarks/before_after.py ../before [--scenes smooth ...] [--pairs 7]
    python benchmarks/before_after.py ../before --compile
    python benchmarks/before_after.py ../before --errors [--shifts 16]

Two living processes, one with each package, run a scene in turns, so that a clock that
drifts bears on both; the first run of each, which compiles, and the second are not
counted. `ratio` is the median of the pairs' quotients, this checkout over the other, of
wall time without tracing. `--compile` pairs fresh processes that trace and compile the
scenes of `b4_first_call.py`, without a cache: processor seconds.

`--errors` compares the errors of `b0_work_precision.py` at each tolerance. They
scatter: any change of the steps moves a median by several per cent where friction is
smoothed. So each tolerance is taken many times, a hundredth apart; `medians` and `p95`
are geometric means of the quotients, with their standard errors over those shifts. Each
package is compared with its own motions at 1e-13 (stiff scenes 1e-11).
Prints one JSON line a scene, or a scene and method.
"""

import argparse
import importlib
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
Q = np.linspace(2, 4, 8192)
SHIFT = 0.01
TOLERANCES = 10.0 ** -np.arange(3, 9)
REFERENCE = 1e-13
# what errors are asked of; stiff scenes take 512 lanes, as in b0
ERRORS = {
    "frictionless": ("Tsit5", "Dopri8", "Vern9", "Calvo7"),
    "viscous": ("Tsit5", "Dopri8", "Vern9", "Calvo7"),
    "smooth": ("Tsit5", "Dopri8", "Vern9", "Calvo7"),
    "stiff_1e-3": ("Rodas5P",),
    "stiff_1e-4": ("Rodas5P",),
}


def one_window(zj, friction, high=4.0):
    """The reference work of `a0_throughput.py`."""

    def point(q):
        return zj.settle(
            zj.uniform_rods(q=q, friction=friction),
            zj.State(omega=(0.0, 0.2)),
            windows=zj.Windows(transient=80.0, length=20.0, max_windows=1),
            certify=False,
        )

    return lambda: zj.sweep(point, q=np.linspace(2, high, Q.size), progress=False)


def smooth(zj):
    law = zj.SmoothCoulomb(
        0.012, 0.010, pin_radius=1.0, v_stribeck=0.05, v_smooth=0.01,
        load=zj.ConstantLoad(1.0),
    )  # fmt: skip
    return one_window(zj, law)


def frictionless(zj):
    return one_window(zj, None, high=2.5)


def set_valued_map(zj):
    """That of `a3_friction.py`."""
    from ziegler_jax import __main__ as job

    def point(q, mu):
        friction = zj.SetValuedCoulomb(mu, pin_radius=job.PIN_RADIUS)
        column = zj.uniform_rods(q=q, friction=friction)
        return zj.settle(column, zj.State(omega=job.KICK), certify=False, **job.SETTLE)

    axes = {"q": np.linspace(1, 4, 97), "mu": np.linspace(0.02, 0.4, 40)}
    return lambda: zj.sweep(point, progress=False, **axes)


def main_job(zj, threads=None):
    """20 000 points of the certified map."""
    from ziegler_jax import __main__ as job

    q, mu = job.grid(20_000)
    return lambda: zj.sweep(
        job.point, where=lambda mu_s, mu_k, q: mu_k <= mu_s, q=q, mu_s=mu, mu_k=mu,
        lanes=zj.Lanes(threads=threads), progress=False,
    )  # fmt: skip


def main_job_one_thread(zj):
    return main_job(zj, threads=1)


def dry_map(zj):
    """20 000 points of the main job with dry friction, by each package's own rule.

    That is certificates, windows where these were not the default yet.
    """
    from ziegler_jax import __main__ as job

    def point(q, mu_s, mu_k):
        friction = zj.SetValuedCoulomb(mu_s, mu_k, pin_radius=job.PIN_RADIUS)
        column = zj.uniform_rods(q=q, friction=friction)
        return zj.settle(column, zj.State(omega=job.KICK), **job.SETTLE)

    q, mu = job.grid(20_000)
    return lambda: zj.sweep(
        point, where=lambda mu_s, mu_k, q: mu_k <= mu_s, q=q, mu_s=mu, mu_k=mu,
        progress=False,
    )  # fmt: skip


WHOLE_MAPS = (set_valued_map, main_job, main_job_one_thread, dry_map)
SCENES = {f.__name__: f for f in (smooth, frictionless, *WHOLE_MAPS)}


def seconds(zj, name):
    """A run's seconds for each request: without tracing and compiling."""
    run = SCENES[name](zj)
    while True:
        ds = run()
        yield {"run": ds.attrs["run_seconds"], "steps": float(ds.steps.sum())}


def errors(zj, name, shifts):
    """For each method asked: by tolerance and shift the median and 95th percentile."""
    import ours
    from scenes import LANES, SCENES, START

    scene = SCENES[name]
    q = scene.loads(512 if scene.stiff else LANES)
    finest = "Rodas5P" if scene.stiff else "Vern9"
    reference = 1e-11 if scene.stiff else REFERENCE
    truth, _ = ours.run(scene, q, START, scene.span, reference, finest)
    method = yield
    while True:
        found = []
        for tol in TOLERANCES:
            for k in range(shifts):
                rtol = float(tol * (1 + SHIFT) ** (k - (shifts - 1) / 2))
                states, _ = ours.run(scene, q, START, scene.span, rtol, method)
                apart = np.abs(states - truth).max(axis=1)
                found.append([float(np.quantile(apart, p)) for p in (0.5, 0.95)])
        method = yield np.reshape(found, (TOLERANCES.size, shifts, 2)).tolist()


def work(tree, what, name, shifts):
    """Answer requests, a line each, with the package of `tree`."""
    sys.path.insert(0, str(tree))
    zj = importlib.import_module("ziegler_jax")
    assert Path(str(zj.__file__)).parent.parent == tree, f"{zj.__file__} was imported"
    zj.configure_cpu()
    if what == "compile":
        import b4_first_call

        print(json.dumps(b4_first_call.compiling(name)))
        return
    answers = errors(zj, name, shifts) if what == "errors" else seconds(zj, name)
    if what == "errors":
        next(answers)
    for line in sys.stdin:
        asked = line.strip()
        answer = answers.send(asked) if what == "errors" else next(answers)
        print(json.dumps(answer), flush=True)


class Contestant:
    """A process with the package of a checkout."""

    def __init__(self, tree, what, name, shifts=0):
        """Start it."""
        command = [sys.executable, str(HERE / "before_after.py"), str(tree)]
        command += ["--work", what, "--scenes", name, "--shifts", str(shifts)]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
        own = {k: v for k, v in os.environ.items() if k != "JAX_COMPILATION_CACHE_DIR"}
        self.process = subprocess.Popen(command, text=True, env=own, **pipes)

    def ask(self, request="run"):
        """Its next answer."""
        self.process.stdin.write(f"{request}\n")
        self.process.stdin.flush()
        line = self.process.stdout.readline()
        if not line:
            raise RuntimeError("a contestant ended: see its message above")
        return json.loads(line)

    def end(self):
        """Its last words."""
        return self.process.communicate()[0]


def turns(contestants, pairs):
    """Answers of each, who is first taking turns; two beforehand."""
    for one in contestants:
        one.ask()
        one.ask()
    return in_turns(lambda i: contestants[i].ask(), pairs)


def in_turns(answer, pairs):
    """Answers of both, 0 and 1: each is first in every other pair."""
    answers = [[], []]
    for turn in range(pairs):
        for i in (0, 1) if turn % 2 else (1, 0):
            answers[i].append(answer(i))
    return answers


def ratio_of(before, after):
    """The median of the quotients, and their range."""
    from measure import paired  # which imports the package: after the path is set

    return dict(zip(("ratio", "range"), paired(after, before), strict=True))


def compare_seconds(trees, name, pairs):
    contestants = [Contestant(tree, "seconds", name) for tree in trees]
    answers = turns(contestants, pairs)
    for one in contestants:
        one.end()
    a_step = [[a["run"] / a["steps"] * 1e9 for a in each] for each in answers]
    yield {
        "scene": name,
        **ratio_of(*[[a["run"] for a in each] for each in answers]),
        "ratio_of_a_step": ratio_of(*a_step)["ratio"],
        "seconds": [float(np.median([a["run"] for a in each])) for each in answers],
        "ns_a_step": [float(np.median(each)) for each in a_step],
    }


def compare_compiling(trees, name, pairs):
    rows = in_turns(
        lambda i: json.loads(Contestant(trees[i], "compile", name).end()), pairs
    )
    for key in ("trace", "compile"):
        columns = [[row[key] for row in each] for each in rows]
        medians = [float(np.median(c)) for c in columns]
        yield {
            "scene": name, "what": key, **ratio_of(*columns),
            "processor_seconds": medians,
        }  # fmt: skip


def compare_errors(trees, name, shifts):
    contestants = [Contestant(tree, "errors", name, shifts) for tree in trees]
    for method in ERRORS[name]:
        before, after = (np.log(one.ask(method)) for one in contestants)
        mean = (after - before).mean(axis=1)
        doubt = (after - before).std(axis=1, ddof=1) / np.sqrt(shifts)
        yield {
            "scene": name,
            "method": method,
            "tolerances": TOLERANCES.tolist(),
            "medians": np.exp(mean[:, 0]).tolist(),
            "medians_error": doubt[:, 0].tolist(),
            "p95": np.exp(mean[:, 1]).tolist(),
            "p95_error": doubt[:, 1].tolist(),
        }
    for one in contestants:
        one.end()


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("before", type=Path, help="a checkout's folder")
    parser.add_argument("--scenes", nargs="+", help="of those that are asked")
    parser.add_argument("--pairs", type=int, default=7)
    parser.add_argument("--compile", action="store_true")
    parser.add_argument("--errors", action="store_true")
    parser.add_argument("--shifts", type=int, default=16)
    parser.add_argument("--work", help=argparse.SUPPRESS)
    options = parser.parse_args()
    trees = [options.before.resolve(), HERE.parent]
    if options.work:
        work(trees[0], options.work, options.scenes[0], options.shifts)
        return
    sys.path.insert(0, str(trees[1]))
    from measure import machine, rounded

    scenes, compare, count = SCENES, compare_seconds, options.pairs
    if options.compile:
        from b4_first_call import SCENES as scenes

        compare = compare_compiling
    elif options.errors:
        scenes, compare, count = ERRORS, compare_errors, options.shifts
    git = ["git", "-C", str(trees[0]), "rev-parse", "HEAD"]
    about = machine() | {"before": subprocess.check_output(git, text=True).strip()}
    del about["clock"]  # as said above
    for name in options.scenes or scenes:
        for row in compare(trees, name, count):
            line = {"benchmark": "before_after", **row}
            print(json.dumps(rounded(line | about)), flush=True)


if __name__ == "__main__":
    main()
