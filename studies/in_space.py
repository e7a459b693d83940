"""Do the paper's studies predict otherwise when their needles are fitted and compared in space?

    python studies/in_space.py [--studies study1,study2,study3,study4,study5]

Each study is run in one plane and in space. Printed are mean tip errors of the predictive medians on held-out
insertions, and how many tips lie in their 95 % intervals, as the rows of a table in Markdown. What came out:
docs/studies.md, *Turned needles*.
"""

import argparse
import tomllib
from pathlib import Path

import needlefit
from needlefit.api import Run

STUDIES = "study1,study2,study3,study4,study5"
METRICS = ("te_mm", "te_3d_mm")  # tip error in the plane, and in space


def describe_errors(run: Run) -> str:
    """Return the mean tip errors of held-out insertions in the plane and in space."""
    errors = run.frames["errors"]
    held_out = errors[(errors["role"] == "validate") & (errors["boundaries"] == "measured")]
    means = held_out[held_out["method"] == "predictive_median"][[*METRICS]].mean()
    return ", ".join(f"{means[one]:.2f}" for one in METRICS)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--studies", default=STUDIES, help="names, with commas between them")
    print("| study | fitted in one plane | fitted in space | tips in 95 % (one plane, in space) |")
    print("|---|---|---|---|")
    for name in parser.parse_args().studies.split(","):
        study = tomllib.loads(Path(__file__).with_name(f"{name}.toml").read_text(encoding="utf-8"))
        flat, space = (needlefit.validate({**study, "planes": planes}, name=name) for planes in (1, 2))
        hits = [int(one.frames["predictive"]["tip_in_95"].sum()) for one in (flat, space)]
        covered = f"{hits[0]}, {hits[1]} of {len(space.frames['predictive'])}"
        print(f"| {name} | {describe_errors(flat)} | {describe_errors(space)} | {covered} |", flush=True)


if __name__ == "__main__":
    main()
