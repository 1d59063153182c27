"""A map, and beside it the motion of the cell that is clicked on."""

from textwrap import fill
from typing import Any, cast

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.backend_bases import Event, MouseEvent
from matplotlib.figure import Figure

from ..maps.scene import Point, checked_point, motion, nearest, scene
from ..motion.trajectory import Trajectory
from ..numerics.numbers import instance
from .animation import MovingColumn, load_of
from .maps import map as draw_map
from .motions import time_history
from .style import VERMILLION

FRAME = 100  # milliseconds between two pictures of the moving column
SPEED = 2.0  # time units a second


class Explorer:
    """What `explore` shows: `figure`, its axes, and the `motion` of the last cell."""

    def __init__(
        self,
        dataset: xr.Dataset,
        variable: str,
        x: str,
        y: str,
        point: Point | None,
        **style: Any,
    ):
        """Draw the map, and wait for clicks."""
        instance("dataset", dataset, xr.Dataset)
        checked_point(dataset, point)  # before anybody clicks
        self.dataset, self.x, self.y, self.point = dataset, x, y, point
        self.motion: Trajectory | None = None
        self.figure: Figure = plt.figure(figsize=(12, 6), layout="constrained")
        mosaic: Any = [["map", "history", "history"], ["map", "phase", "column"]]
        self.axes = self.figure.subplot_mosaic(mosaic, width_ratios=[1.6, 1, 1])
        draw_map(dataset, variable, x, y, ax=self.axes["map"], **style)
        (self.mark,) = self.axes["map"].plot(
            [], [], "+", color=VERMILLION, ms=14, mew=2
        )
        self.axes["map"].set_title("click on a cell", loc="right", fontsize=9)
        self.axes["column"].set_axis_off()
        self._frame = 0
        self._column: MovingColumn | None = None
        self._timer = self.figure.canvas.new_timer(interval=FRAME)
        self._timer.add_callback(self._next)
        self.figure.canvas.mpl_connect("button_press_event", self._clicked)
        self.figure.canvas.mpl_connect("close_event", lambda _: self._timer.stop())

    def show(self, x: float, y: float) -> Trajectory:
        """Show the motion of the cell at these values, as a click on it does.

        **Raises:** `ValueError` as `motion`.
        """
        cell = {self.x: x, self.y: y}
        self.motion = motion(self.dataset, cell, point=self.point)
        column, _ = scene(self.dataset, cell, point=self.point)
        places = {dim: nearest(self.dataset, dim, at) for dim, at in cell.items()}
        here = self.dataset.isel(places)  # a sample has no value but its number
        at = [
            float(here[d]) if d in self.dataset.indexes else i
            for d, i in places.items()
        ]
        self.mark.set_data([at[0]], [at[1]])
        for name in ("history", "phase", "column"):
            self.axes[name].clear()
        time_history(self.motion, ax=[self.axes["history"], self.axes["phase"]])
        self.axes["history"].set_title(
            f"{self.x} = {at[0]:.4g}, {self.y} = {at[1]:.4g}"
        )
        self._column = MovingColumn(self.axes["column"], *load_of(column))
        self._frame = 0
        self._timer.start()
        self.figure.canvas.draw_idle()
        return self.motion

    def _clicked(self, event: Event) -> None:
        """Show the cell under the pointer, unless a tool of the window is in use."""
        mouse = cast(MouseEvent, event)
        toolbar = getattr(self.figure.canvas, "toolbar", None)
        if mouse.inaxes is not self.axes["map"] or getattr(toolbar, "mode", ""):
            return
        assert mouse.xdata is not None and mouse.ydata is not None
        title = self.axes["map"].set_title("", loc="right", fontsize=9)
        x, y = (
            at if dim in self.dataset.indexes else round(at)
            for dim, at in ((self.x, mouse.xdata), (self.y, mouse.ydata))
        )
        try:
            self.show(x, y)
        except ValueError as error:  # beside the cells, or a scene that is gone
            title.set_text(fill(str(error), 60))
            self.figure.canvas.draw_idle()

    def _next(self) -> None:
        """The next picture of the moving column."""
        if self.motion is None or self._column is None:
            return
        ts, phi = np.asarray(self.motion.ts), np.asarray(self.motion.phi)
        ts, phi = (a[np.isfinite(phi).all(axis=1)] for a in (ts, phi))
        if ts.size < 2:
            return
        step = max(1, round(FRAME / 1000 * SPEED / (ts[1] - ts[0])))
        self._frame = (self._frame + step) % (ts.size - 1)
        self._column.show(phi[max(0, self._frame - 100) : self._frame + 1])
        self.figure.canvas.draw_idle()


def explore(
    dataset: xr.Dataset,
    variable: str = "joint_amplitude",
    *,
    x: str,
    y: str,
    point: Point | None = None,
    **style: Any,
) -> Explorer:
    """Show a map; a click on a cell shows its motion beside it.

    ```python
    view = zj.plot.explore(ds.sel(joint=2, mu_k=0.1), x="q", y="mu_s")
    view.show(2.0, 0.1)  # as a click there does
    ```

    Beside the map stand the time history, the phase plane and the moving column. In a
    script call `matplotlib.pyplot.show()` after it, in Jupyter type `%matplotlib
    widget` before it (with the package `ipympl`), and keep what is returned.

    **Arguments:**

    - `dataset`, `variable`, `x`, `y`, `style`: as `map`.
    - `point`: as in `zj.scene`: the function of the sweep, where it is not known here.

    **Returns:** an `Explorer`.

    **Raises:** `ValueError` as `map`, and as `zj.scene` for a scene that is not there.
    """
    return Explorer(dataset, variable, x, y, point, **style)
