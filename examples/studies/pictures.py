"""The pictures of both studies."""

import matplotlib.pyplot as plt
import numpy as np
from scipy.stats import norm

import ziegler_jax as zj

WIDTH = (13, 4)
# Okabe and Ito's, which the colour-blind can tell apart
BLUE, VERMILLION, ORANGE, SKY = "#0072B2", "#D55E00", "#E69F00", "#56B4E9"
COLOURS = (BLUE, VERMILLION, "#009E73", "#CC79A7", ORANGE, SKY, "#000000")


def of_distribution(ds, loads, values, shares):
    """The probability of flutter, the onset loads, and what they hang on."""
    figure, (left, middle, right) = plt.subplots(1, 3, figsize=WIDTH)
    ds = ds[["probability"]]
    zj.plot.map(ds, "probability", "q", "mu", ax=left, cmap="cividis")
    share = ds.probability.transpose("mu", "q")
    lines = {"colors": ["w", "k", "k"], "linewidths": 1}
    left.contour(ds.q, ds.mu, share, [0.05, 0.5, 0.95], **lines)
    left.set(xlabel="load $q = Fl/k$", ylabel=r"mean kinetic friction $\bar\mu_k$")
    left.set_title("Lines: 5, 50 and 95 %", loc="left")
    slopes, at = loads.slopes.values[-1], float(loads.onset_load[-1])
    width = np.linalg.norm(slopes)
    q = np.linspace(values.min() - width, values.max() + width, 200)
    look = {"density": True, "color": SKY, "label": "sampled"}
    middle.hist(values.ravel(), bins=30, **look)
    middle.plot(q, norm.pdf(q, at, width), "k", label="by derivatives")
    top = 1.3 * middle.get_ylim()[1]  # the legend is above
    middle.set(xlabel="onset load", ylabel="density", ylim=(0, top))
    middle.set_title(r"Where the kick starts flutter, $\bar\mu_k = 0.2$", loc="left")
    middle.legend(loc="upper left", fontsize=11, borderaxespad=0)
    place, look = np.arange(3), {"width": 0.27, "capsize": 3}
    for shift, name, colour, label in (
        (-0.27, "S1", BLUE, "first order"),
        (0.0, "ST", ORANGE, "total"),
    ):
        error = shares[f"{name}_conf"]
        style = look | {"color": colour, "label": label, "yerr": error}
        right.bar(place + shift, shares[name], **style)
    style = {"width": 0.27, "color": "k", "label": "by derivatives"}
    right.bar(place + 0.27, slopes**2 / width**2, **style)
    texts = ["friction\nof joint 1", "friction\nof joint 2", "static over\nkinetic"]
    right.set_xticks(place, texts)
    right.set_title("Shares of its variance", loc="left")
    right.legend()
    return finished(figure, middle, right)


def of_fits(run, sigma, scores, values):
    """A measured history, the spread of estimates, and Fisher's eigenvalues."""
    shape = {"figsize": WIDTH, "width_ratios": (1.5, 1.1, 0.8)}
    figure, (left, middle, right) = plt.subplots(1, 3, **shape)
    times, angles = np.asarray(run.ts), np.asarray(run.phi)
    noisy = angles + sigma * np.random.default_rng(0).normal(size=angles.shape)
    for i, mark in ((0, "o"), (1, "s")):
        look = {"color": COLOURS[i], "label": rf"$\varphi_{i + 1}$"}
        left.plot(times, noisy[:, i], mark, ms=2.5, **look)
        left.plot(times, angles[:, i], color=COLOURS[i], lw=0.8)
    count = int(run.events.count)
    starts = np.asarray(run.events.times)[:count]
    sticks = np.asarray(run.events.modes)[:count] == 0
    low = angles.min() - 0.1 * np.ptp(angles)
    for joint in (0, 1):
        ends = np.append(starts[1:], times[-1])
        bars = np.stack([starts, ends - starts], axis=1)[sticks[:, joint]]
        height = 0.04 * np.ptp(angles)
        place = (low - 1.5 * joint * height, height)
        left.broken_barh(bars, place, color=COLOURS[joint])
    left.set(xlabel=r"time ($\sqrt{ml^2/k}$)", ylabel="angle (rad)")
    left.set_title("Measured at 40 dB; bars: joint 1, 2 sticks", loc="left")
    left.legend(loc="upper left", ncols=2, markerscale=2)
    grid = np.linspace(-4, 4, 33)
    for i, name in enumerate((r"$\tau_s$", r"$\tau_k$", "$c_1$", "$c_2$")):
        density, _ = np.histogram(scores[:, i], grid, density=True)
        look = {"color": COLOURS[i], "marker": "osD^"[i], "ms": 4, "lw": 0.8}
        middle.plot((grid[1:] + grid[:-1]) / 2, density, label=name, **look)
    middle.plot(grid, norm.pdf(grid), "k", lw=1.5, label="bound")
    middle.set(xlabel="error of the estimate over the bound", ylabel="density")
    middle.set_title(f"{len(scores)} fits beside Cramer and Rao's bound", loc="left")
    middle.legend(loc="upper left", fontsize=11, handlelength=1, borderaxespad=0)
    share = np.maximum(np.abs(values[::-1]) / values[-1], 1e-18)
    right.bar(np.arange(1, 6), share, color=[BLUE] * 4 + [VERMILLION])
    right.set(yscale="log", ylabel="over the largest", xticks=np.arange(1, 6))
    right.set_xlabel(r"eigenvalue for $\mu_s, \mu_k, \rho, c_1, c_2$")
    right.set_title("Fisher's matrix", loc="left")
    return finished(figure, left, middle, right)


def finished(figure, *axes):
    """Without the frames that say nothing."""
    for ax in axes:
        ax.spines[["top", "right"]].set_visible(False)
    figure.tight_layout()
    return figure
