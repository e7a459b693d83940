"""Mistakes of people who prepare data: which are refused, which are named, which pass in silence.

    python benchmarks/mistakes.py [--sets 5] [--sound 20] [--seed 1] [--fit]

Each kind of mistake is made in fresh needles like those of the start page (two layers, bevels both ways,
specimens and errors drawn anew), which are imported as a table of points and one of needles. A mistake is
*refused* by an error, *named* by a warning with the needle, or the word for all needles alike, that it is
made of, *misnamed* by any other warning. With `--fit` only a fit to the needles judges, as `tune` does: a
mistake is *named* by the needle that it does not predict from the others; "causes" are those printed beside.

Sound needles are made of ten designs, by the model of the package and by another one. A set of them is
*accused* by any warning, and its verdict is *withheld* if the warning says that the data contradict
themselves.
"""

import argparse
import contextlib
import io
import math
import tempfile
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.spatial.transform import Rotation

from needlefit.cli import main as run_command
from needlefit.datasets.read import inspect
from needlefit.errors import NeedlefitError
from needlefit.inference.doubts import find_doubts, fit_quickly
from needlefit.inference.problem import Problem
from needlefit.mechanics.control import Bevel
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.shape import compute_positions
from needlefit.mechanics.simulate import simulate
from needlefit.mechanics.tissue import Tissue
from needlefit.project.result_warnings import ResultWarning
from needlefit.project.toml import load
from needlefit.schemas.study import StudyRecord
from needlefit.studies.advice import list_contradictions
from needlefit.studies.job import Settings
from needlefit.studies.load import load_study

NEEDLE = Needle.from_tube(150.0, 0.908, 60e3)
MU_MPA, TOP_MM, BEVEL_MM, SPACING_MM = (1.5, 0.044), 20.0, 0.08, 5.0
PATH_CURVATURE = 0.034  # 1/mm^2; of a path, over the bevel's offset, at a foundation of 1 MPa
SPECIMEN_SD, BEVEL_SD = 0.15, 0.03  # of ln mu and ln b between specimens
POINT_SD, SHIFT_SD, ANGLE_SD = 0.05, 0.05, 0.1  # mm, mm, degrees
SETUP = {
    "unit": "mm", "entry": "first", "pose": "1,0,0", "entry_point": "0,0,0", "bevel": "0,1,0",
    "boundaries": "20", "boundary_sd": "0.2", "point_sd": "0.05", "pose_shift_sd": "0.05",
    "pose_angle_sd": "0.1", "needle_length": "150", "diameter": "0.908", "inner_diameter": "0",
    "modulus": "60",
}  # fmt: skip
OF_IMPORT = ("placeholder", "assumed")  # kinds of warnings that every such import has


@dataclass
class Needles:
    """What a person writes down: points, sides, depths and blocks by needle, and the setup."""

    points: dict[str, np.ndarray]
    side: dict[str, int]
    depth: dict[str, float]
    block: dict[str, str]
    setup: dict[str, str] = field(default_factory=lambda: dict(SETUP))


@dataclass(frozen=True)
class Design:
    """How sound needles are inserted and measured."""

    depths: tuple[float, ...] = tuple(np.linspace(35.0, 70.0, 8))  # mm
    points: int = 0  # of each needle; 0: one every 5 mm
    is_resampled: bool = False  # from one every 1 mm, at even distances of about 5 mm
    is_one_block: bool = False  # whether all needles share a specimen
    tissue: float = 1.0  # factor of the tissue's moduli
    bend: float = 1.0  # factor of the bends of all needles
    noise: float = POINT_SD  # SD of the points, mm
    step: float = 0.01  # to which coordinates are rounded, mm


def bend_beam(mu, top, bevel, s):
    """Return x and y (N, 2) of a needle of the package's model at distances s along it."""
    tissue = Tissue(np.array(mu), np.ones(2), np.array([top]))
    return compute_positions(simulate(NEEDLE, tissue, Bevel(bevel), float(s[-1])), s)


def bend_path(mu, top, bevel, s):
    """Return x and y (N, 2) of a needle that follows its tip, whose path has one curvature in each layer.

    That is the nonholonomic model of Webster et al. (2006), Int J Robot Res 25, 509. As of a beam on an
    elastic foundation, the curvature grows by the fourth root of the modulus.
    """
    fine = np.linspace(0.0, s[-1], 1001)
    curvature = PATH_CURVATURE * bevel * np.where(fine < top, *np.power(mu, 0.25))
    angle = cumulative_trapezoid(curvature, fine, initial=0.0)
    path = (cumulative_trapezoid(part, fine, initial=0.0) for part in (np.cos(angle), np.sin(angle)))
    return np.column_stack([np.interp(s, fine, part) for part in path])


