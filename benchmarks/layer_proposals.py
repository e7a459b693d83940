"""How well `needlefit reconstruct --layers auto` proposes the layers of the volumes of `real_scanners.py`.

    python benchmarks/layer_proposals.py --cache FOLDER [--part tuning] [--out FILE]

Needle and entry are found as the program finds them. Every volume has two interfaces (gel, water, muscle: 40
HU apart). An interface is found if a proposal lies within 3 mm of where the true needle crosses it; any other
proposal is spurious. Errors in mm along the needle, against the truth in the scan: registration has no part.
"""

import argparse
from pathlib import Path

import numpy as np
import pandas as pd
from real_scanner_scenes import Case, make_case, read_design, render_cached
from real_scanners import make_recipe

from needlefit.errors import NeedlefitError
from needlefit.geometry.curves import arc_length
from needlefit.imaging.entry import EntryKnowledge, choose_entry
from needlefit.imaging.layer_proposal import propose_layers
from needlefit.imaging.needle.centerline import trace_needle
from needlefit.imaging.needle.segmentation import select_needle
from needlefit.imaging.reconstruct import sample_needle_profile
from needlefit.imaging.volume_files import read_volume
from needlefit.synthetic.render import densify

MATCH_MM = 3.0


def score(case: Case, cache: Path) -> list[dict[str, object]]:
    """Return a line for each true interface and each spurious proposal of a case."""
    volume, recipe = read_volume(render_cached(case, cache)), make_recipe(case.row)
    axis = densify(case.axis)
    depths = np.interp(case.interfaces, axis[:, 0], arc_length(axis)) - np.interp(
        0.0, axis[:, 0], arc_length(axis)
    )
    about: dict[str, object] = {"id": case.row.name, **case.row.levels}
    try:
        needle = trace_needle(volume, select_needle(volume, recipe).needle, recipe).points
        tip = float(arc_length(needle)[-1])
        known = EntryKnowledge(None, None, None, np.empty(0))
        choice = choose_entry(sample_needle_profile(volume, needle), tip, known)
        found = () if choice is None else propose_layers(volume, needle, choice.chosen.at)
    except NeedlefitError as error:
        return [{**about, "status": "refused", "what": error.what} for _ in depths]
    lines, left = [], list(found)
    for depth in depths:
        near = min(left, key=lambda one: abs(one.at - depth), default=None)
        if near is None or abs(near.at - depth) > MATCH_MM:
            lines.append({**about, "status": "missed"})
            continue
        left.remove(near)
        lines.append({**about, "status": "found", "error": near.at - depth, "sd": near.sd})
    return [*lines, *({**about, "status": "spurious", "sd": one.sd} for one in left)]


def main() -> None:
    """Run the design's rows and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cache", type=Path, required=True, help="folder of the rendered volumes")
    parser.add_argument("--part", choices=("tuning", "apart", "all"), default="tuning")
    parser.add_argument("--out", type=Path, help="write every line to this CSV")
    arguments = parser.parse_args()
    rows = pd.DataFrame(
        [line for row in read_design(arguments.part) for line in score(make_case(row), arguments.cache)]
    )
    if arguments.out:
        rows.to_csv(arguments.out, index=False)
    print(rows["status"].value_counts().to_string())
    groups = [("all", rows)]
    for factor in ("kernel", "dose", "voxels"):
        groups += [(f"{factor} {level}", part) for level, part in rows.groupby(factor)]
    for name, part in groups:
        print(describe(name, part))


def describe(name: str, part: pd.DataFrame) -> str:
    """Return the counts and errors of some lines in words."""
    missed, spurious = ((part["status"] == status).sum() for status in ("missed", "spurious"))
    done = part[part["status"] == "found"]
    error, sd = done["error"].abs(), done["sd"]
    return (
        f"{name}: found {len(done)}, missed {missed}, spurious {spurious}; median {error.median():.2f}, "
        f"95 % {error.quantile(0.95):.2f}, largest {error.max():.2f} mm; median stated {sd.median():.2f}; "
        f"within one deviation {(error <= sd).mean():.2f}, two {(error <= 2 * sd).mean():.2f}"
    )


if __name__ == "__main__":
    main()
