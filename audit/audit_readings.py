"""What a kick leads to in every reading of the paper's missing data.

The paper names neither pin radius, normal load nor kick: here each law of friction runs
over all of them, by `lyapunov_exponents` and the multipliers of the cycle nearest to
where the run ends.
"""

import functools
from concurrent.futures import ThreadPoolExecutor

import jax.numpy as jnp
import seed_style as style

import ziegler_jax as zj

UNITS, MU_S, MU_K = style.UNITS, style.MU_S, style.MU_K
Q = 2.6
TRANSITION = 0.1  # rad/s: the usual default, 0.1 units a second at a pin of one unit
RADII = (0.001, 0.01, 0.03, 0.1, 0.3, 1.0)  # m
KICKS = (0.2, 0.7, 2.0)  # of rod 2: 0.6, 2.2 and 6.3 rad/s
TRANSIENT, BLOCK, BLOCKS = 200.0, 60.0, 10
BESIDE = ThreadPoolExecutor(1)


def law(radius, load=None, mu_s=MU_S, mu_k=MU_K):
    """Set-valued friction on a pin of this radius in m; the load F if none is named.

    A constant load is in N, of this law and of `joint`.
    """
    return UNITS.scaled(zj.SetValuedCoulomb(mu_s, mu_k, pin_radius=radius, load=load))


def joint(radius, load, rate=TRANSITION):
    """The law of a multibody program with its transition at this rate in rad/s."""
    law = UNITS.joint_friction(
        MU_S, MU_K, pin_radius=radius, transition_velocity=rate * radius, load=load
    )
    return UNITS.scaled(law)


READINGS = {  # the law, and its normal load in N where the motion does not decide it
    "F": (law, Q * UNITS.force),
    "10 N": (law, 10.0),
    "reaction": (law, None),
    "F, smoothed": (joint, Q * UNITS.force),
    "reaction, smoothed": (joint, None),
}


@functools.cache
def begun(friction, constant):
    """`runs` on a second thread, as most of its time one compiles."""
    return BESIDE.submit(runs, friction, constant)


def begin():
    """Begin the runs of all readings."""
    for friction, normal in READINGS.values():
        begun(friction, normal is not None)


def runs(friction, constant):
    """All loads, pins and kicks of a law, as a dataset."""

    def point(normal, radius, kick):
        load = zj.ConstantLoad(normal) if constant else zj.JointReaction()
        column = zj.uniform_rods(q=Q, friction=friction(radius, load))
        start = zj.State(omega=(0.0, kick))
        # the layer of a smoothed law on a thick pin takes steps of 0.003
        share = 1.0 if friction is law else jnp.where(radius < 0.05, 1.0, 0.25)
        late = zj.lyapunov_exponents(
            column,
            start,
            count=2,
            spans=zj.Spans(
                transient=share * TRANSIENT, length=share * BLOCK, count=BLOCKS
            ),
            method=zj.Method(rtol=1e-7, atol=1e-7),
        )
        floquet = jnp.nan * late.time
        if friction is law:  # of a smoothed law it would cost more than all the rest
            orbit = zj.periodic_orbit(
                column, late.final, method=zj.Method(rtol=1e-9, atol=1e-9)
            )
            floquet = jnp.log(jnp.abs(orbit.multipliers[1])) / orbit.period
        w1, w2 = late.final.omega
        return {
            "first": late.exponents[0],
            "second": late.exponents[1],
            "error": jnp.max(late.errors),
            "span": share * BLOCK * BLOCKS,
            "rate": jnp.maximum(jnp.abs(w1), jnp.abs(w2 - w1)),
            "floquet": floquet,
        }

    normal = sorted({n for f, n in READINGS.values() if f is friction and n})
    axes = {"normal": normal if constant else [0.0], "radius": RADII, "kick": KICKS}
    return zj.sweep(
        point, lanes=zj.Lanes(batch_size=len(RADII) * len(KICKS) // 2), axes=axes
    )


def kind(run, rest):
    """The verdict on one run: by its exponents, and by the cycle's multipliers."""
    zero = 1 / run["span"] + 3 * run["error"]
    if run["rate"] < rest:
        return "stuck"
    if run["first"] > zero:
        return "chaotic"
    if run["second"] < -zero:
        return "cycle"
    # slower than the run can tell: the cycle that it comes from or goes to decides
    return "slow cycle" if run["floquet"] < 0 else "undecided"


@functools.cache
def reading(name):
    """One reading: for every pin what each kick leads to, and the exponents across.

    `across` is the second Lyapunov exponent of the hardest kick, `error` its standard
    error, `floquet` the exponent of the cycle (set-valued friction only; NaN where none
    was found).
    """
    friction, normal = READINGS[name]
    ds = begun(friction, normal is not None).result().sel(normal=normal or 0.0)
    rows = []
    for radius in RADII:
        rest = 1e-9 if friction is law else float(joint(radius, None).v_smooth)
        lanes = [
            {k: float(v) for k, v in ds.sel(radius=radius, kick=kick).items()}
            for kick in KICKS
        ]
        hard = lanes[-1]
        rows.append(
            {
                "radius": radius,
                "kinds": [kind(lane, rest) for lane in lanes],
                "across": hard["second"],
                "error": hard["error"],
                "floquet": hard["floquet"],
            }
        )
    return rows
