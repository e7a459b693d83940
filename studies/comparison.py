"""Is the nonlinear tissue law needed?

    python studies/comparison.py [--data twin,control] [--quick] [--out reports/comparison.png]

Ogden's law is compared with a linear and a neo-Hookean foundation by the log predictive density of held-out
needles. Folds of needles (repeats of one insertion together) are left out in turn; log p(fold | others) is
the evidence of all, less that of the others. The noise of the points is scaled by an estimated factor. A
law is ahead, or behind, if the 95 % interval of its sum over folds less Ogden's does not contain 0:
Student's, of the scatter over folds and the Monte Carlo errors of the evidences. "twin": insertions into
phantom 2. "stereo": measured shapes in gel (data/README.md). "control": needles of Ogden's law in thin gel
whose base moves, where the stretch is large: no difference elsewhere means something if one is found there.

What came out with --data control: docs/studies.md.
"""

import argparse
import math
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from research.fits import estimate_evidence
from research.simulated_data import simulate_dataset
from scipy.special import stdtrit

import needlefit

LAWS = ("ogden", "linear", "neo_hookean")
RECIPE = {"starts": 2, "likelihood": {"noise_scale": "estimated", "measurement": "points"}}
# the insertions, the tissue model and the number of folds
SOURCES = {"twin": ("phantom2", 8), "stereo": ("gel_stereo", 6), "control": ("thin_gel", 8)}
MOVED = ((32, 6), (36, 16), (40, -8), (43, -14), (46, 12), (49, 10), (52, -16), (55, -4))  # depth, base: mm
NOISE = {"registration_mean_mm": 0.178, "point_sd_mm": 0.0013, "correlated_sd_mm": 0.0129}
CONTROL = {
    "title": "Needles made with Ogden's law in thin gel, the base moved across",
    "values": {"mu1_pa": 3000.0, "alpha1": 8.0, "bevel_mm": 0.03},
    "needle": {"length_mm": 150.0, "outer_diameter_mm": 1.27, "youngs_modulus_gpa": 80.0},
    "noise": NOISE | {"correlation_length_mm": 7.5},  # as the twin's
    **{"pose_angle_sd_deg": 0.14, "depth_sd_mm": 0.12},
    "insertions": [
        {"depth_mm": depth, "side": (-1) ** number, "base_moved_mm": moved}
        for number, (depth, moved) in enumerate(MOVED)
    ],
}


def change_law(medium: dict, law: str) -> dict:
    """Return a tissue model of a law without alpha, or, for Ogden's, as it is."""
    alphas = {} if law == "ogden" else {"alpha"}
    parameters = {n: one for n, one in medium["parameters"].items() if n.rstrip("0123456789") not in alphas}
    return medium | {"law": law, "parameters": parameters}


def compare(source: str, folds: int | None = None) -> pd.DataFrame:
    """Return log p(fold | others) of every law and fold, with the Monte Carlo errors of both evidences."""
    medium, count = SOURCES[source]
    name, control = "stereo_shapes" if source == "stereo" else "twin", source == "control"
    data = simulate_dataset(CONTROL, medium, seed=1) if control else needlefit.load_dataset(name)
    table = data.to_frame().query("medium in ('phantom2', 'gel', 'made')")
    groups = table["insertion"].str.split("_").str[0] if source == "stereo" else table["insertion"]
    fold = groups.astype("category").cat.codes % (folds or count)
    rows = []
    for law in LAWS:
        changed = change_law(needlefit.load_medium(medium), law)
        if control and law == "ogden":  # what a compression test would have determined
            changed["parameters"]["alpha1"] = {"fixed": CONTROL["values"]["alpha1"]}
        found = {}
        for left_out in (-1, *range(folds or count)):  # -1: none
            tune = {"insertions": list(table["insertion"][fold != left_out])}
            found[left_out] = estimate_evidence(data, changed, tune=tune, recipe=RECIPE)
        whole = found.pop(-1)
        for left_out, others in found.items():
            density = whole["log_evidence"] - others["log_evidence"]
            errors = {"se_whole": whole["se"], "se_others": others["se"], "k": max(whole["k"], others["k"])}
            rows.append({"data": source, "law": law, "fold": left_out, "log_density": density, **errors})
    return pd.DataFrame(rows)


def summarize(rows: pd.DataFrame) -> pd.DataFrame:
    """Return the log density of each law less that of Ogden's, summed over folds; half its 95 % interval."""
    found = []
    for source, own in rows.groupby("data", sort=False):
        wide = own.pivot_table(index="fold", columns="law", values="log_density")
        count, drawn = len(wide), {}
        for law, one in own.groupby("law"):  # the error of the evidence of all is the same in all folds
            drawn[law] = math.hypot(count * one["se_whole"].iloc[0], np.linalg.norm(one["se_others"]))
        for law in LAWS[1:]:
            each = wide[law] - wide["ogden"]
            error = math.hypot(math.sqrt(count) * each.std(), drawn[law], drawn["ogden"])
            half = stdtrit(count - 1, 0.975) * error
            ahead = "ahead" if each.sum() > 0 else "behind"
            verdict = ahead if abs(each.sum()) > half else "no significant difference"
            found.append((source, law, count, each.sum(), half, own["k"].max(), verdict))
    return pd.DataFrame(found, columns=["data", "law", "folds", "difference", "half", "largest k", "verdict"])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", default="twin,control", help="of twin, stereo, control")
    parser.add_argument("--quick", action="store_true", help="the control alone, four folds")
    parser.add_argument("--out", type=Path, default=Path("reports/comparison.png"))
    options = parser.parse_args()
    sources = ["control"] if options.quick else options.data.split(",")
    rows = pd.concat([compare(source, 4 if options.quick else None) for source in sources])
    table = summarize(rows)
    print(table.to_string(index=False, float_format="%.2f"))
    figure, axes = plt.subplots(figsize=(5.5, 1 + 0.35 * len(table)), layout="constrained")
    axes.errorbar(table["difference"], range(len(table)), xerr=table["half"], fmt="o", capsize=3)
    axes.axvline(0, color="0.5", lw=0.8)
    axes.set(yticks=range(len(table)), yticklabels=table["data"] + ", " + table["law"])
    axes.set(xlabel="log predictive density minus that of Ogden's law (95 %)", xscale="symlog")
    axes.invert_yaxis()
    options.out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(options.out, dpi=150)
    print(f"Figure: {options.out}")


if __name__ == "__main__":
    main()
