"""What a cohort of many synthetic insertions costs: insertions fitted per second, and memory.

    python benchmarks/cohort.py [--insertions 10000] [--datasets 100] [--jobs 2] [--out FOLDER] [--json]

Writes datasets of shapes with a known pose: one needle, one layer of gel, 40 to 60 mm deep, five insertions
of each specimen; modulus and bevel offset differ by specimen. `needlefit validate cohort.toml` fits them as
a process of its own, whose resident set, with that of its workers, is read every second. Errors of ln mu
and ln b are divided by the standard deviations that the fits state; their root mean square is 1 where these
are right.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd

from needlefit.mechanics.control import Bevel
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.shape import sample_inserted_points
from needlefit.mechanics.simulate import simulate
from needlefit.mechanics.tissue import Tissue

NEEDLE = Needle.from_tube(150.0, 1.27, 80e3)
OF_A_SPECIMEN = 5
POINTS = 21
SHIFT_SD, ANGLE_SD, POINT_SD = 0.05, 0.1, 0.05  # mm, degrees, mm
MODULUS, OFFSET = 0.02, 0.08  # medians over specimens, MPa and mm
SPREAD = 0.3  # standard deviation of both logarithms
ALONG_X = {"entry_x_mm": 0, "entry_y_mm": 0, "entry_z_mm": 0, "entry_dx": 1, "entry_dy": 0, "entry_dz": 0,
           "bevel_x": 0, "bevel_y": 1, "bevel_z": 0, "pose_source": "stage"}  # fmt: skip

DATASET = f"""schema = 1
name = "{{name}}"
title = "Synthetic cohort, part {{name}}"
origin = "synthetic"
license = "none"
source = "benchmarks/cohort.py"

[frame]
name = "gel"
pose = "known"

[needle]
name = "18G"
length_mm = 150.0
outer_diameter_mm = 1.27
youngs_modulus_gpa = 80.0

[noise]
correlated_sd_mm = {POINT_SD}
correlation_length_mm = 10.0

[insertions]
file = "insertions.csv"

[centerlines]
pattern = "centerlines/{{{{id}}}}.csv"

[media.gel]
boundaries_mm = []
"""

MEDIUM = """schema = 1
title = "Gel, one layer"
layers = 1

