"""Mistakes of people who prepare data: which are refused, which are named, which pass in silence.

    python benchmarks/mistakes.py [--sets 2] [--sound 2] [--seed 1] [--jobs 2] [--no-fit]

Each kind of mistake is made in fresh needles like those of the start page (two layers, bevels both ways,
specimens and errors drawn anew), which are imported as a table of points and one of needles. They are judged
by the warnings of `check`, then by a quick fit to the others. A mistake is *refused* by an error, *named* by
words with the needle, or the word for all needles alike, that it is made of, and *wrong* by any other words:
also where a fit names another cause than those that are right, or a boundary where none is. It is named
*beside* where a fit names a sound needle besides.

Sound needles are made of 21 designs, by the model of the package and by six other ones. A set of them is
*accused* by any warning or doubt, and its verdict is *withheld* if the warning says that the data contradict
themselves.
"""

import argparse
import contextlib
import io
import math
import tempfile
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from needlefit.datasets.compared import SIGNIFICANT_SD
from needlefit.datasets.first_study import write_first_runs
from needlefit.datasets.importing.prepare import prepare_import
from needlefit.datasets.importing.writing import write_plan
from needlefit.errors import NeedlefitError
from needlefit.inference.doubts import MIN_SHIFT_MM
from needlefit.mechanics.control import Bevel
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.shape import compute_positions
from needlefit.mechanics.simulate import simulate
from needlefit.mechanics.tissue import Tissue
from needlefit.project.result_warnings import ResultWarning
from needlefit.project.toml import load
from needlefit.schemas.run_metadata import DoubtMetadata
from needlefit.schemas.study import StudyRecord
from needlefit.studies.first_page import list_contradictions
from needlefit.studies.fit_warnings import warn_of_doubts
from needlefit.studies.job import Settings
from needlefit.studies.load import find_odd_needles, load_study

NEEDLE = Needle.from_tube(150.0, 0.908, 60e3)
MU_MPA, TOPS_MM, BEVEL_MM, SPACING_MM = (1.5, 0.044), (20.0,), 0.08, 5.0
PATH_CURVATURE = 0.034  # 1/mm^2; of a path, over the bevel's offset, at a foundation of 1 MPa
FRICTION_MM = 120.0  # depth over which friction lessens the curvature of a path by a factor of e
BEGIN_MM = 20.0  # depth over which the curvature of a path grows to 1 - 1/e of its limit
GROWTH_MM = 50.0  # depth over which moduli grow by their mean
CORRELATION_MM = 15.0  # along the needle, of errors that neighbours share
GIVE, GIVE_MM = 0.1, 15.0  # of the tip's deflection, by which an entry gives way; depth over which that ends
SPECIMEN_SD, BEVEL_SD = 0.15, 0.03  # of ln mu and ln b between specimens
POINT_SD, SHIFT_SD, ANGLE_SD = 0.05, 0.05, 0.1  # mm, mm, degrees
SETUP = {
    "unit": "mm", "entry": "first", "pose": "1,0,0", "entry_point": "0,0,0", "bevel": "0,1,0",
    "point_sd": "0.05", "pose_shift_sd": "0.05", "pose_angle_sd": "0.1", "needle_length": "150",
    "diameter": "0.908", "inner_diameter": "0", "modulus": "60",
}  # fmt: skip
OF_IMPORT = ("placeholder", "assumed")  # kinds of warnings that every such import has


@dataclass
class Needles:
    """What a person writes down: points, sides, depths, blocks and media by needle, and the setup."""

    points: dict[str, np.ndarray]
    side: dict[str, int]
    depth: dict[str, float]
    block: dict[str, str]
    medium: dict[str, str]
    setup: dict[str, str] = field(default_factory=lambda: dict(SETUP))


