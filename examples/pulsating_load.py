"""A pulsating load, q + p cos(rate t): where a small kick of the column grows."""

import jax.numpy as jnp
import numpy as np

import ziegler_jax as zj


class Pulsation(zj.AbstractLoadHistory):
    p: float
    rate: float

    def load(self, t):
        return self.p * jnp.cos(self.rate * t)


def point(p, rate):
    column = zj.uniform_rods(1.0, forces=Pulsation(p, rate))
    windows = zj.Windows(transient=0, length=400, max_windows=1)
    return zj.settle(column, zj.State(omega=(0, 1e-4)), windows=windows)


ds = zj.sweep(point, p=np.linspace(0.05, 0.5, 7), rate=np.linspace(1.0, 1.8, 33))
ax = ds.sel(rod=2).pipe(zj.plot.map, "rod_amplitude", x="rate", y="p")
ax.figure.savefig("pulsation.png")
grows = ~(ds.rod_amplitude.sel(rod=2) < 0.01)  # some grow until they turn over
print("cells that grow:", grows.sum("rate").values)