[parameters]
mu1_pa = { bounds = [1e2, 1e7] }
alpha1 = { fixed = 1.0 }
bevel_mm = { bounds = [1e-3, 1.0] }
"""

STUDY = """schema = 2
kind = "cohort"
datasets = ["specimens/*"]
medium = "gel"
recipe = "quick"
"""


def make_tissue(modulus: float) -> Tissue:
    """Return one layer of gel of this modulus, MPa."""
    return Tissue(mu=np.array([modulus]), alpha=np.array([1.0]), boundaries=np.array([]))


def write_dataset(folder: Path, insertions: int, rng: np.random.Generator) -> list[dict[str, float | str]]:
    """Write a dataset; return the true parameters of its specimens."""
    (folder / "centerlines").mkdir(parents=True)
    (folder / "dataset.toml").write_text(DATASET.format(name=folder.name), encoding="utf-8")
    along = np.linspace(0.0, 1.0, POINTS)
    rows: list[dict[str, float | str]] = []
    truth: list[dict[str, float | str]] = []
    for n in range(insertions):
        if n % OF_A_SPECIMEN == 0:
            modulus, offset = np.array([MODULUS, OFFSET]) * np.exp(SPREAD * rng.standard_normal(2))
            specimen = f"{folder.name}-{n // OF_A_SPECIMEN:04d}"
            truth.append({"specimen": specimen, "mu1_pa": 1e6 * modulus, "bevel_mm": offset})
        depth = float(rng.uniform(40.0, 60.0))
        shape = simulate(NEEDLE, make_tissue(modulus), Bevel(offset), depth)
        points = sample_inserted_points(shape, POINTS)
        correlation = np.exp(-0.5 * (np.subtract.outer(along, along) * depth / 10.0) ** 2) + 1e-9 * np.eye(
            POINTS
        )
        noise = np.linalg.cholesky(correlation) @ rng.standard_normal((POINTS, 2)) * POINT_SD
        turn, shift = np.radians(ANGLE_SD) * rng.standard_normal(), SHIFT_SD * rng.standard_normal(2)
        y = points[:, 1] + noise[:, 0] + shift[0] + turn * points[:, 0]
        x, name = points[:, 0] + shift[1], f"{specimen}-{n:05d}"
        pd.DataFrame({"x_mm": x, "y_mm": y, "z_mm": noise[:, 1]}).to_csv(
            folder / "centerlines" / f"{name}.csv", index=False, float_format="%.6f"
        )
        stated = {"pose_shift_sd_mm": SHIFT_SD, "pose_angle_sd_deg": ANGLE_SD}
        where = {"id": name, "medium": "gel", "specimen": specimen, "layers": 1, "depth_mm": round(depth, 6)}
        rows.append({**where, **ALONG_X, **stated})
    pd.DataFrame(rows).to_csv(folder / "insertions.csv", index=False)
    return truth


def run_cohort(folder: Path, jobs: int) -> tuple[float, pd.DataFrame]:
    """Fit the cohort in a process; return its processor seconds, and time and resident MiB every second."""
    line = f"-m needlefit validate cohort.toml -q --jobs {jobs} --out reports"
    command = [sys.executable, *line.split()]
    begin, used = time.perf_counter(), []
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    process = subprocess.Popen(command, cwd=folder, stdout=subprocess.DEVNULL)
    while process.poll() is None:
        used.append((time.perf_counter() - begin, sum(map(read_resident, list_descendants(process.pid)))))
        time.sleep(1.0)
    if process.returncode not in (0, 5):  # 5: some searches did not converge; the table marks them
        raise SystemExit(f"python {line} ended with exit code {process.returncode}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)  # its workers with it
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    used.append((time.perf_counter() - begin, 0.0))
    return spent, pd.DataFrame(used, columns=["seconds", "mib"])


def list_descendants(process: int) -> list[int]:
    """Return a process and all that it has started, directly or not."""
    found = [process]
    for one in found:
        try:
            children = Path(f"/proc/{one}/task/{one}/children").read_text(encoding="ascii")
        except OSError:  # it has ended
            continue
        found += [int(child) for child in children.split()]
    return found


def read_resident(process: int) -> float:
    """Return the resident set of a process, MiB; 0 if it has ended."""
    try:
        pages = int(Path(f"/proc/{process}/statm").read_text(encoding="ascii").split()[1])
    except OSError:
        return 0.0
    return pages * os.sysconf("SC_PAGESIZE") / 2**20


def find_errors(folder: Path, truth: pd.DataFrame) -> dict[str, float]:
    """Return the root mean square errors of ln mu and ln b, in stated standard deviations."""
    fits = pd.read_csv(folder / "reports" / "cohort" / "fits.csv")
    found = {}
    for name in ("mu1_pa", "bevel_mm"):
        both = fits[fits["parameter"] == name].merge(truth, on="specimen")
        errors = np.log(both["value"] / both[name]) / both["sd"]
        found[f"rms_error_in_sds_{name}"] = round(float(np.sqrt(np.mean(np.square(errors)))), 2)
    return found


def measure(folder: Path, insertions: int, datasets: int, jobs: int) -> dict[str, float]:
    """Write, fit and measure a cohort."""
    rng = np.random.default_rng(1)
    truth: list[dict[str, float | str]] = []
    for n in range(datasets):
        part = insertions // datasets + (n < insertions % datasets)
        truth += write_dataset(folder / "specimens" / f"{n:04d}", part, rng)
    (folder / "configs" / "media").mkdir(parents=True)
    (folder / "configs" / "media" / "gel.toml").write_text(MEDIUM, encoding="utf-8")
    (folder / "cohort.toml").write_text(STUDY, encoding="utf-8")
    spent, memory = run_cohort(folder, jobs)
    seconds = float(memory["seconds"].iloc[-1])
    half = memory["seconds"] < seconds / 2
    failures = pd.read_csv(folder / "reports" / "cohort" / "failures.csv")
    return {
        "insertions": insertions,
        "specimens": len(truth),
        "failed": len(failures),
        "seconds": round(seconds, 1),
        "insertions_per_s": round(insertions / seconds, 2),
        "processor_s_per_insertion": round(spent / insertions, 3),
        "mib_first_half": round(float(memory["mib"][half].max())),
        "mib_second_half": round(float(memory["mib"][~half].max())),
        **find_errors(folder, pd.DataFrame(truth)),
    }


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--insertions", type=int, default=10_000)
    parser.add_argument("--datasets", type=int, default=100)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument(
        "--out", type=Path, help="keep the datasets and results here (default: a temporary folder)"
    )
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        place = options.out or Path(folder)
        found = measure(place, options.insertions, options.datasets, options.jobs)
    print(
        json.dumps(found) if options.json else "\n".join(f"{name}  {value}" for name, value in found.items())
    )


if __name__ == "__main__":
    main()