@dataclass(frozen=True)
class Design:
    """How sound needles are inserted and measured."""

    depths: tuple[float, ...] = tuple(np.linspace(35.0, 70.0, 8))  # mm
    mu: tuple[float, ...] = MU_MPA  # of the layers
    tops: tuple[float, ...] = TOPS_MM
    points: int = 0  # of each needle; 0: one every 5 mm
    is_resampled: bool = False  # from one every 1 mm, at even distances of about 5 mm
    is_one_block: bool = False  # whether all needles share a specimen
    is_one_sided: bool = False  # whether all bevels face one way
    tissue: float = 1.0  # factor of the tissue's moduli
    bend: float = 1.0  # factor of the bends of all needles
    spread: float = 1.0  # factor of the differences between specimens
    noise: float = POINT_SD  # SD of the points, mm
    correlated: float = 0.0  # SD of errors that neighbours share, mm, which are not stated
    step: float = 0.01  # to which coordinates are rounded, mm


def bend_beam(design, mu, bevel, s, alpha=1.0):
    """Return x and y (N, 2) of a needle of the package's model at distances s along it."""
    tissue = Tissue(np.array(mu), np.full(len(mu), alpha), np.array(design.tops))
    return compute_positions(simulate(NEEDLE, tissue, Bevel(bevel), float(s[-1])), s)


def stiffen(design, mu, bevel, s):
    """Return a needle of the package's model in layers that stiffen with depth, in slices of 5 mm."""
    tops = np.union1d(design.tops, np.arange(2.5, s[-1], 5.0))
    begins = np.concatenate([[0.0], tops])
    moduli = np.array(mu)[np.searchsorted(design.tops, begins, side="right")]
    return bend_beam(replace(design, tops=tuple(tops)), moduli * (0.5 + begins / GROWTH_MM), bevel, s)


def bend_path(design, mu, bevel, s, friction_mm=math.inf, begin_mm=0.0):
    """Return x and y (N, 2) of a needle that follows its tip, whose path has one curvature in each layer.

    That is the nonholonomic model of Webster et al. (2006), Int J Robot Res 25, 509. As of a beam on an
    elastic foundation, the curvature grows by the fourth root of the modulus.
    """
    fine = np.linspace(0.0, s[-1], 1001)
    layer = np.searchsorted(design.tops, fine, side="right")
    curvature = PATH_CURVATURE * bevel * np.power(mu, 0.25)[layer] * np.exp(-fine / friction_mm)
    curvature *= -np.expm1(-fine / begin_mm) if begin_mm else 1.0
    angle = cumulative_trapezoid(curvature, fine, initial=0.0)
    path = (cumulative_trapezoid(part, fine, initial=0.0) for part in (np.cos(angle), np.sin(angle)))
    return np.column_stack([np.interp(s, fine, part) for part in path])


def give_way(design, mu, bevel, s):
    """Return a needle of the package's model whose guide gives way toward the bevel."""
    flat = bend_beam(design, mu, bevel, s)[:, :2]
    return flat + np.outer(GIVE * flat[-1, 1] * np.exp(-s / GIVE_MM), [0.0, 1.0])


MODELS = {
    "beam": bend_beam,
    "another law": partial(bend_beam, alpha=5.0),
    "path": bend_path,
    "path with friction": partial(bend_path, friction_mm=FRICTION_MM),
    "path that begins straight": partial(bend_path, begin_mm=BEGIN_MM),
    "stiffer with depth": stiffen,
    "guide gives way": give_way,
}


