"""At which load a kick starts flutter, over static and kinetic friction."""

import numpy as np

import ziegler_jax as zj

POINTS = 3  # along each axis
KICK = zj.State(omega=(0, 0.3))


def point(mu_s, mu_k):
    def column(q):
        friction = zj.SetValuedCoulomb(mu_s, mu_k, pin_radius=0.1)
        return zj.uniform_rods(q, friction=friction)

    search = zj.Search(scan=3, halvings=4)
    return zj.flutter_onset(column, KICK, (1.0, 3.0), search=search)


mu = np.linspace(0.1, 0.4, POINTS)
ds = zj.sweep(point, where=lambda mu_s, mu_k: mu_k <= mu_s, mu_s=mu, mu_k=mu)
ds.pipe(zj.plot.map, "threshold", x="mu_s", y="mu_k").figure.savefig("onset.png")
