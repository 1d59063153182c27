"""A branch of cycles through three folds, by AUTO-07p's collocation and by shooting.

Friction in both joints, smoothed, tau = 0.1, v_smooth = 0.05, beside a little viscous
damping. The folds and, wherever the branch passes one of a few loads, the period there.
Debian's package of the name with a Fortran compiler was used (0.9.2). One line of JSON.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import jax
import numpy as np

jax.config.update("jax_enable_x64", True)

import ziegler_jax as zj  # noqa: E402

TAU, V_SMOOTH, DAMPING, FIRST = 0.1, 0.05, 0.002, 2.4
LOADS = (2.2, 2.0, 1.8, 1.7, 1.64, 1.63)

FIELD = """
subroutine func(ndim, u, icp, par, ijac, f, dfdu, dfdp)
  implicit none
  integer, intent(in) :: ndim, icp(*), ijac
  double precision, intent(in) :: u(ndim), par(*)
  double precision, intent(out) :: f(ndim)
  double precision, intent(inout) :: dfdu(ndim, ndim), dfdp(ndim, *)
  double precision :: s, h, t1, t2, r1, r2, det, rate
  s = sin(u(1) - u(2))
  h = 0.5d0*cos(u(1) - u(2))
  rate = u(4) - u(3)
  t1 = {tau}d0*tanh(u(3)/{v}d0) + {c}d0*u(3)
  t2 = {tau}d0*tanh(rate/{v}d0) + {c}d0*rate
  r1 = par(1)*s - 2*u(1) + u(2) - 0.5d0*s*u(4)**2 - t1 + t2
  r2 = u(1) - u(2) + 0.5d0*s*u(3)**2 - t2
  det = 4d0/9d0 - h*h
  f(1) = u(3)
  f(2) = u(4)
  f(3) = (r1/3d0 - h*r2)/det
  f(4) = (4d0/3d0*r2 - h*r1)/det
end subroutine func
subroutine stpnt(ndim, u, par, t)
  integer, intent(in) :: ndim
  double precision, intent(inout) :: u(ndim), par(*)
  double precision, intent(in) :: t
  par(1) = {first}d0
end subroutine stpnt
subroutine bcnd
end subroutine bcnd
subroutine icnd
end subroutine icnd
subroutine fopt
end subroutine fopt
subroutine pvls
end subroutine pvls
"""

SCRIPT = """
import json
branch = run(
    e="column", dat="column", NDIM=4, NPAR=12, IPS=2, IRS=0, ICP=[1, 11], ILP=1, ISP=0,
    NTST=300, NCOL=5, IAD=1, NMX=600, NPR=1000, JAC=0, ITMX=9, ITNW=9, NWTN=5,
    EPSL=1e-11, EPSU=1e-11, EPSS=1e-9, DS=-0.01, DSMIN=1e-6, DSMAX=0.05, IADS=1,
    UZR={{1: {loads}}}, UZSTOP={{1: [1.2, 2.5]}},
)
rows = [
    (label["TY name"], label["PAR(1)"], label["PERIOD"])
    for label in branch() if label["TY name"] in ("LP", "UZ")
]
print("ROWS", json.dumps(rows))
"""


def column(q):
    law = zj.SmoothCoulomb(
        TAU, pin_radius=1.0, v_smooth=V_SMOOTH, load=zj.ConstantLoad(1.0)
    )
    return zj.uniform_rods(q, friction=law, damping=zj.Viscous(DAMPING, DAMPING))


@jax.jit
def first_cycle():
    settled = zj.settle(column(FIRST), zj.State(omega=(0.0, 1.2)))
    orbit = zj.periodic_orbit(column(FIRST), settled.final)
    ts = np.linspace(0.0, 1.0, 2001)
    return orbit, zj.trajectory(column(FIRST), orbit.state, ts * orbit.period)


def theirs(orbit, motion, folder):
    """AUTO's labels along the branch: kind, load, period."""
    ts = np.linspace(0.0, 1.0, 2001) * float(orbit.period)
    path = np.concatenate([ts[:, None], motion.phi, motion.omega], axis=1)
    np.savetxt(folder / "column.dat", path, "%.16e")
    numbers = dict(tau=TAU, v=V_SMOOTH, c=DAMPING, first=FIRST)
    (folder / "column.f90").write_text(FIELD.format(**numbers))
    (folder / "column.auto").write_text(SCRIPT.format(loads=list(LOADS)))
    ran = subprocess.run(
        ["auto-07p", "column.auto"], cwd=folder, capture_output=True, text=True
    )
    for line in ran.stdout.splitlines():
        if line.startswith("ROWS"):
            return json.loads(line.removeprefix("ROWS"))
    sys.exit(ran.stdout[-3000:] + ran.stderr[-3000:])


@jax.jit
def branch(orbit):
    arc = zj.Arc(direction=-1, bounds=(1.2, 2.5))
    return zj.continue_cycle(column, orbit, FIRST, arc=arc, max_special_points=6)


@jax.jit
def cycle_at(q, y, period):
    guess = zj.State((y[0], y[1]), (y[2], y[3]))
    return zj.periodic_orbit(column(q), guess, period=period).period


def ours(orbit):
    """The same labels: folds of the branch, and cycles at the loads that it passes."""
    found = jax.tree.map(np.asarray, branch(orbit))
    points, count = found.points, int(found.count)
    q = points.parameter[:count]
    y = np.concatenate([points.phi, points.omega], axis=1)[:count]
    rows = []
    for i in range(count - 1):
        for load in LOADS:
            share = (load - q[i]) / (q[i + 1] - q[i])
            if 0 <= share < 1:
                guess = y[i] + share * (y[i + 1] - y[i])
                longer = points.period[i + 1] - points.period[i]
                period = cycle_at(load, guess, points.period[i] + share * longer)
                rows.append(("UZ", load, float(period)))
    folds = found.special.kind == zj.CODE.fold
    specials = found.special.parameter[folds], found.special.period[folds]
    return rows, [("LP", float(a), float(b)) for a, b in zip(*specials, strict=True)]


def main():
    orbit, motion = first_cycle()
    passed, folds = ours(orbit)
    with tempfile.TemporaryDirectory() as folder:
        labels = theirs(orbit, motion, Path(folder))
    line = {"peer": "auto-07p", "v_smooth": V_SMOOTH, "tau": TAU, "c": DAMPING}
    for kind, mine, name in (("LP", folds, "folds"), ("UZ", passed, "passages")):
        # beyond the last load it goes on to its bound
        other = np.array([row[1:] for row in labels if row[0] == kind])[: len(mine)]
        mine = np.array([row[1:] for row in mine])
        line[name] = other.tolist()
        line[f"{name}_apart"] = np.abs(mine - other).max(0).tolist()
    print(json.dumps(line))


if __name__ == "__main__":
    main()