def measure_needles(rng, design, model=bend_beam):
    """Simulate needles, each into another specimen unless the design has one block; measure with errors."""
    needles = Needles({}, {}, {}, {}, {})
    sds = design.spread * np.array([*[SPECIMEN_SD] * len(design.mu), BEVEL_SD])
    draws = rng.normal(size=(len(design.depths), len(sds))) * sds
    for n, (depth, draw) in enumerate(zip(design.depths, draws, strict=True)):
        *mu, bevel = np.array([*design.mu, BEVEL_MM]) * np.exp(draws[0] if design.is_one_block else draw)
        spacing = 1.0 if design.is_resampled else SPACING_MM
        s = np.linspace(0, depth, design.points or round(depth / spacing) + 1)
        flat = model(replace(design, tops=tuple(np.array(design.tops) + 0.2 * rng.normal())),
                     design.tissue * np.array(mu), bevel, s)  # fmt: skip
        name, side = f"n{n + 1}", -1 if n % 2 == 0 and not design.is_one_sided else 1
        points = np.column_stack([flat[:, 0], design.bend * side * flat[:, 1], np.zeros(len(flat))])
        points[:, 1:] += np.outer(points[:, 0], np.radians(ANGLE_SD) * rng.normal(size=2))
        points[:, 1:] += SHIFT_SD * rng.normal(size=2)
        points += design.noise * rng.normal(size=points.shape)
        shared = np.exp(-0.5 * ((s[:, None] - s) / CORRELATION_MM) ** 2) + 1e-9 * np.eye(len(s))
        points += design.correlated * np.linalg.cholesky(shared) @ rng.normal(size=points.shape)
        if design.is_resampled:
            at = np.linspace(0, depth, round(depth / SPACING_MM) + 1)
            points = np.column_stack([np.interp(at, s, axis) for axis in points.T])
        needles.points[name] = np.round(points / design.step) * design.step
        needles.side[name], needles.depth[name], needles.medium[name] = side, float(depth), "gel"
        needles.block[name] = "block n1" if design.is_one_block else f"block {name}"
    needles.setup["point_sd"] = f"{math.hypot(design.noise, design.step / math.sqrt(12)):.2g}"
    if design.tops:
        needles.setup |= {"boundaries": ",".join(f"{top:g}" for top in design.tops), "boundary_sd": "0.2"}
    return needles


def write_tables(needles, folder):
    """Write the two tables; return their files, and what is stated at their import."""
    rows = [
        f"{name},{x:.3f},{y:.3f},{z:.3f}" for name, points in needles.points.items() for x, y, z in points
    ]
    (folder / "points.csv").write_text("\n".join(["needle,x_mm,y_mm,z_mm", *rows]) + "\n")
    table = ["needle,bevel side,depth_mm,specimen,medium"]
    table += [
        f"{name},{side},{needles.depth[name]:g},{needles.block[name]},{needles.medium[name]}"
        for name, side in needles.side.items()
    ]
    (folder / "needles.csv").write_text("\n".join(table) + "\n")
    return [folder / "points.csv", folder / "needles.csv"], [*needles.setup.items()]


@dataclass(frozen=True)
class Mistake:
    """Where a mistake is made, what it changes, and the word that names it; "": the needle's."""

    where: str | int  # number of a point, any "point", "needle", "all" needles, their "table" or the "setup"
    change: Callable | dict
    word: str = ""
    causes: tuple[str, ...] = ()  # that a fit may name
    design: Design = Design()

    def make(self, needles, rng):
        """Make it in needles; return the words that name it."""
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
        return (self.word,) if self.word else (name, other) if self.where == "table" else (name,)


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


def segment_again(needles, one, other):
    """Measure a needle twice, and give the second measurement the name of another one."""
    copy_needle(needles, one, other)
    needles.points[one] = needles.points[one] + POINT_SD * np.random.default_rng(1).normal(
        size=needles.points[one].shape
    )


def paste_y(needles, one, other):
    """Paste y of another needle, at the places where both have points."""
    count = min(len(needles.points[one]), len(needles.points[other]))
    needles.points[one][:count, 1] = needles.points[other][:count, 1]


def rewrite(of, change, needles, one, _):
    """Write another "side", "depth", "block" or "medium" of a needle."""
    getattr(needles, of)[one] = change(getattr(needles, of)[one])


def cut_short(needles, one, _):
    """Leave out the last 10 mm of a needle, and measure its depth there."""
    needles.points[one], needles.depth[one] = needles.points[one][:-2], needles.depth[one] - 10


