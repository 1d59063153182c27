"""The column and its symbols."""

import matplotlib.pyplot as plt
import style

import ziegler_jax as zj

KEY = {
    r"$m,\ l$": "mass and length of rod 1",
    r"$q = F\,l/k$": "follower load, along rod 2",
    r"$\mu_s,\ \mu_k$": "static and kinetic friction",
    r"$\kappa = k_1/k_2$": "ratio of the springs",
    r"$\eta$": "follower fraction: $F$ turns by\n$\\eta\\,\\varphi_2$, here 1",
    r"$\dot\varphi_2(0)$": "kick: rate of rod 2 at the start",
}

if __name__ == "__main__":
    column = zj.uniform_rods(2.0, friction=zj.SetValuedCoulomb(0.1, pin_radius=0.1))
    figure = plt.figure(figsize=(6.8, 3.2))
    ax = figure.add_axes((0, 0, 0.46, 1))
    zj.plot.sketch(column, zj.State((0.42, 0.95), (0.0, 0.3)), ax=ax)
    for row, (symbol, meaning) in enumerate(KEY.items()):
        figure.text(0.47, 0.9 - 0.16 * row, symbol, va="center")
        figure.text(0.63, 0.9 - 0.16 * row, meaning, va="center")
    style.save(figure, __file__)
