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
    z_mm, slope_z
        The same along z.
    world_x_mm, world_y_mm, world_z_mm
        In the scene's world; of a placed needle in that of its dataset.
    load_n_per_mm, load_z_n_per_mm
        Lateral load of the tissue, + toward y and z.
    layer
        From 1; none before the tissue.
    """
    shape, tissue = moment.shape, moment.tissue
    whole = np.arange(np.ceil(shape.x[0]), shape.x[-1])
    near = np.abs(whole[:, None] - shape.x).min(axis=1) < _MIN_STATION_DISTANCE_MM
    s = np.union1d(shape.x, whole[~near])
    place = compute_positions(shape, s)
    world = (placement or scene.entry.placement).to_world(place)
    layer = pd.array(1 + np.searchsorted(tissue.boundaries, s), dtype="Int64")
    layer[s < 0] = pd.NA
    load, load_z = compute_lateral_load(shape, tissue, s, scene.rules)
    return pd.DataFrame(
        {
            "s_mm": s,
            **dict(zip(("x_mm", "y_mm", "z_mm"), place.T, strict=True)),
            "slope": _interpolate_slope(shape.x, shape.u, shape.slope, s),
            "slope_z": _interpolate_slope(shape.x, shape.w, shape.slope_z, s),
            **dict(zip(_WORLD_COLUMNS, world.T, strict=True)),
            "load_n_per_mm": load,
            "load_z_n_per_mm": load_z,
            "layer": layer,
        }
    )


def _interpolate_slope(x: Floats, u: Floats, slope: Floats, s: Floats) -> Floats:
    return scipy.interpolate.CubicHermiteSpline(x, u, slope)(s, 1)


def write_shape(scene: Scene, moment: NeedleState, path: Path, placement: Placement | None = None) -> None:
    """Write the table of a shape, .csv; ConfigError if the folder of `path` does not exist."""
    require_folder(path)
    write_csv(tabulate_shape(scene, moment, placement), path)