def move(*vector):
    """Return what adds a vector to points."""
    return lambda points: points + np.array(vector)


def step(vector, points):
    """Return points of which those from the middle on are moved."""
    return points + np.outer(np.arange(len(points)) >= len(points) // 2, vector)


def scale(*factors):
    """Return what multiplies coordinates."""
    return lambda points: points * np.array(factors)


def interpolate(curve, points):
    """Return 100 points between 6 of the measured ones."""
    few = points[np.linspace(0, len(points) - 1, 6).round().astype(int)]
    along = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(few, axis=0), axis=1))]
    at = np.linspace(0.0, along[-1], 100)
    return np.column_stack([curve(at, along, axis) for axis in few.T])


def exchange_axes(points):
    """Exchange y and z."""
    return points[..., [0, 2, 1]]


def reverse(points):
    """Write points from the tip to the entry."""
    return points[::-1]


LINES, SPLINE = np.interp, lambda at, x, y: CubicSpline(x, y)(at)
NOISY, STIFF = Design(noise=0.1), Design(bend=0.3)
THREE = Design(mu=(1.5, 0.044, 0.4), tops=(15.0, 28.0))
SCALED, TURNED, SHIFTED = ("scaled",), ("turned",), ("shifted", "stepped")
TIP_OFF = ("tip_off",)
KINDS = {
    # one point
    "a point 2 mm off in y": Mistake("point", move(0, 2, 0)),
    "a point 2 mm off in z": Mistake("point", move(0, 0, -2)),
    "a point's y saved as 0": Mistake(-3, scale(1, 0, 1)),
    "a point's y with another sign": Mistake(-2, scale(1, -1, 1)),
    "a point's y and z exchanged": Mistake(-2, exchange_axes),
    "a point twice": Mistake("needle", lambda points: np.insert(points, 3, points[3], axis=0)),
    "two points exchanged": Mistake("needle", lambda points: points[[0, 1, 3, 2, *range(4, len(points))]]),
    "the tip 1 mm off": Mistake(-1, move(0, 1, 0), causes=TIP_OFF),
    "the tip's y saved as 0": Mistake(-1, scale(1, 0, 1), causes=TIP_OFF),
    "the first point 1 mm off": Mistake(0, move(0, 0, 1)),
    "the tip 1 mm off at noise of 0.1 mm": Mistake(-1, move(0, 1, 0), causes=TIP_OFF, design=NOISY),
    "the first point 1 mm off at noise of 0.1 mm": Mistake(0, move(0, 0, 1), design=NOISY),
    "a step of 1 mm in y": Mistake("needle", partial(step, (0, 1, 0)), causes=("stepped",)),
    "a step of 1 mm in z": Mistake("needle", partial(step, (0, 0, -1)), causes=("stepped",)),
    # one needle
    "a needle 20 SD off its entry in y": Mistake("needle", move(0, 20 * SHIFT_SD, 0), causes=SHIFTED),
    "a needle 20 SD off its entry in z": Mistake("needle", move(0, 0, -20 * SHIFT_SD), causes=SHIFTED),
    "a needle mirrored": Mistake("needle", scale(1, -1, 1), causes=("mirrored",)),
    "a needle's y and z exchanged": Mistake("needle", exchange_axes, causes=("exchanged",)),
    "a needle scaled by 1.1": Mistake("needle", scale(1.1, 1.1, 1.1), causes=SCALED),
    "a needle's y scaled by 0.1": Mistake("needle", scale(1, 0.1, 1), causes=SCALED),
    "a needle's y scaled by 0.3": Mistake("needle", scale(1, 0.3, 1), causes=SCALED),
    "a needle's y scaled by 0.5": Mistake("needle", scale(1, 0.5, 1), causes=SCALED),
    "a needle's y scaled by 1.5": Mistake("needle", scale(1, 1.5, 1), causes=SCALED),
    "a needle's y scaled by 2": Mistake("needle", scale(1, 2, 1), causes=SCALED),
    "a stiff needle's y scaled by 0.1": Mistake("needle", scale(1, 0.1, 1), causes=SCALED, design=STIFF),
    "a needle's y saved as 0": Mistake("needle", scale(1, 0, 1)),
    "a needle turned by 3 degrees in the plane": Mistake("needle", turn("z", 3.0), causes=TURNED),
    "a needle turned by 3 degrees out of it": Mistake("needle", turn("y", 3.0), causes=TURNED),
    "a needle from the tip to the entry": Mistake("needle", reverse),
    "a needle without its first 10 mm": Mistake("needle", lambda points: points[2:]),
    "a needle of 100 points between 6, on lines": Mistake("needle", partial(interpolate, LINES)),
    "a needle of 100 points between 6, on a spline": Mistake("needle", partial(interpolate, SPLINE)),
    # the table
    "a bevel side with another sign": Mistake(
        "table", partial(rewrite, "side", lambda side: -side), causes=("mirrored",)),
    "a depth with a slip of 10 mm": Mistake("table", partial(rewrite, "depth", lambda depth: depth + 10)),
    "a depth in cm": Mistake("table", partial(rewrite, "depth", lambda depth: depth / 10)),
    "the depths of two needles exchanged": Mistake("table", partial(swap, "depth")),
    "the points of two needles exchanged": Mistake("table", partial(swap, "points")),
    "a needle and its depth without the last 10 mm": Mistake("table", cut_short),
    "a needle exported twice": Mistake("table", copy_needle),
    "a needle segmented twice": Mistake("table", segment_again, causes=("of",)),
    "y of another needle pasted": Mistake("table", paste_y, causes=("of",)),
    "a medium in two spellings": Mistake("table", partial(rewrite, "medium", lambda _: "gle"), "gle"),
    "a specimen in two spellings": Mistake(
        "table", partial(rewrite, "block", lambda _: "blokc n1"), "blokc", design=Design(is_one_block=True)),
    # all needles
    "all y in centimetres": Mistake("all", scale(1, 0.1, 1), "along y"),
    "all y ten times too large": Mistake("all", scale(1, 10, 1), "along y"),
    "all points in centimetres": Mistake("all", scale(0.1, 0.1, 0.1), "centimetres"),
    "all points 1.1 times too large": Mistake("all", scale(1.1, 1.1, 1.1), "long"),
    "all mirrored": Mistake("all", scale(1, -1, 1), "side"),
    "the stage 2 degrees off in the plane": Mistake("all", turn("z", 2.0), "turned"),
    "the stage 2 degrees off out of it": Mistake("all", turn("y", -2.0), "bevel"),
    "all shifted by 3 mm in y": Mistake("all", move(0, 3, 0), "entr"),
    "all shifted by 3 mm in z": Mistake("all", move(0, 0, 3), "entr"),
    "all shifted by 3 mm along the needle": Mistake("all", move(3, 0, 0), "entries"),
    "all from the tip to the entry": Mistake("all", reverse, "tip"),
    "all y and z exchanged": Mistake("all", exchange_axes, "bevel"),
    "all of 100 points between 6": Mistake("all", partial(interpolate, LINES), "interpolated"),
    # the setup
    "the bevel stated along z": Mistake("setup", {"bevel": "0,0,1"}, "bevel"),
    "the pose the other way": Mistake("setup", {"pose": "-1,0,0"}, "direction"),
    "the boundary in centimetres": Mistake("setup", {"boundaries": "2"}, "boundar", ("boundary",)),
    "the boundary 15 mm off": Mistake("setup", {"boundaries": "35"}, "boundar", ("boundary",)),
    "thicknesses for depths": Mistake("setup", {"boundaries": "13,15"}, "boundar", ("boundary",), THREE),
    "a layer left out": Mistake("setup", {"boundaries": "15"}, "boundar", ("boundary",), THREE),
    "the noise ten times too large": Mistake("setup", {"point_sd": "0.5"}, "stated"),
    "the noise ten times too small": Mistake("setup", {"point_sd": "0.005"}, "stated"),
    "the diameter in metres": Mistake("setup", {"diameter": "0.000908"}, "diameter"),
    "the radius for the diameter": Mistake("setup", {"diameter": "0.454"}, "diameter"),
}  # fmt: skip
EQUAL = (50.0,) * 8
SOUND = {
    "eight depths": Design(),
    "one depth": Design(EQUAL),
    "two depths": Design((40.0,) * 4 + (60.0,) * 4),
    "one deeper": Design((50.0,) * 7 + (60.0,), points=20),
    "one shallower": Design((50.0,) * 6 + (35.0,)),
    "five and one deeper": Design((50.0,) * 5 + (60.0,)),
    "eight points each": Design(points=8),
    "twenty points each": Design(points=20),
    "hundred points each": Design(points=100),
    "resampled": Design((36.3, 41.8, 44.1, 52.7, 56.2, 58.9, 64.4, 69.5), is_resampled=True),
    "three needles": Design((40.0, 55.0, 70.0)),
    "one layer": Design(mu=(0.2,), tops=()),
    "four layers": Design(mu=(1.5, 0.044, 0.6, 0.1), tops=(12.0, 24.0, 36.0)),
    "one block": Design(is_one_block=True),
    "one side": Design(is_one_sided=True),
    "stiff": STIFF,
    "soft": Design(tissue=0.1),
    "natural spread": Design(spread=2.0),
    "rounded": Design(step=0.5),
    "noisy": NOISY,
    "errors shared by neighbours": Design(correlated=POINT_SD),
}


