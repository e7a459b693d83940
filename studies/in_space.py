"""Do the paper's studies predict otherwise when their needles are fitted and compared in space?

    python studies/in_space.py [--studies study1,study2,study3,study4,study5]

Each study is run in one plane and in space. Printed are mean tip errors of our predictions on held-out
insertions, and how many tips lie in their 95 % intervals, as the rows of a table in Markdown. What came out:
docs/studies.md, *Turned needles*.
"""

import argparse
import tomllib
from pathlib import Path

import numpy as np

import needlefit
from needlefit.api import Run

STUDIES = "study1,study2,study3,study4,study5"


def describe_errors(run: Run) -> str:
    """Return the mean tip errors of held-out insertions in the plane and in space."""
    shapes = run.frames["shapes"]
    held_out = shapes[(shapes["role"] == "validate") & (shapes["boundaries"] == "measured")]
    tips = held_out[(held_out["method"] == "prediction") & (held_out["j"] == shapes["j"].max())]
    off = [tips[f"simulated_{axis}_mm"] - tips[f"measured_{axis}_mm"] for axis in "xyz"]
    return ", ".join(f"{np.linalg.norm(off[:count], axis=0).mean():.2f}" for count in (2, 3))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--studies", default=STUDIES, help="names, with commas between them")
    print("| study | fitted in one plane | fitted in space | tips in 95 % (one plane, in space) |")
    print("|---|---|---|---|")
    for name in parser.parse_args().studies.split(","):
        study = tomllib.loads(Path(__file__).with_name(f"{name}.toml").read_text(encoding="utf-8"))
        flat, space = (
            needlefit.validate({**study, "compared": compared}, name=name) for compared in ("plane", "space")
        )
        hits = [int(one.frames["predictive"]["tip_in_95"].sum()) for one in (flat, space)]
        covered = f"{hits[0]}, {hits[1]} of {len(space.frames['predictive'])}"
        print(f"| {name} | {describe_errors(flat)} | {describe_errors(space)} | {covered} |", flush=True)


if __name__ == "__main__":
    main()