MODELS = {"beam": bend_beam, "path": bend_path}


def measure_needles(rng, design, model=bend_beam):
    """Simulate needles, each into another specimen unless the design has one block; measure with errors."""
    needles = Needles({}, {}, {}, {})
    draws = rng.normal(size=(len(design.depths), 3)) * [SPECIMEN_SD, SPECIMEN_SD, BEVEL_SD]
    for n, (depth, draw) in enumerate(zip(design.depths, draws, strict=True)):
        *mu, bevel = np.array([*MU_MPA, BEVEL_MM]) * np.exp(draws[0] if design.is_one_block else draw)
        spacing = 1.0 if design.is_resampled else SPACING_MM
        s = np.linspace(0, depth, design.points or round(depth / spacing) + 1)
        flat = model(design.tissue * np.array(mu), TOP_MM + 0.2 * rng.normal(), bevel, s)
        name, side = f"n{n + 1}", -1 if n % 2 == 0 else 1
        points = np.column_stack([flat[:, 0], design.bend * side * flat[:, 1], np.zeros(len(flat))])
        points[:, 1:] += np.outer(points[:, 0], np.radians(ANGLE_SD) * rng.normal(size=2))
        points[:, 1:] += SHIFT_SD * rng.normal(size=2)
        points += design.noise * rng.normal(size=points.shape)
        if design.is_resampled:
            at = np.linspace(0, depth, round(depth / SPACING_MM) + 1)
            points = np.column_stack([np.interp(at, s, axis) for axis in points.T])
        needles.points[name] = np.round(points / design.step) * design.step
        needles.side[name], needles.depth[name] = side, float(depth)
        needles.block[name] = "n1" if design.is_one_block else name
    needles.setup["point_sd"] = f"{math.hypot(design.noise, design.step / math.sqrt(12)):.2g}"
    return needles


def write_tables(needles, folder):
    """Write the two tables; return the words of the command that imports them."""
    rows = [
        f"{name},{x:.2f},{y:.2f},{z:.2f}" for name, points in needles.points.items() for x, y, z in points
    ]
    (folder / "points.csv").write_text("\n".join(["needle,x_mm,y_mm,z_mm", *rows]) + "\n")
    table, depth = ["needle,bevel side,depth_mm,specimen,medium"], needles.depth
    table += [
        f"{name},{side},{depth[name]:g},block {needles.block[name]},gel"
        for name, side in needles.side.items()
    ]
    (folder / "needles.csv").write_text("\n".join(table) + "\n")
    words = ["import", str(folder / "points.csv"), str(folder / "needles.csv"), "--yes"]
    for pair in needles.setup.items():
        words += ["--set", "=".join(pair)]
    return [*words, "--out", str(folder / "made")]


@dataclass(frozen=True)
class Mistake:
    """Where a mistake is made, what it changes, and the word of a warning that names it; "": the needle's."""

    where: str | int  # number of a point, any "point", "needle", "all" needles, their "table" or the "setup"
    change: Callable | dict
    word: str = ""
    design: Design = Design()

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


NOISY, STIFF = Design(noise=0.1), Design(bend=0.3)
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
    "the tip 1 mm off at noise of 0.1 mm": Mistake(-1, move(0, 1, 0), design=NOISY),
    "the first point 1 mm off at noise of 0.1 mm": Mistake(0, move(0, 0, 1), design=NOISY),
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
    "a stiff needle's y scaled by 0.1": Mistake("needle", scale(1, 0.1, 1), design=STIFF),
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
    "the noise ten times too large": Mistake("setup", {"point_sd": "0.5"}, "noise"),
    "the noise ten times too small": Mistake("setup", {"point_sd": "0.005"}, "noise"),
    "the diameter in metres": Mistake("setup", {"diameter": "0.000908"}, "diameter"),
    "the radius for the diameter": Mistake("setup", {"diameter": "0.454"}, "diameter"),
}  # fmt: skip
SOUND = {
    "one depth": Design((50.0,) * 8),
    "two depths": Design((40.0,) * 4 + (60.0,) * 4),
    "twenty points each": Design(points=20),
    "resampled": Design((36.3, 41.8, 44.1, 52.7, 56.2, 58.9, 64.4, 69.5), is_resampled=True),
    "three needles": Design((40.0, 55.0, 70.0)),
    "one block": Design(is_one_block=True),
    "stiff": STIFF,
    "soft": Design(tissue=0.1),
    "rounded": Design(step=0.5),
    "one deeper": Design((50.0,) * 7 + (60.0,), points=20),
}


