"""Labs: plain files of simulated needles, with what each lab states, and the true parameters."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from needlefit import Bevel, Guide, Needle, Session, Tissue, compute_positions

STEEL = Needle.from_tube(150.0, 0.7, 200e3)  # 22 gauge, solid
TRUTH = {"mu1_pa": 60e3, "bevel_mm": 0.12}
BLOCK = Tissue([TRUTH["mu1_pa"] / 1e6], alpha=1.0)
NEEDLE = ("needle_length=150", "diameter=0.7", "modulus=steel", "specimen=block")
POSE_SD = ("pose_shift_sd=0.1", "pose_angle_sd=0.3")
SHIFT_MM, TURN_RAD = 0.1, np.radians(0.3)  # the same as numbers


@dataclass(frozen=True)
class Lab:
    """One or two kinds of measurement: what writes the files, by a random generator, and what is stated."""

    name: str
    write: Callable[..., None]  # path, random generator, number of needles
    stated: Sequence[str]
    files: Sequence[str] = ("data.csv",)

    def options(self):
        """Return the options of the import."""
        return ["--yes", *(word for one in self.stated for word in ("--set", one))]


def _list_depths(count):
    return [round(one) for one in np.linspace(45, 85, count)]


def insert(depth, side=1, guide=None):
    """Return the needle at a depth, mm, and its tip (depth + 1,), mm, at each mm on the way.

    `guide`: where base and a guide 20 mm before the tissue stand on the way to a depth, mm.
    """
    session, tips = Session(STEEL, BLOCK, Bevel(TRUTH["bevel_mm"], side)), [0.0]
    for reached in range(1, depth + 1):
        y = guide(reached) if guide else 0.0
        held = (Guide(-20.0, y),) if guide else ()
        shape = session.step(insert=1.0, base=(y, 0.0), guides=held)
        tips.append(shape.u[-1])
    return shape, np.array(tips)


def place(depth, s, side=1):
    """Return the points (N, 2), mm, of a needle at arc lengths from the entry."""
    return compute_positions(insert(depth, side)[0], s)[:, :2]


def _misplace(points, rng):
    """Return points (N, 2) of an insertion whose entry pose is not known exactly."""
    angle = rng.normal(0.0, TURN_RAD)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return points @ turn.T + [0.0, rng.normal(0.0, SHIFT_MM)]


def _save(path, header, rows):
    lines = [header, *(",".join(f"{cell:.4f}" if isinstance(cell, float) else str(cell) for cell in row)
                       for row in rows)]  # fmt: skip
    path.write_text("\n".join(lines) + "\n")


def write_shapes(path, rng, needles=8):
    """CT: points of needles along x, 10 mm apart, their bevels up and down."""
    rows = []
    for n, depth in enumerate(_list_depths(needles)):
        side = 1 if n % 2 else -1
        points = _misplace(place(depth, np.linspace(0.0, depth, depth // 2 + 1), side), rng)
        points = np.column_stack([points, np.full(len(points), 10.0 * n)])
        points[:, 1:] += rng.normal(0.0, 0.1, (len(points), 2))
        rows += [(f"n{n + 1}", side, depth, *map(float, one)) for one in points]
    _save(path, "needle,bevel side,depth [mm],x [mm],y [mm],z [mm]", rows)


def write_stops(path, rng, needles=8):
    """Camera: deflections of tips at stops, in a picture that is turned a little."""
    rows = []
    for n in range(needles):
        side, depths = 1 if n % 2 else -1, np.arange(0, 81, 8)
        tips = side * insert(80)[1][depths]
        tips = tips + rng.normal(0.0, 0.2) + depths * np.tan(rng.normal(0.0, np.radians(0.5)))
        tips += rng.normal(0.0, 0.05, len(tips))
        rows += [(f"n{n + 1}", side, d, float(tip)) for d, tip in zip(depths, tips, strict=True)]
    _save(path, "needle,bevel side,depth [mm],deflection [mm]", rows)


def write_tracker(path, rng, needles=8):
    """EM tracker: places of tips, beside those of the guide, which moves in half of the runs."""
    rows = []
    for n in range(needles):
        side, depths = 1 if n % 2 else -1, np.arange(0, 81, 4)
        size = 0.0 if n < needles // 2 else rng.uniform(2.0, 4.0) * (1 if n % 4 < 2 else -1)
        move = lambda d, size=size: size * np.sin(np.pi * max(d - 8, 0) / 72)  # noqa: E731
        held = [0.0, *(move(d) for d in depths[1:])]
        step = lambda d, held=held: held[int(np.ceil(d / 4))]  # on the way to a reading  # noqa: E731
        tips = insert(80, side, step)[1][depths]
        tips = tips + rng.normal(0.0, 0.3) + depths * np.tan(rng.normal(0.0, np.radians(0.5)))
        tips += rng.normal(0.0, 0.05, len(tips))
        rows += [(f"r{n + 1}", side, k, d, float(tip), float(g))
                 for k, (d, tip, g) in enumerate(zip(depths, tips, held, strict=True))]  # fmt: skip
    _save(path, "run,bevel side,time,depth [mm],deflection [mm],guide_mm", rows)


def write_fibres(path, rng, needles=8):
    """Fibres: curvatures at eight sensors of each needle."""
    rows = []
    for n, depth in enumerate(_list_depths(needles)):
        (needle, _), s = insert(depth), np.arange(5.0, 45.0, 5.0)
        curve = CubicHermiteSpline(needle.x, needle.u, needle.slope)
        bent = curve(depth - s, 2) + rng.normal(0.0, 5e-5, len(s))
        across = rng.normal(0.0, 5e-5, len(s))
        for at, y, z in zip(s, bent, across, strict=True):
            rows.append((f"n{n + 1}", depth, float(at), f"{y:.6f}", f"{z:.6f}", "0.00005"))
    curvatures = "curvature y [1/mm],curvature z [1/mm],curvature sd [1/mm]"
    _save(path, f"needle,depth [mm],sensor from tip [mm],{curvatures}", rows)


def write_tips(path, rng, needles=8):
    """Final tips: depth and deflection of insertions."""
    rows = []
    for n, depth in enumerate(_list_depths(needles)):
        tip = _misplace(place(depth, np.array([float(depth)])), rng)[0]
        rows.append((f"n{n + 1}", depth, float(tip[1] + rng.normal(0.0, 0.1))))
    _save(path, "needle,depth [mm],deflection [mm]", rows)


def write_one(path, rng, needles=1):
    """One needle: its points."""
    points = _misplace(place(80, np.linspace(0.0, 80.0, 41)), rng)
    points += rng.normal(0.0, 0.1, points.shape) * [0.0, 1.0]
    _save(path, "x [mm],y [mm]", [[*map(float, one)] for one in points])


def write_mixture(path, rng, needles=8):
    """CT and two readings of the tip of half of the needles, tips of the others on their way: three files."""
    for write, name in ((write_shapes, "ct"), (write_stops, "camera")):
        write(path.with_name(f"{name}.csv"), rng, (needles + 1) // 2)
    camera = path.with_name("camera.csv")
    camera.write_text(camera.read_text().replace("\nn", "\nc"))
    ends = []
    for n, depth in enumerate(_list_depths((needles + 1) // 2)):
        side = 1 if n % 2 else -1
        tip = float(_misplace(place(depth, np.array([float(depth)]), side), rng)[0, 1])
        ends += [(f"n{n + 1}", side, depth, tip + rng.normal(0.0, 0.1)) for _ in range(2)]
    _save(path.with_name("ends.csv"), "needle,bevel side,depth [mm],deflection [mm]", ends)


ENTERED = ("pose=1,0,0", "entry_point=0,0,0", "point_sd=0.1")
LABS = {
    one.name: one
    for one in (
        Lab("shapes", write_shapes, (*NEEDLE, "pose=1,0,0", "point_sd=0.1", *POSE_SD, "bevel=0,1,0")),
        Lab("stops", write_stops, (*NEEDLE, "point_sd=0.05", "pose_angle_sd=0.5")),
        Lab("tracker", write_tracker, (*NEEDLE, "point_sd=0.05", "pose_angle_sd=0.5")),
        Lab("fibres", write_fibres, (*NEEDLE, *POSE_SD)),
        Lab("tips", write_tips, (*NEEDLE, "point_sd=0.1", *POSE_SD)),
        Lab("one", write_one, (*NEEDLE, *ENTERED, *POSE_SD)),
        Lab(
            "ct and camera",
            write_mixture,
            (*NEEDLE, "pose=1,0,0", "point_sd=0.1", "pose_shift_sd=0.1", "pose_angle_sd=0.5", "bevel=0,1,0"),
            ("ct.csv", "camera.csv", "ends.csv"),
        ),
    )
}
