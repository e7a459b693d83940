"""Where does a steered tip end, predicted again as it goes deeper?

    python studies/replay.py [--study guided_tip]

Each run left out is registered by its readings down to a depth, and its end is predicted from there. Beside
the model: the deflection of the last reading kept, the line through the last four, and the curves of the
study. Printed are mean absolute errors of the end, mm, how many ends lie in the 95 % interval, and its median
width, as a table in Markdown. The figure has the error of each end with its interval.
"""

import argparse
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

import needlefit

LAST = 4  #: readings whose line is extended
OUT = Path("reports")
KEYS = ["direction", "part", "run"]


def extend_readings(readings: pd.DataFrame, depth: float) -> pd.Series:
    """Return how far the end of one run is missed by its readings down to a depth alone, mm."""
    known, end = readings[readings["depth_mm"] <= depth + 1e-6], readings.iloc[-1]
    line = np.polyfit(known["depth_mm"][-LAST:], known["measured_mm"][-LAST:], 1)
    ends = {"last kept": known["measured_mm"].iloc[-1], "last four": np.polyval(line, end["depth_mm"])}
    return (pd.Series(ends) - end["measured_mm"]).abs()


def draw_errors(ends: pd.DataFrame, path: Path) -> None:
    """Save a figure of the errors of all ends with their intervals, the depths one below the other."""
    parts, directions = (sorted(ends[name].unique()) for name in ("part", "direction"))
    size = {"figsize": (6.5, 1.6 * len(parts)), "layout": "constrained", "sharex": True, "squeeze": False}
    figure, axes = plt.subplots(len(parts), len(directions), **size)
    for (direction, number), part in ends.groupby(["direction", "part"]):
        ax, depth = axes[parts.index(number), directions.index(direction)], part["registered_mm"].median()
        span = np.abs(part[["low_95_mm", "high_95_mm"]].sub(part["predicted_mm"], axis=0)).T
        ax.errorbar(range(len(part)), part["predicted_mm"] - part["measured_mm"], span, fmt=".", lw=0.8)
        ax.axhline(0, color="0.6", lw=0.8)
        ax.set(title=f"{direction}, readings to {depth:.0f} mm", ylabel="error (mm)", xticks=[])
    figure.savefig(path, dpi=150)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--study", default="guided_tip")
    study = parser.parse_args().study
    run = needlefit.validate(study)
    ends = run.frames["ends"]
    # runs are predicted again after each quarter of their readings, at about the same depths
    ends["part"] = ends.groupby(["direction", "run", "method"])["registered_mm"].rank()
    readings = run.frames["readings"].query("method == 'prediction'").sort_values("depth_mm")
    errors = (ends["predicted_mm"] - ends["measured_mm"]).abs()
    errors = errors.groupby([*(ends[key] for key in KEYS), ends["method"]]).first().unstack()
    of_runs = dict(iter(readings.groupby(["direction", "run"])))
    model = ends[ends["method"] == "prediction"].set_index(KEYS).sort_index()
    depths = model["registered_mm"]
    alone = {key: extend_readings(of_runs[key[0], key[2]], depth) for key, depth in depths.items()}
    errors = errors.join(pd.DataFrame(alone).T.rename_axis(KEYS))
    inside = model["measured_mm"].between(model["low_95_mm"], model["high_95_mm"])
    width = model["high_95_mm"] - model["low_95_mm"]
    print("| direction | readings to, mm |", " | ".join(errors.columns), "| in 95 % | width |")
    print("|---" * (len(errors.columns) + 4) + "|")
    for place, some in errors.groupby(level=KEYS[:2]):
        means = " | ".join(f"{mean:.2f}" for mean in some.mean())
        covered, wide, depth = inside[place].sum(), width[place].median(), depths[place].median()
        print(f"| {place[0]} | {depth:.0f} | {means} | {covered} of {len(some)} | {wide:.2f} |")
    OUT.mkdir(exist_ok=True)
    draw_errors(model.reset_index(), OUT / f"replay_{study}.png")


if __name__ == "__main__":
    main()
