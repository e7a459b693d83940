"""Write the dataset `thin_gel`: needles that compress a thin gel, where shapes depend on the exponent alpha.

    python studies/thin_gel.py --write DIR

Eight insertions into 5 mm of gel are simulated, with Ogden's law and the errors that they state; afterwards
the base of each needle moves across and compresses the gel by a millimetre or two. mu, alpha and b are drawn.
studies/recovery.py fits further truths.
"""

import argparse
from pathlib import Path

import numpy as np
import pandas as pd
from research.simulated_data import simulate_dataset

from needlefit.api import load_dataset

HEAD = """schema = 1
name = "thin_gel"
title = "Synthetic needles in a thin gel that their bases compress"
origin = "synthetic"
license = "CC0-1.0"
source = "python studies/thin_gel.py --write data/thin_gel"
notes = "Synthetic: no needle was ever inserted. The base of each needle moves across after the insertion."
needle = { name = "18 gauge", length_mm = 150.0, outer_diameter_mm = 1.27, youngs_modulus_gpa = 80.0 }
noise = { point_sd_mm = 0.01 }
centerlines = { pattern = "centerlines/{id}.csv" }
media = { gel = { boundaries_mm = [] } }
insertions = { file = "insertions.csv" }
"""
MOVED = ((32, 4), (36, 10), (40, -5), (43, -9), (46, 8), (49, 7), (52, -10), (55, -3))  # depth, base: mm
CELLS = {
    **{"medium": "gel", "specimen": "gel", "layers": 1, "pose_source": "stage"},
    **{"entry_x_mm": 0.0, "entry_z_mm": 0.0, "entry_dx": 1.0, "entry_dy": 0.0, "entry_dz": 0.0},
    **{"bevel_x": 0.0, "bevel_y": 1.0, "bevel_z": 0.0, "pose_shift_sd_mm": 0.02, "pose_angle_sd_deg": 0.05},
}


def write_truth(folder: Path, seed: int) -> Path:
    """Simulate a dataset into a folder; the same seed gives the same bytes."""
    rng = np.random.default_rng(seed)
    truth = {
        "mu1_pa": float(round(5e3 * np.exp(0.3 * rng.normal()), 1)),
        "alpha1": float(round(1.0 + 2.0 * rng.normal(), 3)),
        "bevel_mm": float(round(0.03 * np.exp(0.3 * rng.normal()), 5)),
    }
    insertions = [
        {"depth_mm": depth, "side": (-1) ** n, "base_moved_mm": moved}
        for n, (depth, moved) in enumerate(MOVED)
    ]
    data = {
        "title": "thin gel",
        "values": truth,
        "needle": {"length_mm": 150.0, "outer_diameter_mm": 1.27, "youngs_modulus_gpa": 80.0},
        "noise": {"point_sd_mm": 0.01, "registration_mean_mm": 0.032},
        "pose_angle_sd_deg": 0.05,
        "insertions": insertions,
    }
    made, rows = simulate_dataset(data, "thin_gel", seed), []
    (folder / "centerlines").mkdir(parents=True, exist_ok=True)
    for n, (one, about) in enumerate(zip(made.insertions, insertions, strict=True)):
        name = f"thin-{n + 1:02d}"
        points = one.points * [1.0, 1.0, 0.0]
        points += np.array([0.0, 6.0 * n, 0.0])
        pd.DataFrame(points, columns=["x_mm", "y_mm", "z_mm"]).to_csv(
            folder / f"centerlines/{name}.csv", index=False, float_format="%.4f"
        )
        own = {"depth_mm": about["depth_mm"], "bevel_side": about["side"], "entry_y_mm": 6.0 * n}
        rows.append({"id": name, "hole": name, **own, "base_moved_mm": about["base_moved_mm"], **CELLS})
    pd.DataFrame(rows).to_csv(folder / "insertions.csv", index=False)
    known = ", ".join(f"{name} = {value}" for name, value in truth.items())
    (folder / "dataset.toml").write_text(f"{HEAD}truth = {{ {known} }}\n")
    return folder


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", type=Path, required=True, help="a new folder for the dataset")
    options = parser.parse_args()
    print(load_dataset(write_truth(options.write, 1)).to_frame().to_string(index=False))


if __name__ == "__main__":
    main()