@dataclass(frozen=True)
class Judgement:
    """Messages about a dataset: the refusal, or the warnings and then the doubts of a fit."""

    refusal: str = ""
    warnings: tuple[ResultWarning, ...] = ()
    doubts: tuple[tuple[str, str], ...] = ()  # needles and causes
    shifted: tuple[DoubtMetadata, ...] = ()  # boundaries that all needles put elsewhere

    def list_words(self):
        """Return all messages."""
        doubts = [f"{name} ({cause or 'no cause'})" for name, cause in self.doubts]
        return [self.refusal] * bool(self.refusal) + [str(one) for one in self.warnings] + doubts

    def judge(self, culprits, causes, tops):
        """Return an outcome. `tops`: the true depths of the boundaries, mm."""
        if self.refusal:
            return "refused"
        if any(cause and not cause.startswith(causes) for _, cause in self.doubts):
            return "wrong"
        for boundary in self.shifted:
            off = min(abs(boundary.stated + boundary.size - top) for top in tops)
            if off > max(MIN_SHIFT_MM, SIGNIFICANT_SD * boundary.sd):
                return "wrong"
        if any(culprit in words for culprit in culprits for words in self.list_words()):
            return "named" if all(name in culprits for name, _ in self.doubts) else "beside"
        return "wrong" if self.list_words() else "silent"


