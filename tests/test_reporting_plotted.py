"""Beside every figure lies what it draws, as a table, and what is drawn stands in it."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from reporting_results import stereo, study

from needlefit.reporting import write
from needlefit.reporting.figures import style

AXES = {"boxplot": "y", "overlays": "xy", "residuals": "xy", "rivals": "x", "waterfall": "xy"}
"""Axes that hold data; the others hold places: of groups, rivals, parameters."""


@pytest.fixture
def painted(monkeypatch) -> dict[str, Figure]:
    """Figures by the name of their file, as they are painted."""
    found: dict[str, Figure] = {}
    draw = style.draw

    def keep(path: Path, paint) -> Path:
        def kept() -> Figure:
            found[path.stem] = paint()
            return found[path.stem]

        return draw(path, kept)

    monkeypatch.setattr(style, "draw", keep)
    return found


def drawn(axes: Axes) -> Iterator[np.ndarray]:
    """The points (N, 2) of lines, marks and bands that lie in the coordinates of the data."""
    for line in axes.get_lines():
        if line.get_transform() == axes.transData and len(line.get_xydata()):
            yield np.asarray(line.get_xydata(), dtype=float)
    for patch in axes.collections:
        if isinstance(patch, PolyCollection):
            yield np.concatenate([path.vertices for path in patch.get_paths()] or [np.empty((0, 2))])


def stands_in(table: pd.DataFrame, values: np.ndarray) -> np.ndarray:
    """Which values are among the table's numbers."""
    known = np.sort(table.select_dtypes("number").to_numpy(dtype=float).ravel())
    known = known[np.isfinite(known)]
    at = np.clip(np.searchsorted(known, values), 1, len(known) - 1)
    near = np.minimum(np.abs(known[at] - values), np.abs(known[at - 1] - values))
    return near <= 1e-6 * np.maximum(1.0, np.abs(values))


@pytest.mark.parametrize("results", [study(1), stereo()], ids=["study1", "stereo"])
def test_what_is_drawn_stands_in_the_table_beside(results, painted, tmp_path):
    folder = tmp_path / "run"
    write.write(results, folder)
    pictures = {path.stem for path in folder.glob("*.pdf")} - {"report"}
    assert pictures == set(painted) and {"boxplot", "overlays", "rivals", "waterfall"} <= pictures
    for name, figure in painted.items():
        table = pd.read_csv(folder / f"{name}.csv")
        assert set(table["origin"]) == {results.origin}
        for axis, column in (("x", 0), ("y", 1)):
            if axis in AXES[name]:
                for axes in figure.axes[:1] if name == "waterfall" else figure.axes:
                    for points in drawn(axes):
                        values = points[np.isfinite(points).all(axis=1), column]
                        values = values[
                            (values != 0) & (values != 1)
                        ]  # axes of symmetry, and where starts are equal
                        assert stands_in(table, values).all(), (name, axis)
