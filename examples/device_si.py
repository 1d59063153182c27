"""A device in SI units: 0.1 kg, 0.2 m, 0.5 N m/rad, pins of 4 mm, mu = 0.15."""

import jax
import numpy as np

import ziegler_jax as zj

jax.config.update("jax_enable_x64", True)

POINTS = 4
DEVICE = zj.SI(m=0.1, l=0.2, k=0.5)
RODS = {"m1": 0.1, "m2": 0.1, "l1": 0.2, "l2": 0.2}
WINDOWS = DEVICE.scaled(zj.Windows(transient=10.0, length=5.0))  # seconds


def cell(F, kick):  # newtons, rad/s
    friction = zj.SetValuedCoulomb(0.15, pin_radius=0.004)
    damping = zj.Viscous(1e-4, 1e-4)  # N m s/rad
    column = zj.uniform_rods(F, **RODS, friction=friction, damping=damping)
    return DEVICE.scaled(column), DEVICE.scaled(zj.State(omega=(0, kick)))


def point(F, kick):
    return zj.settle(*cell(F, kick), windows=WINDOWS)


F, kick = np.linspace(3, 8, POINTS), np.linspace(0.5, 4, POINTS)
ds = DEVICE.restore(zj.sweep(point, F=F, kick=kick).sel(joint=2))
ds.pipe(zj.plot.map, "joint_amplitude", x="F", y="kick").figure.savefig("device.png")
motion = zj.trajectory(*cell(F[-1], kick[-1]), np.linspace(0, 100, 2001))
motion = DEVICE.restore(motion)
print("the longest motion took", float(ds.time.max()), "s; this one", motion.ts[-1])