def inspect_needles(needles, fits=True):
    """Import needles, check them and fit them quickly."""
    with tempfile.TemporaryDirectory() as scratch, contextlib.redirect_stdout(io.StringIO()):
        folder = Path(scratch)
        files, stated = write_tables(needles, folder)
        made = folder / "made"
        made.mkdir()
        try:
            prepared = prepare_import(files, stated, None, None, None)
            dataset = write_plan(made, prepared.content, prepared.plan, prepared.mapping)
            write_first_runs(made, dataset, prepared.plan.choices)
            found, doubts, shifted = doubt(made) if fits else ((), (), ())
        except NeedlefitError as error:
            return Judgement(refusal=str(error))
    found = (*dataset.warnings, *found)
    warnings = (replace(one, where="") for one in found if one.kind not in OF_IMPORT)
    return Judgement("", tuple(warnings), tuple(doubts), tuple(shifted))


def doubt(folder):
    """Return the warnings of a quick fit of each medium, and what it names.

    That is the needles with their causes, and boundaries that all put elsewhere. That no needle is
    described by the model is no word about the data.
    """
    found, named, shifted = [], [], []
    for file in sorted(folder.glob("*_study.toml")):
        with contextlib.chdir(file.parent):
            job = load_study(file.stem, load(file, StudyRecord), Settings(file=file))
        doubts = find_odd_needles(job)
        found += warn_of_doubts(doubts._replace(odd_needles=(), deviating=None))
        named += [(one.insertion, one.cause) for one in doubts.odd_needles]
        shifted += [one for one in (doubts.common_doubt,) if one is not None and one.stated is not None]
    return found, named, shifted


