"""Mistakes of people who prepare data: which are refused, which are named, which pass in silence.

    python benchmarks/mistakes.py [--sets 5] [--sound 200] [--seed 1]

Each kind of mistake is made in fresh needles like those of the start page (two layers, bevels both ways,
specimens and errors drawn anew), which are imported as a table of points and one of needles. A mistake is
*refused* by an error, *named* by a warning with the needle, or the word for all needles alike, that it is
made of, *misnamed* by any other warning. Of sound needles each warning is a false alarm.
"""

import argparse
import contextlib
import io
import math
import tempfile
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from needlefit.cli import main as run_command
from needlefit.datasets.read import inspect
from needlefit.mechanics.control import Bevel
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.shape import compute_positions
from needlefit.mechanics.simulate import simulate
from needlefit.mechanics.tissue import Tissue

NEEDLE = Needle.from_tube(150.0, 0.908, 60e3)
MU_MPA, TOP_MM, BEVEL_MM, SPACING_MM, COUNT = (1.5, 0.044), 20.0, 0.08, 5.0, 8
SPECIMEN_SD, BEVEL_SD = 0.15, 0.03  # of ln mu and ln b between specimens
POINT_SD, SHIFT_SD, ANGLE_SD = 0.05, 0.05, 0.1  # mm, mm, degrees
SETUP = {
    "units": "mm", "entry": "first", "pose": "1,0,0", "entry point": "0,0,0", "bevel": "0,1,0",
    "boundaries": "20", "boundary sd": "0.2", "point sd": "0.05", "pose shift sd": "0.05",
    "pose angle sd": "0.1", "needle length": "150", "diameter": "0.908", "inner diameter": "0",
    "modulus": "60",
}  # fmt: skip
OF_IMPORT = ("placeholder", "assumed")  # kinds of warnings that every such import has


@dataclass
class Needles:
    """What a person writes down: points, sides and depths by needle, and the setup."""

    points: dict[str, np.ndarray]
    side: dict[str, int]
    depth: dict[str, float]
    setup: dict[str, str] = field(default_factory=lambda: dict(SETUP))


def measure_needles(rng, noise=POINT_SD, bend=1.0):
    """Simulate needles of 35 to 70 mm, each into another specimen, and measure them with errors."""
    needles = Needles({}, {}, {})
    for n, depth in enumerate(np.linspace(35.0, 70.0, COUNT)):
        mu = np.array(MU_MPA) * np.exp(SPECIMEN_SD * rng.normal(size=2))
        tissue = Tissue(mu, np.ones(2), np.array([TOP_MM + 0.2 * rng.normal()]))
        bevel = Bevel(BEVEL_MM * math.exp(BEVEL_SD * rng.normal()))
        s = np.linspace(0, depth, round(depth / SPACING_MM) + 1)
        flat = compute_positions(simulate(NEEDLE, tissue, bevel, float(depth)), s)
        name, side = f"n{n + 1}", -1 if n % 2 == 0 else 1
        points = np.column_stack([flat[:, 0], bend * side * flat[:, 1], np.zeros(len(flat))])
        points[:, 1:] += np.outer(points[:, 0], np.radians(ANGLE_SD) * rng.normal(size=2))
        points[:, 1:] += SHIFT_SD * rng.normal(size=2)
        needles.points[name] = points + noise * rng.normal(size=points.shape)
        needles.side[name], needles.depth[name] = side, float(depth)
    return needles


def write_tables(needles, folder):
    """Write the two tables; return the words of the command that imports them."""
    rows = [
        f"{name},{x:.2f},{y:.2f},{z:.2f}" for name, points in needles.points.items() for x, y, z in points
    ]
    (folder / "points.csv").write_text("\n".join(["needle,x_mm,y_mm,z_mm", *rows]) + "\n")
    table, depth = ["needle,bevel side,depth_mm,specimen,medium"], needles.depth
    table += [f"{name},{side},{depth[name]:g},block {name},gel" for name, side in needles.side.items()]
    (folder / "needles.csv").write_text("\n".join(table) + "\n")
    words = ["import", str(folder / "points.csv"), str(folder / "needles.csv"), "--yes"]
    for pair in needles.setup.items():
        words += ["--setup", "=".join(pair)]
    return [*words, "--out", str(folder / "made")]


