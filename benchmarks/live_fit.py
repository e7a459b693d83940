"""How long the live fit of the page takes: the mode, and draws about it.

    python benchmarks/live_fit.py [--runs 10] [--json]

Fits the synthetic insertion twin/phantom2-05 (moduli of four layers, b), each time with its points moved at
random (0.1 mm), and once to all insertions of its specimen and of its medium. On one core, without the first
run.
"""

import argparse
import json
import os

import numpy as np

from needlefit.viewer.live_fit import (
    KNOTS,
    draw_about,
    find_mode,
    move_points,
    select_insertions,
)
from needlefit.viewer.opening import open_target


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=10)
    parser.add_argument("--json", action="store_true")
    asked = parser.parse_args()
    rng, shown = np.random.default_rng(1), open_target("twin/phantom2-05").shown
    modes, draws = [], []
    for _ in range(asked.runs + 1):
        moved = move_points(shown, (0.1 * rng.standard_normal(KNOTS)).tolist())
        mode = find_mode(moved, select_insertions(moved, "insertion"))
        modes.append(mode.seconds)
        draws.append(draw_about(mode, moved.insertion, 1).seconds)
    found = {"load": round(os.getloadavg()[0], 1)}
    for name, spent in (("mode_s", modes[1:]), ("draws_s", draws[1:])):
        found[name] = {"median": round(float(np.median(spent)), 2), "greatest": round(max(spent), 2)}
    for scope in ("specimen", "dataset"):
        insertions = select_insertions(shown, scope)
        mode = find_mode(shown, insertions)
        found[f"mode_s_of_{len(insertions)}_insertions"] = round(mode.seconds, 2)
        found[f"draws_s_of_{len(insertions)}_insertions"] = round(
            draw_about(mode, shown.insertion, 1).seconds, 2
        )
    if asked.json:
        print(json.dumps(found, indent=2))
        return
    for key, value in found.items():
        print(f"{key:28} {value}")


if __name__ == "__main__":
    main()
