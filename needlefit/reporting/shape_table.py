"""Tabulate a needle's shape."""

from pathlib import Path

import numpy as np
import pandas as pd
import scipy

from needlefit.arrays import Floats
from needlefit.geometry.frames import Placement
from needlefit.mechanics.scene import Scene
from needlefit.mechanics.session import NeedleState
from needlefit.mechanics.shape import compute_positions
from needlefit.mechanics.simulate import compute_lateral_load
from needlefit.project.folders import require_folder
from needlefit.reporting.table_files import write_csv

_WORLD_COLUMNS = ("world_x_mm", "world_y_mm", "world_z_mm")
_MIN_STATION_DISTANCE_MM = 1e-6  # mm: a node so near a whole millimetre stands for it


def tabulate_shape(scene: Scene, moment: NeedleState, placement: Placement | None = None) -> pd.DataFrame:
    """Return one row for every node and every whole millimetre of the needle, base first.

    `placement` is where a measured needle lies.

    Columns
    -------
    s_mm
        Beam coordinate: arc length from the entry, negative before it.
    x_mm, y_mm, slope
        In the constraint frame C; y is the deflection, the slope dy/ds of the model.
    z_mm, slope_z, load_z_n_per_mm
        Of a needle in space: the same along z.
    world_x_mm, world_y_mm[, world_z_mm]
        In the scene's world; of a placed needle in that of its dataset, with z.
    load_n_per_mm
        Lateral load of the tissue, + toward y.
    layer
        From 1; none before the tissue.
    """
    shape, tissue = moment.shape, moment.tissue
    whole = np.arange(np.ceil(shape.x[0]), shape.x[-1])
    near = np.abs(whole[:, None] - shape.x).min(axis=1) < _MIN_STATION_DISTANCE_MM
    s = np.union1d(shape.x, whole[~near])
    place = compute_positions(shape, s)
    world = (placement or scene.entry).to_world(place)  # (K, 3) or (K, 2)
    layer = pd.array(1 + np.searchsorted(tissue.boundaries, s), dtype="Int64")
    layer[s < 0] = pd.NA
    load = np.atleast_2d(compute_lateral_load(shape, tissue, s, scene.rules))  # (1 or 2, K)
    table = pd.DataFrame(
        {
            "s_mm": s,
            "x_mm": place[:, 0],
            "y_mm": place[:, 1],
            "slope": _interpolate_slope(shape.x, shape.u, shape.slope, s),
            **dict(zip(_WORLD_COLUMNS, world.T, strict=False)),
            "load_n_per_mm": load[0],
            "layer": layer,
        }
    )
    if shape.w is not None and shape.slope_z is not None:
        table.insert(3, "z_mm", place[:, 2])
        table.insert(5, "slope_z", _interpolate_slope(shape.x, shape.w, shape.slope_z, s))
        table.insert(len(table.columns) - 1, "load_z_n_per_mm", load[1])
    return table


def _interpolate_slope(x: Floats, u: Floats, slope: Floats, s: Floats) -> Floats:
    found: Floats = scipy.interpolate.CubicHermiteSpline(x, u, slope)(s, 1)
    return found


def write_shape(scene: Scene, moment: NeedleState, path: Path, placement: Placement | None = None) -> None:
    """Write the table of a shape, .csv; ConfigError if the folder of `path` does not exist."""
    require_folder(path)
    write_csv(tabulate_shape(scene, moment, placement), path)
