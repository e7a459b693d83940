"""From the scanner to the insertion: how far scans of the twin, reconstructed whole, are from the truth.

    python benchmarks/scans.py [--seeds 5] [--first 101] [--jobs 2] [--json] [--rows FILE]

Every seed is another twin: 47 insertions in phantoms and chicken, each in a scanner of its own pose, noise,
bloom and streaks (`needlefit twin ct`), read back and sent through `needlefit reconstruct`'s own function.
Lengths in mm; a row a quantity: mean and 95 % of its errors, the goal, and the part of errors within one
stated standard deviation. `target` is how far the registration moves the true entry and tip, `predicted` its
ratio to what was predicted; `crossing` the error of a layer's depth where the surfaces are as stated,
`boundary` where the specimen's differ from them; `bevel` is in degrees.
"""

import argparse
import sys
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd

from needlefit.errors import DataError
from needlefit.geometry.crossings import find_crossings
from needlefit.geometry.curves import arc_length
from needlefit.imaging.reconstruct import reconstruct
from needlefit.project.tasks import LocalPool
from needlefit.synthetic.build import ReconstructedInsertion, centerline_errors, registration_errors
from needlefit.synthetic.design import PHANTOMS, PlannedInsertion, list_planned_insertions, make_surfaces
from needlefit.synthetic.scans import WHOLE_BOX_SETUP, make_recipe, render_insertion, write_layers

GOALS = {"target": 0.19, "crossing": 0.2}


def rows_of(task: tuple[int, PlannedInsertion], folder: Path) -> list[dict[str, object]]:
    """Return the errors of one insertion of one twin, a row each."""
    seed, planned = task
    place = folder / f"{seed}"
    scanned = render_insertion(place, planned, seed)
    try:
        built = ReconstructedInsertion(
            scanned.insertion, scanned.exposure, reconstruct(scanned.scan, make_recipe([WHOLE_BOX_SETUP]))
        )
    except DataError as error:
        return [{"seed": seed, "id": planned.id, "quantity": "failure", "message": str(error)}]
    finally:
        scanned.scan.volume.unlink()
    return [{"seed": seed, "id": planned.id} | row for row in [*_needle(built), *_layers(built)]]


def _needle(built: ReconstructedInsertion) -> list[dict[str, object]]:
    one, true = built.reconstruction, built.insertion.true_insertion
    off = registration_errors(built)[[0, -1]]
    tip = one.points[-1] - true.centerline[-1]
    along = float(tip @ one.frame.rotation[:, 0])
    bevel = one.patient.rotation @ one.needle_axis.bevel
    angle = np.degrees(np.arccos(np.clip(bevel @ true.frame.rotation[:, 1], -1, 1)))
    depth = one.depth - float(arc_length(true.centerline)[-1])
    return [
        *(
            {"quantity": "target", "error": e, "ratio": e / p}
            for e, p in zip(off, one.target_error, strict=True)
        ),
        {"quantity": "centerline", "error": float(centerline_errors(built).mean())},
        {"quantity": "tip", "error": float(np.linalg.norm(tip))},
        {"quantity": "tip along", "error": abs(along)},
        {"quantity": "depth", "error": abs(depth), "covered": abs(depth) <= one.depth_sd},
        {"quantity": "bevel", "error": float(angle)},
    ]


def _layers(built: ReconstructedInsertion) -> list[dict[str, object]]:
    one, true = built.reconstruction, built.insertion.true_insertion
    stated = find_crossings(true.centerline, make_surfaces(PHANTOMS[one.scan.medium]))
    found = []
    for name, points in (("crossing", stated.points), ("boundary", None)):
        depths = true.boundaries if points is None else true.frame.to_local(points)[:, 0]
        if len(depths) != len(one.layers.boundaries):
            continue  # an insertion that ends at a boundary may be read both ways
        for error, sd in zip(one.layers.boundaries - depths, one.layers.sd, strict=True):
            found.append({"quantity": name, "error": abs(float(error)), "covered": bool(abs(error) <= sd)})
    return found


def summary(rows: pd.DataFrame) -> pd.DataFrame:
    """Return a line for every quantity."""
    lines = []
    for name, group in rows[rows["quantity"] != "failure"].groupby("quantity", sort=False):
        error = group["error"]
        line = {"quantity": name, "n": len(group), "mean": error.mean(), "q95": error.quantile(0.95)}
        line |= {"goal": GOALS.get(str(name), np.nan), "predicted": np.nan, "covered": np.nan}
        if name == "target":
            line["predicted"] = group["ratio"].mean()
        if group["covered"].notna().any():
            line["covered"] = group["covered"].astype(float).mean()
        lines.append(line)
    return pd.DataFrame(lines)


def main() -> None:
    """Render, reconstruct, compare, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--first", type=int, default=101)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--rows", help="also write every error to this CSV")
    arguments = parser.parse_args()
    plan = list_planned_insertions()
    tasks = [
        (seed, one) for seed in range(arguments.first, arguments.first + arguments.seeds) for one in plan
    ]
    rows: list[dict[str, object]] = []
    with TemporaryDirectory() as folder:
        for seed in range(arguments.first, arguments.first + arguments.seeds):
            write_layers(Path(folder) / f"{seed}", plan)
        for n, found in LocalPool(arguments.jobs).run(partial(rows_of, folder=Path(folder)), tasks):
            rows += found
            if not n % 47:
                print(f"scan {n + 1} of {len(tasks)}", file=sys.stderr)
    frame = pd.DataFrame(rows).sort_values(["seed", "id"], kind="stable")
    if arguments.rows:
        frame.to_csv(arguments.rows, index=False)
    failures = frame[frame["quantity"] == "failure"]
    for _, line in failures.iterrows():
        print(f"failed: {line['seed']} {line['id']}: {line['message']}", file=sys.stderr)
    table = summary(frame)
    if arguments.json:
        print(table.to_json(orient="records", indent=2))
        return
    print(table.to_string(index=False, float_format=lambda x: f"{x:.3f}", na_rep=""))
    print(f"scans: {len(tasks)}   failures: {len(failures)}")


if __name__ == "__main__":
    main()
