"""Is what measured needles show out of their planes noise, or a bevel that rolled on its way?

    python studies/out_of_plane.py

Of the shapes in a gel: how far each is out of the plane nearest to it; what the stated noise alone would
give; how much a roll that grows with the depth explains of it, beside how much it explains of noise; and how
much a profile explains that all shapes have in common. What came out: docs/real_needles.md. The measured data
are in the folder that `NEEDLEFIT_REAL_DATA` names.
"""

import argparse

import numpy as np
import pandas as pd

import needlefit
from needlefit import Bevel, ModelOptions, Needle, Step, Tissue, compute_positions, simulate_steps
from needlefit.api import Dataset, load_dataset

DROPPED_MM = 10.0  # the source's spline has its end effects there
ROLL_DEG = 20.0  # from base to tip, of the needle whose shape out of the plane is taken for that by a roll
STEPS = 12  # in which this roll is made
DRAWS = 300
STATIONS = np.linspace(0.0, 90.0, 91)  # from the tip, where shapes are compared with each other, mm


def leave_plane(points: np.ndarray) -> np.ndarray:
    """Return how far points (..., N, 3) are out of the plane nearest to them, (..., N) mm."""
    centred = points - points.mean(axis=-2, keepdims=True)
    normal = np.linalg.svd(centred, full_matrices=False)[2][..., 2, :, None]
    away = (centred @ normal)[..., 0]
    return away * np.sign(np.sum(normal[..., 0] * [0, 0, 1], axis=-1))[..., None]


def roll_needle(needle: Needle, values: dict[str, float], depth: float, s: np.ndarray) -> np.ndarray:
    """Return how far the model's needle is out of its plane at `s` (N,), mm, if its bevel rolls evenly."""
    ends = depth * np.arange(1, STEPS + 1) / STEPS
    rolls = ROLL_DEG * (np.arange(STEPS) + 0.5) / STEPS
    steps = [
        Step(end, Bevel(values["bevel_mm"], roll_deg=roll)) for end, roll in zip(ends, rolls, strict=True)
    ]
    tissue = Tissue([1e-6 * values["mu1_pa"]], [values["alpha1"]], [])
    return leave_plane(compute_positions(simulate_steps(needle, tissue, steps, ModelOptions()), s))


def measure_shapes(
    dataset: Dataset, values: dict[str, float], rng: np.random.Generator
) -> tuple[pd.DataFrame, np.ndarray]:
    """Return a row for each shape, and their profiles out of the plane (shapes, stations), mm.

    A row has the rms out of the plane and that of noise, the roll from base to tip that fits (degrees), and
    which part of the squares it explains, of the shape and of noise.
    """
    rows, profiles = [], []
    for one in dataset.insertions:
        points = one.points
        along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
        kept = along >= DROPPED_MM
        away, s = leave_plane(points[kept]), along[kept]
        rolled = roll_needle(one.needle, values, one.depth, one.depth - (s[-1] - s))
        noise = dataset.noise.correlated_sd * np.linalg.cholesky(dataset.noise.correlate(s))
        drawn = leave_plane(points[kept] * [1, 1, 0] + noise @ rng.normal(size=(DRAWS, len(s), 3)))

        def explain(away: np.ndarray, rolled: np.ndarray = rolled) -> np.ndarray:
            return (away @ rolled) ** 2 / (rolled @ rolled) / np.sum(away**2, axis=-1)

        row = {"hole": one.specimen, "depth_mm": one.depth, "rms_mm": np.sqrt(np.mean(away**2))}
        row |= {
            "noise_mm": np.sqrt(np.mean(drawn**2)),
            "roll_deg": ROLL_DEG * (away @ rolled) / (rolled @ rolled),
        }
        rows.append(row | {"explained": explain(away), "of_noise": np.mean(explain(drawn))})
        profiles.append(np.interp(STATIONS, (s[-1] - s)[::-1], away[::-1]))
    return pd.DataFrame(rows), np.array(profiles)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.parse_args()
    try:
        dataset = load_dataset("stereo_shapes")
    except needlefit.errors.DataError as error:  # of data that are not there
        raise SystemExit(str(error)) from None
    fitted = needlefit.fit(dataset, "gel_stereo", recipe={"metric": False}).frames["parameters"]
    values = fitted.query("method == 'fitted'").set_index("parameter")["value"].to_dict()
    rows, profiles = measure_shapes(dataset, values, np.random.default_rng(1))
    print(rows.round(3).to_string(index=False))
    print(rows.drop(columns=["hole", "depth_mm"]).agg(["min", "mean", "max"]).round(3).to_string())
    rolls = rows.groupby("hole")["roll_deg"]
    print(f"rolls: SD within a hole {np.sqrt(rolls.var().mean()):.0f}, of the holes {rolls.mean().std():.0f}")
    total, common = np.sum(profiles**2), len(profiles) * np.sum(profiles.mean(axis=0) ** 2)
    singular = np.linalg.svd(profiles, compute_uv=False) ** 2
    print(f"explained by the mean profile {common / total:.2f}, by three {singular[:3].sum() / total:.3f}")


if __name__ == "__main__":
    main()
