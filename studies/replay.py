"""Where does a steered tip end, predicted again as it goes deeper?

    python studies/replay.py [--study guided_tip] [--depths 40,60,80]

Each run left out is placed by its readings down to a depth, and its end is predicted from there. Beside the
model: the deflection of the last reading kept, the line through the last four readings, and the curves of
the study. Printed are mean absolute errors of the end, mm, how many ends lie in the 95 % interval, and its
median width, as a table in Markdown. What came out: docs/real_needles.md, *Replay*.
"""

import argparse
import tomllib
from pathlib import Path

import numpy as np
import pandas as pd

import needlefit

LAST = 4  #: readings whose line is extended


def extend_readings(readings: pd.DataFrame) -> pd.Series:
    """Return the end of one run by its readings alone, mm."""
    known, end = readings[~readings["scored"]], readings["depth_mm"].max()
    slope, offset = np.polyfit(known["depth_mm"][-LAST:], known["measured_mm"][-LAST:], 1)
    return pd.Series({"last kept": known["measured_mm"].iloc[-1], "last four": offset + slope * end})


def replay(study: dict, depth: float) -> pd.DataFrame:
    """Return the errors of the ends, mm, by run and direction; `covered`, `width`: of 95 % intervals."""
    run = needlefit.validate({**study, "registration_depth_mm": depth}, name=f"replay-{depth:g}")
    keys = ["run", "direction"]
    ends = run.frames["runs"].pivot(index=keys, columns="method", values="tip_predicted_mm")
    fitted = run.frames["runs"].query("method == 'fitted'").set_index(keys)
    readings = run.frames["readings"].query("method == 'fitted'")
    ends = ends.join(readings.groupby(keys)[readings.columns.to_list()].apply(extend_readings))
    errors = ends.sub(fitted["tip_measured_mm"], axis=0).abs()
    return errors.assign(
        covered=fitted["tip_in_95"], width=fitted["tip_95_high_mm"] - fitted["tip_95_low_mm"]
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--study", default="guided_tip")
    parser.add_argument("--depths", default="40,60,80", help="mm, with commas between them")
    options = parser.parse_args()
    study = tomllib.loads(Path(__file__).with_name(f"{options.study}.toml").read_text(encoding="utf-8"))
    for n, depth in enumerate(map(float, options.depths.split(","))):
        errors = replay(study, depth)
        methods = errors.columns.drop(["covered", "width"])
        if not n:
            print("| to, mm | direction |", " | ".join(methods), "| in 95 % | width |")
            print("|---" * (len(methods) + 4) + "|")
        for direction, part in errors.groupby("direction"):
            means = " | ".join(f"{mean:.2f}" for mean in part[methods].mean())
            covered = f"{int(part['covered'].sum())} of {len(part)} | {part['width'].median():.2f}"
            print(f"| {depth:g} | {direction} | {means} | {covered} |", flush=True)


if __name__ == "__main__":
    main()