@dataclass(frozen=True)
class Mistake:
    """Where a mistake is made, what it changes, and the word of a warning that names it; "": the needle's."""

    where: str | int  # number of a point, any "point", "needle", "all" needles, their "table" or the "setup"
    change: Callable | dict
    word: str = ""
    noise: float = POINT_SD  # SD of the points, mm
    bend: float = 1.0  # factor of the bends of all needles

    def measure(self, rng):
        """Return fresh needles, with the noise stated."""
        needles = measure_needles(rng, self.noise, self.bend)
        needles.setup["point sd"] = f"{self.noise:g}"
        return needles

    def make(self, needles, rng):
        """Make it in needles; return the word."""
        name, other = map(str, rng.choice(list(needles.points), 2, replace=False))
        points = needles.points[name]
        if self.where == "setup":
            needles.setup |= self.change
        elif self.where == "table":
            self.change(needles, name, other)
        elif self.where == "all":
            needles.points = {each: self.change(own) for each, own in needles.points.items()}
        elif self.where == "needle":
            needles.points[name] = self.change(points)
        else:
            at = int(rng.integers(2, len(points) - 2)) if self.where == "point" else self.where
            points[at] = self.change(points[at])
        return self.word or name


def turn(axis, degrees):
    """Return what turns points about an axis through the entry."""
    return Rotation.from_euler(axis, degrees, degrees=True).apply


def swap(of, needles, one, other):
    """Exchange what two needles have: their "points" or "depth"."""
    values = getattr(needles, of)
    values[one], values[other] = values[other], values[one]


def copy_needle(needles, one, other):
    """Export a needle twice, under the name of another one."""
    needles.points[one], needles.depth[one] = needles.points[other].copy(), needles.depth[other]
    needles.side[one] = needles.side[other]


def rewrite(of, change, needles, one, _):
    """Write another "side" or "depth" of a needle."""
    getattr(needles, of)[one] = change(getattr(needles, of)[one])


def move(*vector):
    """Return what adds a vector to points."""
    return lambda points: points + np.array(vector)


