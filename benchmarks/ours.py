"""This engine as a contestant: the public `sweep` of a `point`, solver by solver."""

import functools

import diffrax as dfx
import numpy as np
from measure import OF_THE_PROCESSOR, clock

import ziegler_jax as zj

SOLVERS = {
    "Tsit5": zj.Explicit(),
    "Dopri8": zj.Explicit(dfx.Dopri8.tableau),
    **{name: zj.Explicit(*method) for name, method in zj.tableaus.ALL.items()},
}
STIFF_SOLVERS = {"Rodas5P": zj.Rosenbrock()}


def column_of(scene, q):
    """The column of a scene under a load."""
    law, damping, friction = scene.friction, None, None
    if law is not None:
        friction = zj.SmoothCoulomb(
            law.tau_s,
            law.tau_k,
            pin_radius=1.0,
            v_stribeck=law.v_stribeck,
            v_smooth=law.v_smooth,
            load=zj.ConstantLoad(1.0),
        )
    if scene.damping is not None:
        damping = zj.Viscous(scene.damping, scene.damping)
    return zj.uniform_rods(q, damping=damping, friction=friction)


@functools.cache
def point_of(scene, start, solver):
    """The scene with loads and tolerances as axes: one program serves them all."""

    def point(q, tol, span):
        settled = zj.settle(
            column_of(scene, q),
            zj.State(start[:2], start[2:]),
            windows=zj.Windows(transient=0.0, length=span, max_windows=1, escape=1e9),
            method=zj.Method(
                rtol=tol,
                atol=tol,
                solver=(SOLVERS | STIFF_SOLVERS)[solver],
                max_steps=10_000_000,
            ),
            certify=False,
        )
        phi, omega = settled.final.phi, settled.final.omega
        states = {"phi1": phi[0], "phi2": phi[1], "w1": omega[0], "w2": omega[1]}
        return {**states, "steps": settled.steps}

    return point


def run(scene, q, start, span, rtol, solver="Tsit5"):
    """As the peers' `run`."""
    ds, seconds = solved(scene, q, start, span, rtol, solver)
    names = ("phi1", "phi2", "w1", "w2")
    return np.stack([ds[name].values[:, 0, 0] for name in names], axis=1), seconds


def solved(scene, q, start, span, rtol, solver="Tsit5", **options):
    """The dataset and the seconds of a sweep whose program is compiled.

    Tracing, some hundredths of a second a call, is not counted by the wall's clock: a
    peer is set up before its clock starts, too.
    """
    point = point_of(scene, tuple(start), solver)
    axes = {"tol": [rtol], "progress": False, **options}
    zj.sweep(point, q=q[:2], span=[0.05], **axes)  # compiles
    begun = clock()
    ds = zj.sweep(point, q=q, span=[span], **axes)
    whole = clock() - begun
    return ds, whole if OF_THE_PROCESSOR else ds.attrs["run_seconds"]


def dry(q, tau):
    """Uniform rods with set-valued friction of equal torques tau at any load."""
    law = zj.SetValuedCoulomb(tau, pin_radius=1.0, load=zj.ConstantLoad(1.0))
    return zj.uniform_rods(q, friction=law)
