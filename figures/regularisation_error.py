r"""What smoothing dry friction costs in accuracy, into regularisation_error.png.

Left: the largest difference of an amplitude between the smoothed law and the set-valued
one, over load and v_smooth (tau = 0.026 in both joints, mu_s = mu_k); crosses: only one
of both laws comes to rest. Right: the observed order of convergence between
neighbouring v_smooth, median over the loads where both laws agree in their verdict.
"""

import colours
import matplotlib.pyplot as plt
import numpy as np
import style
from matplotlib.colors import LogNorm

import ziegler_jax as zj

TAU, KICK = 0.026, (0.0, 0.2)


def point(q, v_smooth, smooth=False):
    load = zj.ConstantLoad(1.0)
    law = zj.SetValuedCoulomb(TAU, pin_radius=1.0, load=load)
    column = zj.uniform_rods(q, friction=law.smoothed(v_smooth) if smooth else law)
    windows, method = zj.Windows(transient=300.0, max_windows=10), zj.Method(rtol=1e-8)
    start = zj.State(omega=KICK)
    return zj.settle(column, start, windows=windows, method=method, certify=False)


def main():
    q, v = np.linspace(1.2, 2.8, 33), np.geomspace(1e-3, 0.3, 9)
    variants = {"smoothed": {"smooth": True}}
    both = zj.compare(point, variants, q=q, v_smooth=v, progress=False)
    ds = both.sel(variant="smoothed")
    rods = np.abs(ds.rod_amplitude_difference.values).max(axis=-1)
    joints = np.abs(ds.joint_amplitude_difference.values).max(axis=-1)
    error = np.fmax(rods, joints)
    stuck = both.outcome.transpose("variant", "q", "v_smooth") == zj.CODE.stuck
    wrong = (stuck[0] != stuck[1]).values
    order = np.diff(np.log(np.where(wrong, np.nan, error)), axis=1) / np.diff(np.log(v))

    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4.2), layout="constrained")
    about = {"long_name": "largest amplitude error", "units": "rad"}
    plane = ds.drop_vars("outcome").assign(error=(("q", "v_smooth"), error, about))
    left.set_yscale("log")
    shades = {"norm": LogNorm(1e-4, 1.0), "cmap": "cividis"}
    zj.plot.map(plane, "error", x="q", y="v_smooth", ax=left, **shades)
    i, j = np.nonzero(wrong)
    left.plot(q[i], v[j], "kx", label="one law rests, the other flutters")
    left.set(xlabel="load $q = Fl/k$")
    left.set_ylabel(r"$v_{smooth}$ ($\sqrt{k/(ml^2)}$)")
    left.legend(loc="lower left", bbox_to_anchor=(0, 1))
    between = np.sqrt(v[1:] * v[:-1])
    low, middle, high = np.nanpercentile(order[q >= 2.0], [25, 50, 75], axis=0)
    right.fill_between(between, low, high, color=colours.BLUE, alpha=0.3, lw=0)
    right.plot(between, middle, "o-", color=colours.BLUE)
    right.set(xscale="log", ylabel="order of convergence")
    right.set_title(r"median and quartiles over $q \geq 2$", loc="left")
    right.set_xlabel(r"$v_{smooth}$ ($\sqrt{k/(ml^2)}$)")
    right.axhline(1.0, color="0.6", lw=1)
    figure.get_layout_engine().set(wspace=0.08)
    figure.suptitle(
        r"tanh law against set-valued friction, both joints "
        rf"$\tau_s = \tau_k = {TAU}\,k$; kick $\dot\varphi_2(0)$ = "
        rf"{KICK[1]} $\sqrt{{k/(m l^2)}}$",
        fontsize=11,
    )
    style.save(figure, __file__)
    print(np.c_[between, middle], int(wrong.sum()), "wrong verdicts of", wrong.size)


if __name__ == "__main__":
    main()
