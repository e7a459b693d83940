"""A small dataset for tests: simulated with the model itself, free of noise, its truth known exactly."""

import tomllib

import numpy as np

from needlefit import Bevel, Needle, Tissue, simulate
from needlefit.datasets.columns import InsertionRow
from needlefit.datasets.write import write_dataset
from needlefit.geometry.frames import make_entry_frame
from needlefit.geometry.surfaces import make_sheet
from needlefit.mechanics.shape import sample_inserted_points
from needlefit.schemas.dataset import DatasetRecord

MU = (0.3, 20.0)  # MPa
BEVEL = 0.09  # mm
INTERFACE = 18.0  # mm
DEPTHS = (24.0, 30.5, 36.25, 41.0)
NEEDLE = Needle.from_tube(150.0, 1.27, 80e3)


TABLES = """
schema = 1
name = "needles"
title = "Needles of the tests"
origin = "synthetic"
license = "MIT"
source = "made by a test"
needle = { length_mm = 150, outer_diameter_mm = 1.27, youngs_modulus_gpa = 80 }
noise = { registration_mean_mm = 0.19, point_sd_mm = 0.05 }
insertions.file = "insertions.csv"
centerlines.pattern = "centerlines/{id}.csv"
media.gel.surfaces = [{ file = "layers/gel.stl", kind = "sheet", into = 2 }]
"""


def build(folder, depths=DEPTHS, pose_source="stage"):
    """Write the dataset; the interface is flat and normal to the needles, so its depth is exact in C."""
    rows, curves = [], {}
    tissue = Tissue(mu=np.array(MU), alpha=np.array([1.0, -1.0]), boundaries=np.array([INTERFACE]))
    for n, depth in enumerate(depths):
        id_, side = f"needle-{n + 1}", (1, -1)[n % 2]
        origin, x, y = np.array([0.0, 3.0 * n, 0.0]), np.array([1.0, 0, 0]), np.array([0, 1.0, 0])
        points = sample_inserted_points(simulate(NEEDLE, tissue, Bevel(BEVEL, side), depth), 401)
        curves[id_] = make_entry_frame(origin, x, y).to_world(points)
        rows.append(
            InsertionRow(
                id=id_, medium="gel", layers=2, depth=depth, specimen=f"piece{n // 2 + 1}", side=side,
                entry=origin, direction=x, bevel=y, pose_source=pose_source,
            )
        )  # fmt: skip
    plane = make_sheet("gel", [INTERFACE, 0, 0], [1, 0, 0], 200.0, 2)
    record = DatasetRecord.model_validate(tomllib.loads(TABLES))
    return write_dataset(folder, record, rows, curves, {"layers/gel.stl": plane})
