"""The first map: amplitude of joint 2 over load and friction, one cell a motion.

A minute on two cores, nearly all of it compilation.
"""

import matplotlib.pyplot as plt
import numpy as np
import style

import ziegler_jax as zj

TITLE = "Uniform rods on pins of radius $0.1\\,l$ with dry friction,\n"
TITLE += r"kicked by $\dot\varphi_2(0) = 0.3\,\sqrt{k/(m l^2)}$"


def point(q, mu):
    friction = zj.SetValuedCoulomb(mu, pin_radius=0.1)
    column = zj.uniform_rods(q=q, friction=friction)
    return zj.settle(column, zj.State(omega=(0, 0.3)))


def main():
    ds = zj.sweep(point, q=np.linspace(1, 3, 81), mu=np.linspace(0.01, 0.2, 40))
    figure, ax = plt.subplots(figsize=(6.8, 4.3), layout="constrained")
    zj.plot.map(ds.sel(joint=2), "joint_amplitude", x="q", y="mu", ax=ax)
    figure.suptitle(TITLE, fontsize=12)
    style.save(figure, __file__)


if __name__ == "__main__":
    main()
