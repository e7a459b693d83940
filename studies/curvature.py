"""How well do four curvature sensors give the shape of a needle?

    python studies/curvature.py [--media phantom2 ...] [--sd 1e-4] [--out reports/curvature.png]

Each needle of the synthetic dataset `twin` gets four sensors of curvature, as fibre-optic needles have them,
that read the true needle with an error. Parameters and shapes are estimated from these readings alone, and
compared with the centreline of the same needle from its scan. What came out: docs/studies.md, *Curvature*.
"""

import argparse
import shutil
from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from synthetic import simulate_twin_needle

import needlefit
from needlefit.api import Insertion, load_dataset

TWIN = Path(__file__).resolve().parent.parent / "data/twin"
SENSORS = np.array([0.1, 0.35, 0.6, 0.85])  # distances from the tip, in parts of the depth
STEP_MM = 1.0  # to both sides of a sensor, over which the true curvature is taken
LIKELIHOOD = {"measurement": "curvature"}
STUDY = {"schema": 2, "same_specimen": True, "compared": "space"}


def read_sensors(one: Insertion, sd: float, rng: np.random.Generator) -> pd.DataFrame:
    """Return what the sensors of a needle of the twin read, 1/mm, along y and z of its stated entry."""
    from_tip = SENSORS * one.depth
    s = (from_tip[:, None] + STEP_MM * np.array([-1.0, 0.0, 1.0])).ravel()
    points = one.frame.to_local(simulate_twin_needle(one.id, s))
    bent = np.diff(points.reshape(len(from_tip), 3, 3)[..., 1:], n=2, axis=1)[:, 0] / STEP_MM**2  # (4, 2)
    read = bent + sd * rng.normal(size=bent.shape)
    table = {"id": one.id, "s_mm": from_tip, "kappa_y_1_per_mm": read[:, 0]}
    return pd.DataFrame(table | {"kappa_z_1_per_mm": read[:, 1], "sd_1_per_mm": sd})


def write_sensors(folder: Path, sd: float) -> None:
    """Write the twin with sensors, and every needle a second time, by its centreline alone."""
    shutil.copytree(TWIN, folder, dirs_exist_ok=True)
    text = (folder / "dataset.toml").read_text().split("[checksums]")[0]  # of the files as they were
    (folder / "dataset.toml").write_text(
        text.replace("[insertions]", '[insertions]\ncurvature = "curvature.csv"')
    )
    rng = np.random.default_rng(1)
    read = [read_sensors(one, sd, rng) for one in load_dataset("twin").insertions]
    pd.concat(read).to_csv(folder / "curvature.csv", index=False)
    rows = pd.read_csv(folder / "insertions.csv", dtype=str).assign(hole=lambda row: row["id"])
    again = rows.assign(id=rows["id"] + "-shape")
    pd.concat([rows, again]).to_csv(folder / "insertions.csv", index=False)
    for name in rows["id"]:
        for kind, suffix in (("centerlines", "csv"), ("sections", "toml")):
            shutil.copy(folder / kind / f"{name}.{suffix}", folder / kind / f"{name}-shape.{suffix}")
        # of what the sensors stand on, the points count nowhere: fewer of them are no copy
        points = pd.read_csv(folder / f"centerlines/{name}.csv", dtype=str)
        points[::-1][::2][::-1].to_csv(folder / f"centerlines/{name}.csv", index=False)


def integrate_sensors(folder: Path, name: str) -> float:
    """Return the tip error, mm, of curvatures that are linear between sensors, from the stated entry."""
    (one,) = (one for one in load_dataset(folder).insertions if one.id == f"{name}-shape")
    read = pd.read_csv(folder / "curvature.csv").query("id == @name").sort_values("s_mm", ascending=False)
    s, tip = np.linspace(0.0, one.depth, 1001), []
    for axis in "yz":
        bent = np.interp(s, one.depth - read["s_mm"], read[f"kappa_{axis}_1_per_mm"])
        tip.append(np.trapezoid((one.depth - s) * bent, s))  # twice integrated
    return float(np.hypot(tip[0] - one.points[-1, 1], tip[1] - one.points[-1, 2]))


def compare_shapes(folder: Path, medium: str) -> pd.DataFrame:
    """Return a row for each needle: errors of its shape by its sensors, and whether the bands cover it."""
    names = [one.id for one in load_dataset("twin").insertions if one.medium == medium]
    study = STUDY | {"dataset": str(folder), "medium": medium}
    study |= {"tune": {"insertions": names}, "validate": [{"insertions": [f"{one}-shape" for one in names]}]}
    run = needlefit.validate(study, recipe={"metric": False, "likelihood": LIKELIHOOD})
    errors = run.frames["errors"].query("method == 'prediction'").set_index("insertion")
    columns = ["tip_in_50", "tip_in_95", "shape_in_50", "shape_in_95", "tip_crps_mm"]
    covered = run.frames["predictive"].set_index("insertion")[columns].astype(float)
    integrated = [integrate_sensors(folder, one) for one in names]
    found = errors[["te_mm", "ipe_mean_mm"]].join(covered)
    return found.assign(medium=medium, te_integrated_mm=integrated)


def predict_readings(folder: Path, medium: str) -> pd.DataFrame:
    """Return the readings of every second needle as predicted by a fit to the others."""
    names = [one.id for one in load_dataset("twin").insertions if one.medium == medium]
    study = STUDY | {"dataset": str(folder), "medium": medium}
    study |= {"tune": {"insertions": names[::2]}, "validate": [{"insertions": names[1::2]}]}
    return needlefit.validate(study, recipe={"metric": False}).frames["curvature"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--media", nargs="+", default=["phantom1", "phantom2", "phantom3", "chicken"])
    parser.add_argument("--sd", type=float, default=1e-4, help="error of a sensor, 1/mm")
    parser.add_argument("--out", type=Path, default=Path("reports/curvature.png"))
    options = parser.parse_args()
    with TemporaryDirectory() as temporary:
        write_sensors(Path(temporary), options.sd)
        rows = pd.concat([compare_shapes(Path(temporary), medium) for medium in options.media])
        readings = pd.concat([predict_readings(Path(temporary), medium) for medium in options.media])
    means = rows.groupby("medium").mean(numeric_only=True)
    print(means.assign(needles=rows.groupby("medium").size()).to_string(float_format="%.3f"))
    print(rows.mean(numeric_only=True).to_string(float_format="%.3f"))
    print(readings.groupby("direction")["kappa_in_95"].agg(["sum", "size"]))
    figure, axes = plt.subplots(figsize=(5, 4))
    for medium, some in rows.groupby("medium"):
        axes.plot(some["te_integrated_mm"], some["te_mm"], ".", label=medium)
    axes.axline((0, 0), slope=1, color="0.5", lw=0.8)
    axes.set(xlabel="tip error, mm: curvatures integrated", ylabel="fitted")
    axes.legend()
    options.out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(options.out, dpi=150, bbox_inches="tight")


if __name__ == "__main__":
    main()
