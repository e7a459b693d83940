"""Whether the moduli and the bevel offset of scanned needles are covered when no modulus is tied to another.

    python benchmarks/measurement.py [--seeds 6] [--first 301] [--shipped] [--keep FOLDER] [--json]

Every seed is another twin: its nine insertions across the four layers of phantom 2 are rendered as CT
volumes and reconstructed (`needlefit twin ct`, `needlefit reconstruct`), or, with `--shipped`, are those of
data/twin. mu1 to mu4 and b are fitted free, once with the stored cross-sections (`stored`) and once with the
points of the centrelines (`points`), from three starts; intervals are Gauss-Newton. `unscanned` is the fit to
the true needles with the errors of the axis that scans leave (`needlefit.synthetic.build.build_unscanned`).
A row is a fit: how many of seeds x 5 parameters the 95 % intervals cover, the rms of errors over their
deviations, the median deviation of ln mu1, the median width of the intervals over that of `unscanned`, and
chi^2 of the residuals at the true parameters over their number.
"""

import argparse
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd
from scipy.optimize import least_squares

from needlefit.datasets.insertion import Dataset
from needlefit.datasets.read import read
from needlefit.imaging.assembly import assemble_dataset
from needlefit.imaging.reconstruct import reconstruct
from needlefit.imaging.reconstruction import Reconstruction
from needlefit.inference.problem import Problem, make_problem
from needlefit.project.locate import find_file
from needlefit.project.tasks import LocalPool, run_in_order
from needlefit.project.toml import load
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.recipe import LikelihoodRecord, WeightsRecord
from needlefit.synthetic.build import build_unscanned, describe_dataset
from needlefit.synthetic.design import PlannedInsertion, draw_specimen, list_planned_insertions
from needlefit.synthetic.insertion import TWIN_SEED
from needlefit.synthetic.scans import WHOLE_BOX_SETUP, make_recipe, render_insertion, write_layers

MEDIUM = "phantom2"
POINTS = LikelihoodRecord(measurement="points")
FITS = {"stored": (True, LikelihoodRecord()), "points": (True, POINTS), "unscanned": (False, POINTS)}
"""Whether the needles are scanned, and the likelihood."""
STARTS = (0.0, -0.7, 0.7)
"""Of the searches, in ln of every parameter from the truth."""
NORMAL = 1.96


@dataclass(frozen=True)
class Fit:
    """Values, errors of their logarithms and deviations (P,), and chi^2 per residual at the truth."""

    names: tuple[str, ...]
    values: np.ndarray
    errors: np.ndarray
    sds: np.ndarray
    chi2: float


def scan_needles(folder: Path, seed: int, jobs: int) -> Dataset:
    """Return the reconstructed four-layer insertions of the twin of `seed`, written into `folder`."""
    if not (folder / "dataset.toml").exists():
        plan = list_four_layer_insertions()
        with TemporaryDirectory() as scratch:
            write_layers(Path(scratch), plan)
            found = list(run_in_order(partial(_scan_one, Path(scratch), seed), plan, LocalPool(jobs)))
            assemble_dataset(folder, found, make_recipe([WHOLE_BOX_SETUP]), describe_dataset(seed))
    return read(folder)


def list_four_layer_insertions() -> list[PlannedInsertion]:
    """Return the planned insertions across all four layers."""
    return [one for one in list_planned_insertions() if one.medium == MEDIUM and one.layers == 4]


def _scan_one(folder: Path, seed: int, planned: PlannedInsertion) -> Reconstruction:
    scanned = render_insertion(folder, planned, seed)
    found = reconstruct(scanned.scan, make_recipe([WHOLE_BOX_SETUP]))
    scanned.scan.volume.unlink()
    return found


def untie(medium: MediumRecord) -> MediumRecord:
    """Return the medium with a modulus of its own for every layer."""
    free = medium.parameters["mu1_pa"]
    moduli = {f"mu{layer}_pa": free for layer in range(1, medium.layers + 1)}
    return medium.model_copy(update={"parameters": {**medium.parameters, **moduli}})


