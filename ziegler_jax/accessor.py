"""What a dataset of a sweep can be asked by itself: `ds.zj.map(...)`."""

import importlib
from typing import Any

import xarray as xr

from .maps.scene import motion, scene


@xr.register_dataset_accessor("zj")
class Accessor:
    """The questions of this package to a dataset, as its methods.

    ```python
    ds.sel(joint=2, mu_k=0.1).zj.map("joint_amplitude", x="q", y="mu_s")
    column, start = ds.zj.scene(q=2.0, mu_s=0.1, mu_k=0.1)
    ```

    Each is the function of the same name with the dataset as its first argument:
    `motion`, `scene`; `map`, `bifurcation_diagram`, `up_down`, `branch`, `explore`,
    `page` of `zj.plot`.
    """

    def __init__(self, dataset: xr.Dataset):
        """Of this dataset."""
        self._dataset = dataset

    def motion(self, *args: Any, **options: Any):
        """`zj.motion` of a cell."""
        return motion(self._dataset, *args, **options)

    def scene(self, *args: Any, **options: Any):
        """`zj.scene` of a cell."""
        return scene(self._dataset, *args, **options)

    def map(self, *args: Any, **options: Any):
        """`zj.plot.map`."""
        return self._plot("map", *args, **options)

    def bifurcation_diagram(self, *args: Any, **options: Any):
        """`zj.plot.bifurcation_diagram`."""
        return self._plot("bifurcation_diagram", *args, **options)

    def up_down(self, *args: Any, **options: Any):
        """`zj.plot.up_down`."""
        return self._plot("up_down", *args, **options)

    def branch(self, *args: Any, **options: Any):
        """`zj.plot.branch`."""
        return self._plot("branch", *args, **options)

    def explore(self, *args: Any, **options: Any):
        """`zj.plot.explore`."""
        return self._plot("explore", *args, **options)

    def page(self, *args: Any, **options: Any):
        """`zj.plot.page`."""
        return self._plot("page", *args, **options)

    def _plot(self, name: str, *args: Any, **options: Any):
        plot = importlib.import_module(".plot", __package__)  # with matplotlib
        return getattr(plot, name)(self._dataset, *args, **options)
