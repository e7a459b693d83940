"""How much does the second plane improve predictions where bevels are turned by 90 degrees on the way?

    python studies/turned.py [--truths 20] [--quick] [--write DIR] [--out reports/turned.png]

Of twelve insertions into gel, each with a turn of its bevel by 90 or 180 degrees, six are fitted, six
predicted, in space and projected on one plane. `--write DIR` writes one truth: `data/twin_turned`.
"""

import argparse
import json
from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

import needlefit
from needlefit import Bevel, ModelOptions, Needle, Step, Tissue, compute_positions, simulate_steps
from needlefit.api import load_dataset

RIGIDITY = Needle.from_tube(150.0, 1.27, 80e3).flexural_rigidity
HEAD = """schema = 1
name = "twin_turned"
title = "Synthetic needles that were turned on the way"
origin = "synthetic"
license = "CC0-1.0"
source = "python studies/turned.py --write data/twin_turned"
notes = "Synthetic: no needle was ever inserted. Each bevel is turned once, by 90 or 180 degrees."
needle = { name = "18 gauge", length_mm = 150.0, outer_diameter_mm = 1.27, youngs_modulus_gpa = 80.0 }
noise = { point_sd_mm = 0.05 }
centerlines = { pattern = "centerlines/{id}.csv" }
media = { gel = { boundaries_mm = [25.0] } }
insertions = { file = "insertions.csv", turns = "turns.csv" }
"""
CELLS = {
    **{"medium": "gel", "specimen": "gel", "layers": 2, "entry_x_mm": 0.0, "entry_dx": 1.0, "entry_dy": 0.0},
    **{"entry_dz": 0.0, "bevel_x": 0.0, "bevel_y": 1.0, "bevel_z": 0.0, "pose_source": "stage"},
    **{"entry_z_mm": 0.0, "pose_shift_sd_mm": 0.1, "pose_angle_sd_deg": 0.1, "boundary_sd_mm": 0.2},
}


def write_truth(folder: Path, seed: int) -> Path:
    """Simulate a dataset into a folder; the same seed gives the same bytes."""
    rng = np.random.default_rng(seed)
    needle = Needle(150.0, RIGIDITY * (1 + rng.choice([-1, 1]) * rng.uniform(0.02, 0.05)))
    mu = np.array([0.4, 4.0]) * np.exp(0.5 * rng.normal(size=2))
    bevel, rows, turns = 0.1 * np.exp(0.3 * rng.normal()), [], []
    (folder / "centerlines").mkdir(parents=True, exist_ok=True)
    for n in range(12):
        name, depth, contact = f"turned-{n + 1:02d}", 55.0 + 2.5 * n, 30 * int(rng.integers(12))
        at, by = depth * rng.uniform(0.35, 0.65), int(rng.choice([-90, 90, 90, 180]))
        own, interface = mu * np.exp(0.03 * rng.normal(size=2)), 25.0 + 0.2 * rng.normal()
        roll = contact + 5.0 * rng.normal()  # the true one, of which the stated one errs
        offset = bevel * np.exp(0.05 * rng.normal())
        bevels = [Bevel(offset, roll_deg=roll), Bevel(offset, roll_deg=roll + by)]
        steps = [Step(end, one) for end, one in zip((at, depth), bevels, strict=True)]
        tissue, options = Tissue(own, [1.0, 1.0], [interface]), ModelOptions(element=0.25)
        s = np.linspace(0.0, depth, int(depth / 2) + 1)
        points = compute_positions(simulate_steps(needle, tissue, steps, options), s)
        bend = np.linalg.norm(points[-1, 1:])  # the needle also bends out of its plane, by some percent of it
        points[:, 1:] += 0.03 * bend * np.outer((s / depth) ** 2, rng.normal(size=2))
        points[:, 1:] += 0.1 * rng.normal(size=2) + np.outer(s, np.radians(0.1) * rng.normal(size=2))
        points += [0.0, 6.0 * n, 0.0] + 0.05 * rng.normal(size=points.shape)
        table = pd.DataFrame(points, columns=["x_mm", "y_mm", "z_mm"])
        table.to_csv(folder / f"centerlines/{name}.csv", index=False, float_format="%.4f")
        own = {"id": name, "hole": name, "depth_mm": depth, "bevel_roll_deg": contact}
        rows.append({**own, "entry_y_mm": 6.0 * n, **CELLS})
        turns.append({"id": name, "depth_mm": round(at, 2), "bevel_roll_deg": contact + by})
    pd.DataFrame(rows).to_csv(folder / "insertions.csv", index=False)
    pd.DataFrame(turns).to_csv(folder / "turns.csv", index=False)
    (folder / "dataset.toml").write_text(HEAD)
    truth = {"seed": seed, "mu_pa": (1e6 * mu).round(1).tolist(), "bevel_mm": round(float(bevel), 5)}
    (folder / "truth.json").write_text(json.dumps(truth, indent=1) + "\n")
    return folder


def predict_half(folder: Path, compared: str) -> pd.DataFrame:
    """Return one row per predicted needle: errors of our prediction in space, and coverage."""
    names = [f"turned-{n:02d}" for n in range(1, 13)]
    study = {"schema": 2, "dataset": str(folder), "medium": "turned", "same_specimen": True}
    study |= {"compared": compared, "tune": {"insertions": names[::2]}}
    study["validate"] = [{"insertions": names[1::2]}]
    run = needlefit.validate(study, recipe={"metric": False})
    shapes = run.frames["shapes"].query("method == 'prediction'").set_index("insertion")
    off = [shapes[f"simulated_{axis}_mm"] - shapes[f"measured_{axis}_mm"] for axis in "xyz"]
    space = pd.Series(np.linalg.norm(off, axis=0), shapes.index).groupby(level=0, sort=False)
    errors = pd.DataFrame({"te_in_space_mm": space.last(), "mean_in_space_mm": space.mean()})
    covered = run.frames["predictive"].set_index("insertion")[["tip_in_50", "tip_in_95", "tip_crps_mm"]]
    return errors.join(covered.astype(float)).assign(compared=compared)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--truths", type=int, default=20)
    parser.add_argument("--quick", action="store_true", help="one truth")
    parser.add_argument("--write", type=Path, help="write the dataset of one truth, and end")
    parser.add_argument("--out", type=Path, default=Path("reports/turned.png"))
    options = parser.parse_args()
    if options.write:
        print(load_dataset(write_truth(options.write, 1)).to_frame().to_string(index=False))
        return
    parts, truths = [], 1 if options.quick else options.truths
    for seed in range(101, 101 + truths):
        with TemporaryDirectory() as folder:
            known = write_truth(Path(folder), seed)
            parts += [predict_half(known, one).assign(truth=seed) for one in ("plane", "space")]
    rows = pd.concat(parts)
    means = rows.groupby(["compared", "truth"]).mean(numeric_only=True).groupby("compared")
    print(means.agg(["mean", "sem"]).to_string(float_format="%.3f"))
    figure, axes = plt.subplots(figsize=(5, 4))
    axes.plot(*(rows.query("compared == @one")["te_in_space_mm"] for one in ("plane", "space")), ".")
    axes.axline((0, 0), slope=1)
    axes.set(xlabel="TE in space, mm: fitted in one plane", ylabel="fitted in space")
    options.out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(options.out, dpi=150, bbox_inches="tight")


if __name__ == "__main__":
    main()