def true_values(seed: int) -> dict[str, float]:
    """Return the true moduli (Pa) and bevel offset (mm) of the phantom of `seed`."""
    specimen = draw_specimen(seed, MEDIUM, MEDIUM)
    moduli = {f"mu{n}_pa": 1e6 * float(mu) for n, mu in enumerate(specimen.mu, start=1)}
    return {**moduli, "bevel_mm": specimen.bevel}


def fit(dataset: Dataset, seed: int, likelihood: LikelihoodRecord) -> Fit:
    """Return the fit of free moduli and bevel offset to the four-layer insertions."""
    medium = untie(load(find_file("medium", MEDIUM), MediumRecord))
    insertions = [one for one in dataset.insertions if one.medium == MEDIUM and one.layers == 4]
    problem = make_problem(dataset, insertions, medium, WeightsRecord(), likelihood)
    truth = problem.parameters.theta(true_values(seed))
    theta = min((_descend(problem, truth + start) for start in STARTS), key=lambda end: end[0])[1]
    slopes = problem.jacobian(theta)[1]
    sds = np.sqrt(np.diag(np.linalg.inv(slopes.T @ slopes)))
    residuals = problem.residuals(truth)
    known = [problem.names.index(name) for name in true_values(seed)]
    chi2 = float(np.mean(residuals**2))
    return Fit(tuple(true_values(seed)), np.exp(theta)[known], (theta - truth)[known], sds[known], chi2)


def _descend(problem: Problem, start: np.ndarray) -> tuple[float, np.ndarray]:
    bounds = (problem.lower, problem.upper)
    start = np.clip(start, *bounds)
    found = least_squares(problem.residuals, start, lambda at: problem.jacobian(at)[1], bounds=bounds)
    return float(found.cost), found.x


def tabulate(fits: dict[str, list[Fit]]) -> pd.DataFrame:
    """Return a row for every fit."""
    rows, reference = [], np.array([one.sds for one in fits["unscanned"]])
    for name, some in fits.items():
        z = np.array([one.errors / one.sds for one in some])
        mu1 = [one.sds[0] for one in some]
        row = {"fit": name, "sets": len(some), "covered": int(np.sum(np.abs(z) < NORMAL))}
        row |= {"of": z.size, "rms_z": np.sqrt(np.mean(z**2)), "sd_ln_mu1": np.median(mu1)}
        row["width"] = np.median(np.array([one.sds for one in some]) / reference)
        rows.append(row | {"chi2": np.mean([one.chi2 for one in some])})
    return pd.DataFrame(rows)


def describe(one: Fit) -> str:
    """Return every parameter with its 95 % interval, in Pa and mm."""
    low, high = one.values * np.exp(-NORMAL * one.sds), one.values * np.exp(NORMAL * one.sds)
    triples = zip(one.names, one.values, low, high, one.errors / one.sds, strict=True)
    return "  ".join(f"{name} {at:.3g} [{a:.3g}, {b:.3g}] z {z:+.1f}" for name, at, a, b, z in triples)


def main() -> None:
    """Scan, fit, compare, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("--first", type=int, default=301)
    parser.add_argument("--shipped", action="store_true")
    parser.add_argument("--keep", type=Path, help="write the datasets here, and take what is there already")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    fits: dict[str, list[Fit]] = {name: [] for name in FITS}
    with TemporaryDirectory() as scratch:
        home = arguments.keep or Path(scratch)
        seeds = range(arguments.first, arguments.first + arguments.seeds)
        for seed in [TWIN_SEED] if arguments.shipped else seeds:
            scanned = (
                read(find_file("dataset", "twin"))
                if arguments.shipped
                else scan_needles(home / str(seed), seed, arguments.jobs)
            )
            unscanned = home / f"{seed}-unscanned"
            if not unscanned.exists():
                build_unscanned(unscanned, seed, list_four_layer_insertions())
            for name, (of_scans, likelihood) in FITS.items():
                fits[name].append(fit(scanned if of_scans else read(unscanned), seed, likelihood))
                if not arguments.json:
                    print(seed, name, describe(fits[name][-1]), flush=True)
    table = tabulate(fits)
    print(table.to_json(orient="records") if arguments.json else table.round(3).to_string(index=False))


if __name__ == "__main__":
    main()
