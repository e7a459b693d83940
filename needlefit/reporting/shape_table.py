"""Tabulate and draw a needle's shape."""

from pathlib import Path

import numpy as np
import pandas as pd
import scipy

from needlefit.arrays import Floats
from needlefit.errors import ConfigError
from needlefit.geometry.frames import Placement
from needlefit.mechanics.scene import Scene
from needlefit.mechanics.shape import NeedleShape, compute_positions
from needlefit.mechanics.simulate import compute_lateral_load

_WORLD_COLUMNS = ("world_x_mm", "world_y_mm", "world_z_mm")
_MIN_STATION_DISTANCE_MM = 1e-6  # largest distance (mm) from a whole millimetre of a node that stands for it


def tabulate_shape(scene: Scene, shape: NeedleShape, placement: Placement | None = None) -> pd.DataFrame:
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
    tissue = scene.tissue
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


def draw_shape(table: pd.DataFrame, path: Path) -> None:
    """Draw a tabulated needle and its load, in a colour for each layer; out of the plane too where it goes.

    ConfigError if the ending of `path` is neither .pdf nor .png.
    """
    # late: matplotlib takes its time to load
    from needlefit.reporting.figures import Panel
    from needlefit.reporting.figures.forms import curves
    from needlefit.reporting.figures.style import TEXT_WIDTH_IN, draw

    if path.suffix not in (".pdf", ".png"):
        fix = f"write to {path.stem or 'needle'}.pdf"
        raise ConfigError("is no figure", where=path, expected="a name that ends in .pdf or .png", fix=fix)
    columns = {"y (mm)": "y_mm", "load (N/mm)": "load_n_per_mm"}
    if table["z_mm"].any():
        columns |= {"z (mm)": "z_mm", "load along z (N/mm)": "load_z_n_per_mm"}
    panels = [Panel(label, column, column, column) for label, column in columns.items()]
    parts = table["layer"].map("layer {}".format, na_action="ignore").fillna("outside the tissue")
    frame, size = table.assign(part=parts), (TEXT_WIDTH_IN, 1.7 * len(panels))
    draw(path, lambda: curves(frame, "x_mm", "part", panels, "x along the entry (mm)", size=size))