def judge(needles, culprit, fit):
    """Import needles; return "refused", "named", "misnamed" or "silent", and the words."""
    refusal, warnings = inspect_needles(needles, fit)
    if refusal:
        return "refused", refusal
    words = [str(one) for one in warnings]
    named = any(culprit in one for one in words)
    return ("named" if named else "misnamed") if words else "silent", "\n".join(words)


def inspect_needles(needles, fit):
    """Import needles; return what refuses them, else "", and the warnings about them, or a fit's doubts."""
    with tempfile.TemporaryDirectory() as scratch:
        printed, folder = io.StringIO(), Path(scratch)
        with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
            try:
                run_command(write_tables(needles, folder))
            except SystemExit as leaving:
                if leaving.code:
                    return printed.getvalue(), []
        if fit:
            try:
                doubts = doubt(folder)
            except NeedlefitError as error:
                return str(error), []
            return "", [ResultWarning(one.cause, f"{one.insertion} {one.cause}") for one in doubts]
        warnings = inspect(folder / "made").warnings
    return "", [replace(one, where="") for one in warnings if one.kind not in OF_IMPORT]


def doubt(folder):
    """Return the needles that a quick fit to the others does not predict."""
    file = folder / "made" / "made_study.toml"
    with contextlib.chdir(file.parent):
        job = load_study(file.stem, load(file, StudyRecord), Settings(file=file))
    weights, likelihood = job.recipe.weights, job.recipe.likelihood
    data = (job.dataset, job.insertions, job.medium, job.parameters, weights)
    problem = Problem(*data, likelihood=likelihood)
    return find_doubts(problem, fit_quickly(problem))


def count_false_alarms(design, model, sets, seed, fit):
    """Return how many sound sets are accused, how many verdicts are withheld, and the words by set."""
    accused, withheld, words = 0, 0, []
    for n in range(sets):
        needles = measure_needles(np.random.default_rng([seed, *model.encode(), n]), design, MODELS[model])
        refusal, warnings = inspect_needles(needles, fit)
        accused += bool(refusal or warnings)
        withheld += bool(refusal or list_contradictions(warnings))
        words += [f"  {n}: {one}" for one in ([refusal] if refusal else warnings)]
    return accused, withheld, words


def main():
    """Print a row for each kind of mistake, and for each design of sound needles."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--sets", type=int, default=5, help="datasets of each kind of mistake")
    parser.add_argument("--sound", type=int, default=20, help="sound datasets of each design and model")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--fit", action="store_true", help="judge by a fit alone")
    options = parser.parse_args()
    outcomes = ("named", "refused", "misnamed", "silent")
    print(f"{'mistake':44}" + "".join(f"{one:>10}" for one in outcomes))
    total = Counter()
    for number, (kind, mistake) in enumerate(KINDS.items()):
        found = Counter()
        for n in range(options.sets):
            rng = np.random.default_rng([options.seed, number, n])
            needles = measure_needles(rng, mistake.design)
            outcome, words = judge(needles, mistake.make(needles, rng), options.fit)
            found[outcome] += 1
            if outcome == "misnamed" or (options.fit and outcome == "named"):
                print(f"  {kind}, {n}: {outcome}\n    " + words.replace("\n", "\n    "))
        print(f"{kind:44}" + "".join(f"{found[one] or '':>10}" for one in outcomes), flush=True)
        total += found
    print(f"{'all mistakes':44}" + "".join(f"{total[one]:>10}" for one in outcomes))
    print(f"\n{'sound design':24}{'model':10}{'sets':>10}{'accused':>10}{'withheld':>10}")
    totals = np.zeros(3, int)
    for name, design in SOUND.items():
        for model in MODELS:
            accused, withheld, words = count_false_alarms(
                design, model, options.sound, options.seed, options.fit
            )
            counts = np.array([options.sound, accused, withheld])
            print(f"{name:24}{model:10}" + "".join(f"{one:>10}" for one in counts), flush=True)
            print(*words, sep="\n", end="\n" if words else "")
            totals += counts
    print(f"{'all':34}" + "".join(f"{one:>10}" for one in totals))


if __name__ == "__main__":
    main()