def judge_mistake(kind, seed, n, fits):
    """Return the outcome of one set of a kind of mistake, and what is reported."""
    mistake = KINDS[kind]
    rng = np.random.default_rng([seed, list(KINDS).index(kind), n])
    needles = measure_needles(rng, mistake.design)
    culprits = mistake.make(needles, rng)
    found = inspect_needles(needles, fits)
    return found.judge(culprits, mistake.causes, mistake.design.tops), found.list_words()


def judge_sound(design, model, seed, n, fits):
    """Return whether one set of sound needles is accused, its verdict withheld, and what is reported."""
    rng = np.random.default_rng([seed, *f"{design}{model}".encode(), n])
    found = inspect_needles(measure_needles(rng, SOUND[design], MODELS[model]), fits)
    words = found.list_words()
    return bool(words), bool(found.refusal or list_contradictions(found.warnings)), words


def main():
    """Print a row for each kind of mistake, and for each design of sound needles."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--sets", type=int, default=2, help="datasets of each kind of mistake")
    parser.add_argument("--sound", type=int, default=2, help="sound datasets of each design and model")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--no-fit", action="store_true", help="judge by what is known before a fit")
    options = parser.parse_args()
    outcomes, fits, total = ("named", "beside", "refused", "wrong", "silent"), not options.no_fit, Counter()
    with ProcessPoolExecutor(options.jobs) as pool:
        made = {
            kind: [pool.submit(judge_mistake, kind, options.seed, n, fits) for n in range(options.sets)]
            for kind in KINDS
            if options.sets
        }
        sound = {
            (design, model): [
                pool.submit(judge_sound, design, model, options.seed, n, fits) for n in range(options.sound)
            ]
            for design in SOUND
            for model in MODELS
            if options.sound
        }
        print(f"{'mistake':48}" + "".join(f"{one:>10}" for one in outcomes))
        for kind, rows in made.items():
            found = Counter(row.result()[0] for row in rows)
            print(f"{kind:48}" + "".join(f"{found[one] or '':>10}" for one in outcomes), flush=True)
            for outcome, words in (row.result() for row in rows):
                if outcome in ("beside", "wrong"):
                    print(*(f"    {one}" for one in words), sep="\n")
            total += found
        print(f"{'all mistakes':48}" + "".join(f"{total[one]:>10}" for one in outcomes))
        print(f"\n{'sound design':24}{'model':24}{'sets':>10}{'accused':>10}{'withheld':>10}")
        totals = np.zeros(3, int)
        for (design, model), rows in sound.items():
            accused, withheld, words = zip(*(row.result() for row in rows), strict=True)
            counts = np.array([len(rows), sum(accused), sum(withheld)])
            print(f"{design:24}{model:24}" + "".join(f"{one:>10}" for one in counts), flush=True)
            for messages in words:
                print(*(f"    {one}" for one in messages), sep="\n", end="\n" if messages else "")
            totals += counts
        print(f"{'all':48}" + "".join(f"{one:>10}" for one in totals))


if __name__ == "__main__":
    main()
