"""How often the 95 % intervals contain mu and b where the entry is the first point of the inserted needle.

    python benchmarks/first_point_entry.py [--truths 20] [--seed 1] [--jobs 2] [--entries first 0,0,0]

Every truth (mu 10 kPa to 1 MPa and b 0.03 to 0.1 mm, log-uniform; 18 and 22 gauge in turn) gives six needles
of 40 to 90 mm with the bevel on either side, whose base stands on the x axis. A point is measured every 4 to
5 mm of the inserted needle, with the noise of `POINT_SD_MM`, and each stage errs by `ANGLE_SD_DEG` about its
entry. The first point has moved with the needle. The table of points is imported with each of the `entries`,
and fitted by the default recipe.
"""

import argparse
import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd

import needlefit
from needlefit.mechanics.control import Bevel
from needlefit.mechanics.needle import Needle, compute_rigidity
from needlefit.mechanics.shape import compute_positions
from needlefit.mechanics.simulate import simulate
from needlefit.mechanics.tissue import Tissue
from needlefit.project.unit_warnings import GAUGES_MM

DEPTHS_MM = (40.0, 50.0, 60.0, 70.0, 80.0, 90.0)
GAUGES = (18, 22)
LENGTH_MM, STEEL_MPA = 150.0, 200e3
POINT_SD_MM, ANGLE_SD_DEG, SPACING_MM = 0.03, 0.1, 4.5
RANGES = {"mu1_pa": (1e4, 1e6), "bevel_mm": (0.03, 0.1)}
ENTRIES = ("first", "0,0,0")


def measure_needles(truth: dict[str, float], gauge: int, rng: np.random.Generator) -> pd.DataFrame:
    """Return the table of the measured points (mm) of six needles with the true parameters."""
    needle = Needle(LENGTH_MM, compute_rigidity(GAUGES_MM[gauge], STEEL_MPA))
    tissue, tables = Tissue(truth["mu1_pa"] * 1e-6, alpha=1.0), []
    for number, depth in enumerate(DEPTHS_MM):
        side = 1 - 2 * (number % 2)
        shape = simulate(needle, tissue, Bevel(offset=truth["bevel_mm"], side=side), depth)
        s = np.linspace(0.0, depth, 1 + round(depth / SPACING_MM))
        points = compute_positions(shape, s)
        points[:, 1:] += np.radians(ANGLE_SD_DEG) * rng.standard_normal(2) * points[:, :1]
        x, y, z = (points + POINT_SD_MM * rng.standard_normal(points.shape)).T
        tables.append(pd.DataFrame({"needle": f"n{number}", "x": x, "y": y, "z": z, "bevel side": side}))
    return pd.concat(tables)


def fit_needles(file: Path, gauge: int, entry: str) -> pd.DataFrame:
    """Return the parameters that a fit to an imported table of points finds."""
    stated = {"pose": "1,0,0", "bevel": "0,1,0", "point_sd": POINT_SD_MM, "diameter": f"{gauge}G"}
    stated |= {"needle_length": LENGTH_MM, "pose_angle_sd": ANGLE_SD_DEG, "entry_point": entry}
    folder = file.parent / f"data-{entry.replace(',', '-')}"
    options = ["--yes", "--out", str(folder)]
    for key, value in stated.items():
        options += ["--set", f"{key}={value}"]
    command = [sys.executable, "-m", "needlefit", "import", str(file), *options]
    subprocess.run(command, check=True, capture_output=True)
    run = needlefit.fit(str(folder), str(folder / "tissue.toml"))
    return run.frames["parameters"].query("method == 'fitted'").set_index("parameter")


def fit_truth(number: int, seed: int, entries: tuple[str, ...]) -> list[dict[str, object]]:
    """Return a row for each entry point and parameter of one truth."""
    rng = np.random.default_rng([seed, number])
    truth = {name: float(np.exp(rng.uniform(*np.log(ends)))) for name, ends in RANGES.items()}
    gauge, rows = GAUGES[number % len(GAUGES)], []
    with TemporaryDirectory() as folder:
        file = Path(folder) / "needles.csv"
        measure_needles(truth, gauge, rng).to_csv(file, index=False)
        for entry in entries:
            fitted = fit_needles(file, gauge, entry)
            for name, value in truth.items():
                median, low, high = fitted.loc[name, ["median", "interval_low", "interval_high"]]
                row = {"truth": number, "gauge": gauge, "entry": entry, "parameter": name, "value": value}
                rows.append(row | {"median": median, "low": low, "high": high})
    return rows


def summarize(rows: pd.DataFrame) -> pd.DataFrame:
    """Return how many intervals contain the truth, the bias and the median width, as factors."""
    rows = rows.assign(
        covered=(rows["low"] <= rows["value"]) & (rows["value"] <= rows["high"]),
        bias=np.log(rows["median"] / rows["value"]),
        width=np.log(rows["high"] / rows["low"]),
    )
    kinds = rows.groupby(["entry", "parameter"], sort=False)
    found = kinds.agg(covered=("covered", "sum"), truths=("covered", "size"))
    return found.assign(bias=np.exp(kinds["bias"].median()), width=np.exp(kinds["width"].median()))


def main() -> None:
    """Print every interval, and the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--truths", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--entries", nargs="+", default=ENTRIES)
    options = parser.parse_args()
    work = partial(fit_truth, seed=options.seed, entries=tuple(options.entries))
    with ProcessPoolExecutor(options.jobs, mp_context=get_context("spawn")) as pool:
        rows = pd.DataFrame([row for some in pool.map(work, range(options.truths)) for row in some])
    print(rows.to_string(index=False, float_format="{:.4g}".format))
    print(summarize(rows).to_string(float_format="{:.3g}".format))


if __name__ == "__main__":
    main()