def step(vector, points):
    """Return points of which those from the middle on are moved."""
    return points + np.outer(np.arange(len(points)) >= len(points) // 2, vector)


def scale(*factors):
    """Return what multiplies coordinates."""
    return lambda points: points * np.array(factors)


def round_all(step, needles, *_):
    """Round all coordinates to a step, and state its error."""
    needles.points = {name: np.round(points / step) * step for name, points in needles.points.items()}
    needles.setup["point sd"] = f"{math.hypot(POINT_SD, step / math.sqrt(12)):.2g}"


KINDS = {
    # one point
    "a point 2 mm off in y": Mistake("point", move(0, 2, 0)),
    "a point 2 mm off in z": Mistake("point", move(0, 0, -2)),
    "a point's y saved as 0": Mistake(-3, scale(1, 0, 1)),
    "a point's y with another sign": Mistake(-2, scale(1, -1, 1)),
    "a point's y and z exchanged": Mistake(-2, lambda points: points[..., [0, 2, 1]]),
    "the tip 1 mm off": Mistake(-1, move(0, 1, 0)),
    "the tip's y saved as 0": Mistake(-1, scale(1, 0, 1)),
    "the first point 1 mm off": Mistake(0, move(0, 0, 1)),
    "a point 2 mm off along the needle": Mistake("point", move(2, 0, 0)),
    "the tip 1 mm off at noise of 0.1 mm": Mistake(-1, move(0, 1, 0), noise=0.1),
    "the first point 1 mm off at noise of 0.1 mm": Mistake(0, move(0, 0, 1), noise=0.1),
    "a step of 1 mm in y": Mistake("needle", partial(step, (0, 1, 0)), "step"),
    "a step of 1 mm in z": Mistake("needle", partial(step, (0, 0, -1)), "step"),
    # one needle
    "a needle 20 SD off its entry in y": Mistake("needle", move(0, 20 * SHIFT_SD, 0)),
    "a needle 20 SD off its entry in z": Mistake("needle", move(0, 0, -20 * SHIFT_SD)),
    "a needle mirrored": Mistake("needle", scale(1, -1, 1)),
    "a needle's y and z exchanged": Mistake("needle", lambda points: points[..., [0, 2, 1]]),
    "a needle scaled by 1.1": Mistake("needle", scale(1.1, 1.1, 1.1)),
    "a needle's y scaled by 0.1": Mistake("needle", scale(1, 0.1, 1)),
    "a needle's y scaled by 0.3": Mistake("needle", scale(1, 0.3, 1)),
    "a needle's y scaled by 0.5": Mistake("needle", scale(1, 0.5, 1)),
    "a needle's y scaled by 1.5": Mistake("needle", scale(1, 1.5, 1)),
    "a needle's y scaled by 2": Mistake("needle", scale(1, 2, 1)),
    "a stiff needle's y scaled by 0.1": Mistake("needle", scale(1, 0.1, 1), bend=0.3),
    "a needle turned by 3 degrees in the plane": Mistake("needle", turn("z", 3.0)),
    "a needle turned by 3 degrees out of it": Mistake("needle", turn("y", 3.0)),
    "a needle from the tip to the entry": Mistake("needle", lambda points: points[::-1]),
    # the table
    "a bevel side with another sign": Mistake("table", partial(rewrite, "side", lambda side: -side)),
    "a depth with a slip of 10 mm": Mistake("table", partial(rewrite, "depth", lambda depth: depth + 10)),
    "the depths of two needles exchanged": Mistake("table", partial(swap, "depth")),
    "the points of two needles exchanged": Mistake("table", partial(swap, "points")),
    "a needle exported twice": Mistake("table", copy_needle),
    # all needles
    "all y in centimetres": Mistake("all", scale(1, 0.1, 1), "y "),
    "all y ten times too large": Mistake("all", scale(1, 10, 1), "y "),
    "all points in centimetres": Mistake("all", scale(0.1, 0.1, 0.1), "centimetres"),
    "all mirrored": Mistake("all", scale(1, -1, 1), "side"),
    "the stage 2 degrees off in the plane": Mistake("all", turn("z", 2.0), "lean"),
    "the stage 2 degrees off out of it": Mistake("all", turn("y", -2.0), "lean"),
    "all shifted by 3 mm in y": Mistake("all", move(0, 3, 0), "entries"),
    "all shifted by 3 mm in z": Mistake("all", move(0, 0, 3), "entries"),
    "all shifted by 3 mm along the needle": Mistake("all", move(3, 0, 0), "entries"),
    "all from the tip to the entry": Mistake("all", lambda points: points[::-1], "tip"),
    "all y and z exchanged": Mistake("all", lambda points: points[..., [0, 2, 1]], "bevel"),
    # the setup
    "the bevel stated along z": Mistake("setup", {"bevel": "0,0,1"}, "bevel"),
    "the pose the other way": Mistake("setup", {"pose": "-1,0,0"}, "direction"),
    "the boundary in centimetres": Mistake("setup", {"boundaries": "2"}, "boundaries"),
    "the noise ten times too large": Mistake("setup", {"point sd": "0.5"}, "noise"),
    "the noise ten times too small": Mistake("setup", {"point sd": "0.005"}, "noise"),
    "the diameter in metres": Mistake("setup", {"diameter": "0.000908"}, "diameter"),
    "the radius for the diameter": Mistake("setup", {"diameter": "0.454"}, "diameter"),
}  # fmt: skip
SOUND = {
    "as measured": Mistake("needle", move(0, 0, 0)),
    "measured with noise of 0.1 mm": Mistake("needle", move(0, 0, 0), noise=0.1),
    "of a stiff needle": Mistake("needle", move(0, 0, 0), bend=0.3),
    "rounded to 0.5 mm": Mistake("table", partial(round_all, 0.5)),
    "rounded to 1 mm": Mistake("table", partial(round_all, 1.0)),
}


def judge(needles, culprit):
    """Import needles; return "refused", "named", "misnamed" or "silent", and the words."""
    with tempfile.TemporaryDirectory() as scratch:
        printed, folder = io.StringIO(), Path(scratch)
        with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
            try:
                run_command(write_tables(needles, folder))
            except SystemExit as leaving:
                if leaving.code:
                    return "refused", printed.getvalue()
        warnings = inspect(folder / "made").warnings
        words = [str(one).replace(scratch, "") for one in warnings if one.kind not in OF_IMPORT]
    named = any(culprit in one for one in words)
    return ("named" if named else "misnamed") if words else "silent", "\n".join(words)


def main():
    """Print a row for each kind, and the false alarms."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--sets", type=int, default=5, help="datasets of each kind of mistake")
    parser.add_argument("--sound", type=int, default=200, help="datasets without a mistake")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    outcomes = ("named", "refused", "misnamed", "silent")
    print(f"{'mistake':44}" + "".join(f"{one:>10}" for one in outcomes))
    total = Counter()
    for kinds, sets in ((KINDS, options.sets), (SOUND, options.sound)):
        for number, (kind, mistake) in enumerate(kinds.items()):
            found = Counter()
            for n in range(sets):
                rng = np.random.default_rng([options.seed, len(kinds), number, n])
                needles = mistake.measure(rng)
                outcome, words = judge(needles, mistake.make(needles, rng))
                found[outcome] += 1
                if (kinds is SOUND and outcome != "silent") or outcome == "misnamed":
                    print(f"  {kind}, {n}: {outcome}\n    " + words.replace("\n", "\n    "))
            print(f"{kind:44}" + "".join(f"{found[one] or '':>10}" for one in outcomes), flush=True)
            total += found if kinds is KINDS else Counter()
    print(f"{'all mistakes':44}" + "".join(f"{total[one]:>10}" for one in outcomes))


if __name__ == "__main__":
    main()
