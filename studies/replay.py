"""Where does a steered tip end, predicted again as it goes deeper?

    python studies/replay.py [--study guided_tip] [--depths 40,60,80]

Each run left out is placed by its readings down to a depth, and its end is predicted from there. Beside the
model: the deflection of the last reading kept, the line through the last four readings, and the curves of
the study. Printed are mean absolute errors of the end, mm, how many ends along y lie in the 95 % interval,
and its median width, as a table in Markdown.
"""

import argparse
import tomllib
from pathlib import Path

import numpy as np
import pandas as pd

import needlefit

LAST = 4  #: readings whose line is extended


def extend_readings(readings: pd.DataFrame) -> pd.Series:
    """Return how far the end of one run is missed by its readings alone, mm."""
    known, end = readings[~readings["scored"]], readings.iloc[-1]
    line = np.polyfit(known["depth_mm"][-LAST:], known["measured_mm"][-LAST:], 1)
    ends = {"last kept": known["measured_mm"].iloc[-1], "last four": np.polyval(line, end["depth_mm"])}
    return (pd.Series(ends) - end["measured_mm"]).abs()


def replay(study: dict, depth: float) -> tuple[pd.DataFrame, str]:
    """Return the errors of all ends, mm, by direction and run, and in words how 95 % intervals cover."""
    run = needlefit.validate({**study, "registration_depth_mm": depth}, name=f"replay-{depth:g}")
    readings, keys = run.frames["readings"].sort_values("depth_mm"), ["direction", "run"]
    ends = readings.groupby([*keys, "method"])[["predicted_mm", "measured_mm"]].last()
    errors = ends.diff(axis=1)["measured_mm"].abs().unstack()
    model = readings.query("method == 'prediction'").set_index(keys)
    alone = {key: extend_readings(part) for key, part in model.groupby(level=keys)}
    predicted = run.frames["predictive"]
    width = (predicted["tip_95_high_mm"] - predicted["tip_95_low_mm"]).median()
    covered = f"{int(predicted['tip_in_95'].sum())} of {len(predicted)} | {width:.2f}"
    return errors.join(pd.DataFrame(alone).T.rename_axis(keys)), covered


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--study", default="guided_tip")
    parser.add_argument("--depths", default="40,60,80", help="mm, with commas between them")
    options = parser.parse_args()
    study = tomllib.loads(Path(__file__).with_name(f"{options.study}.toml").read_text(encoding="utf-8"))
    for n, depth in enumerate(map(float, options.depths.split(","))):
        errors, covered = replay(study, depth)
        if not n:
            print("| readings to, mm | direction |", " | ".join(errors.columns), "| in 95 % | width |")
            print("|---" * (len(errors.columns) + 4) + "|")
        for direction, means in errors.groupby(level="direction").mean().iterrows():
            row = " | ".join(f"{mean:.2f}" for mean in means)
            print(
                f"| {depth:g} | {direction} | {row} | {covered if direction == 'y' else ' | '} |", flush=True
            )


if __name__ == "__main__":
    main()
