"""How `needlefit reconstruct` does on volumes of a renderer whose model it does not share.

    python benchmarks/real_scanners.py --cache FOLDER [--part tuning] [--volumes N] [--jobs 1] [--out FILE]

A fixed fraction of a factorial (`real_scanner_scenes.py`): kernel x needle along, oblique or in the slices x
voxels x material, size and number of the balls x range of HU x accessories x beam x dose. Constants are tuned
on the part `tuning`; the part `apart` is for what is reported afterwards. Every volume is reconstructed and
checked as the program does. A row is `wrong` if tip, entry, inserted length, registration or a crossing is
off by more than 1 mm. `--seeds FIRST:LAST` draws volumes instead whose needle lies in or near slices of 0.8,
1, 1.5 and 2 mm, in turn. They show little but the needle, which alone is traced; the scene is that of a whole
volume. `--flat FIRST:LAST` draws such volumes whose needle turns by at most 1 degree against the slices, and
crosses one or two. `--guides FIRST:LAST` draws narrow volumes with a guide of six materials before the
tissue, or none, whose thickness is stated: `wrong` is an entry that is off by more than 0.3 mm. Modules of
`needlefit/imaging` name the volumes on which their constants were set. Rendered volumes stay in the folder
`--cache`, so that a run can be continued.

Errors in mm: `axis` mean distance of the needle's points from the true axis; `tip_along` (negative: short)
and `tip_across`; `entry` along the needle, as it lies in the scan; `length` inserted; `tre` of true entry
and tip, the larger; `crossing` the largest distance of a point at which a layer is crossed. `bevel_deg` is
the error of the bevel's side; `bevel_stated`: whether one is stated. With `--seeds` and `--flat`, `side` and
`normal` are the parts of `axis` in the slices and along their normal, `tip_side` and `tip_normal` those of
the tip; `crossed` is how many slices the needle crosses, `in_68`, `in_95` which part lies within 1 and 1.96
stated deviations, `rms` the root mean square of errors in deviations.
"""

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from real_scanner_scenes import (
    BEVEL_DEG,
    FACTORS,
    FIELD_LOW,
    KNOWN_SD_MM,
    NEEDLE_LENGTH_MM,
    NEEDLE_MM,
    PLATE_MM,
    Case,
    Row,
    draw_guided,
    draw_row,
    make_case,
    narrow_case,
    read_design,
    render_cached,
)
from scanner.render import densify
from scipy.spatial import cKDTree

from needlefit.errors import NeedlefitError
from needlefit.geometry.curves import arc_length
from needlefit.geometry.surfaces import make_sheet, write_surface
from needlefit.imaging.assembly import DatasetDescription, assemble_checked
from needlefit.imaging.batch import ReconstructionFailure, reconstruct_needles
from needlefit.imaging.checks import list_tip_warnings
from needlefit.imaging.needle.centerline import trace_needle
from needlefit.imaging.needle.segmentation import select_needle
from needlefit.imaging.reconstruction import Reconstruction
from needlefit.imaging.scans import LayerSource, Scan
from needlefit.imaging.volume_files import read_volume
from needlefit.project.tasks import LocalPool
from needlefit.schemas.reconstruction import GuidePlateRecord, ReconstructionRecord

Floats = NDArray[np.float64]

WRONG_MM = 1.0
WRONG_ENTRY_MM = 0.3
"""The same for an entry behind a guide."""
FINE_SPACING_MM = 0.6 + 1e-9
"""Largest spacing along the needle that is fine."""
FEW_CROSSED = 2.5
"""Slices crossed, up to which where in them a needle lies shows little."""
ERRORS = ("tip_along", "tip_across", "entry", "length", "tre", "crossing")


def make_recipe(row: Row) -> ReconstructionRecord:
    """Return the recipe that a careful user would write: needle, balls and guide as they are."""
    return ReconstructionRecord.model_validate(
        {
            "schema": 2,
            "needle": {"length_mm": NEEDLE_LENGTH_MM, "diameter_mm": NEEDLE_MM, "bevel_deg": BEVEL_DEG},
            "markers": {"diameter_mm": float(row.levels["ball_mm"]), "reference_sd_mm": KNOWN_SD_MM},
            "guide": {"thickness_mm": PLATE_MM} if row.levels["accessory"] == "plate" else {},
        }
    )


def write_scan(case: Case, volume: Path, folder: Path) -> Scan:
    """Write the markers and layers of a case into `folder`; return its scan."""
    markers = folder / "markers.csv"
    lines = ["x_mm,y_mm,z_mm", *(",".join(f"{x:.6f}" for x in place) for place in case.known)]
    markers.write_text("\n".join(lines) + "\n")
    sources = []
    for n, x in enumerate(case.interfaces, start=2):
        path = folder / f"layer{n}.stl"
        write_surface(make_sheet(f"layer{n}", (float(x), 0, 0), (1, 0, 0), 60.0, into=n), path)
        sources.append(LayerSource(path, "sheet", n))
    return Scan(
        id=case.row.name,
        volume=volume,
        medium="gel",
        markers=markers,
        surfaces=tuple(sources),
        origin="synthetic",
    )


def score(row: Row, cache: Path) -> dict[str, object]:
    """Render, reconstruct and check the volume of a row; return its line of the table."""
    start = time.process_time()
    case = make_case(row)
    volume = render_cached(case, cache)
    rendered = time.process_time()
    with TemporaryDirectory() as temporary:
        folder = Path(temporary)
        found = _reconstruct_checked(write_scan(case, volume, folder), make_recipe(row), folder)
    line: dict[str, object] = {"id": row.name, **row.levels, "spacing_along": _measure_spacing(case)}
    line |= {"render_s": rendered - start, "seconds": time.process_time() - rendered}
    if isinstance(found, NeedlefitError):
        where = "" if str(volume) in found.where or temporary in found.where else found.where
        return (
            line
            | {"written": False, "wrong": False, "error": type(found).__name__}
            | {
                "where": where,
                "what": found.what,
            }
        )
    return line | {"written": True} | _measure_errors(found, case)


def trace_narrow(row: Row, cache: Path) -> dict[str, object]:
    """Render the narrow volume of a row and trace its needle; return its line of the table."""
    case, recipe = narrow_case(make_case(row)), make_recipe(row)
    volume = read_volume(render_cached(case, cache))
    start = time.process_time()
    axis = densify(case.axis)
    height = axis[axis[:, 0] >= FIELD_LOW[0]] @ case.world.rotation[2]
    line: dict[str, object] = {"id": row.name, **row.levels}
    line |= {"crossed": float(np.ptp(height)) / case.grid.spacing[2], "where": ""}
    try:
        found = trace_needle(volume, select_needle(volume, recipe).needle, recipe)
    except NeedlefitError as error:
        return line | {"written": False, "what": error.what}
    line["seconds"] = time.process_time() - start
    beside = _beside(case.world.to_local(found.points), axis, case)
    # the tip from the true one, not from the point of the axis that is nearest to it
    beside = np.vstack([beside, _beside(case.world.to_local(found.end.point[None]), axis, case, -1)])
    errors = dict(zip(("tip_side", "tip_normal", "tip_along"), beside[-1], strict=True))
    normal_sd = found.normal_sd or float(found.end.sd[1])
    return (
        line
        | errors
        | {
            "written": True,
            "what": "",
            "axis": np.hypot(*beside[:-1, :2].T).mean(),
            "side": np.abs(beside[:-1, 0]).mean(),
            "normal": np.abs(beside[:-1, 1]).mean(),
            "tip_across": np.hypot(*beside[-1, :2]),
            "normal_sd": normal_sd,
        }
        | _count_inside("tip_along", beside[-1:, 2], found.end.sd[:1])
        | _count_inside("tip_side", beside[-1:, 0], found.end.sd[1:])
        | _count_inside("tip_normal", beside[-1:, 1], np.array([normal_sd]))
        | _count_inside("axis_side", beside[:-1, 0], found.sd)
        | _count_inside("axis_normal", beside[:-1, 1], found.sd)
    )


def enter_guided(seed: int, cache: Path) -> dict[str, object]:
    """Render a narrow volume with a guide and find where its needle enters; return its line of the table."""
    case, thickness, guide = draw_guided(seed)
    recipe = make_recipe(case.row).model_copy(update={"guide": GuidePlateRecord(thickness_mm=thickness)})
    volume = render_cached(case, cache)
    start = time.process_time()
    (found,) = reconstruct_needles(Scan(case.row.name, volume, "gel"), recipe)
    line: dict[str, object] = {"id": case.row.name, "guide": guide, **case.row.levels, "where": ""}
    line["seconds"] = time.process_time() - start
    if isinstance(found, ReconstructionFailure):
        return line | {"written": False, "wrong": False, "what": f"{guide}: {found.error.what}"}
    entry = case.world.to_local(found.patient.to_local(found.pose.origin[None]))[0, 0]
    errors = {"entry": entry, "entry_sd": found.pose.along_sd, "wrong": abs(entry) > WRONG_ENTRY_MM}
    return line | {"written": True, "what": f"entry {entry:+.2f} mm, {guide}", **errors}


def _count_inside(name: str, errors: Floats, sd: Floats) -> dict[str, object]:
    """Return which part of `errors` lies within 1 and 1.96 stated deviations: 68 and 95 % of a Gaussian.

    And the root mean square of errors in deviations, which is 1 where these are right.
    """
    parts = {f"in_{q}_{name}": float(np.mean(np.abs(errors) <= k * sd)) for q, k in ((68, 1.0), (95, 1.96))}
    return {**parts, f"rms_{name}": float(np.sqrt(np.mean((errors / sd) ** 2)))}


def _beside(points: Floats, axis: Floats, case: Case, at: int | None = None) -> Floats:
    """Return where points (N, 3) lie from `axis`: in the slices, along their normal, along the needle, mm.

    From its point `at`, or from the nearest.
    """
    ways = np.gradient(axis, axis=0)
    nearest = cKDTree(axis).query(points)[1] if at is None else np.full(len(points), at)
    ways = ways[nearest] / np.linalg.norm(ways[nearest], axis=1, keepdims=True)
    side = np.cross(case.world.rotation[2], ways)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    sides = np.stack([side, np.cross(ways, side), ways], axis=1)
    beside: Floats = np.einsum("nd,nsd->ns", points - axis[nearest], sides)
    return beside


def summarize_narrow(rows: pd.DataFrame) -> pd.DataFrame:
    """Return mean absolute errors of narrow volumes: all, by how many slices are crossed, and by slices."""
    few = rows["crossed"] < FEW_CROSSED
    groups = [("all", rows), (f"fewer than {FEW_CROSSED} crossed", rows[few]), ("more crossed", rows[~few])]
    groups += [(f"{level} mm", part) for level, part in rows.groupby(rows["voxels"].str.split("x").str[1])]
    lines = []
    for name, part in groups:
        done = part[part["written"]]
        means = done.drop(columns=["id", "crossed", *FACTORS]).select_dtypes("number").abs().mean()
        lines.append({"volumes": name, "n": len(part), "refused": len(part) - len(done), **means})
    return pd.DataFrame(lines)


def _measure_spacing(case: Case) -> float:
    """Return the voxels' spacing along the needle's end, mm."""
    end = case.world.rotation @ (case.axis[-1] - case.axis[-2])
    return float(np.linalg.norm(end * case.grid.spacing) / np.linalg.norm(end))


def _reconstruct_checked(
    scan: Scan, recipe: ReconstructionRecord, folder: Path
) -> Reconstruction | NeedlefitError:
    (found,) = reconstruct_needles(scan, recipe)
    if isinstance(found, ReconstructionFailure):
        return found.error
    _, refused = assemble_checked(folder / "dataset", [found], recipe, DatasetDescription("benchmark"))
    return refused[0].error if refused else found


def _measure_errors(one: Reconstruction, case: Case) -> dict[str, object]:
    axis = densify(case.axis)
    tangent = (axis[-1] - axis[-20]) / np.linalg.norm(axis[-1] - axis[-20])
    # in the world as it lies in the scan: the registration's error is another column
    local = case.world.to_local(one.needle_axis.points)
    miss = case.world.to_local(one.needle_axis.end.point[None])[0] - axis[-1]
    along = float(miss @ tangent)
    across = float(np.linalg.norm(miss - along * tangent))
    inside = axis[axis[:, 0] >= 0]
    true_length = float(arc_length(inside)[-1])
    marked = np.array([inside[0], axis[-1]])
    moved = one.patient.to_world(case.world.to_world(marked)) - marked
    entry = float(case.world.to_local(one.patient.to_local(one.pose.origin[None]))[0, 0])
    bevel = case.world.rotation.T @ one.needle_axis.end.bevel
    angle = np.degrees(np.arccos(np.clip(bevel @ case.bevel / np.linalg.norm(bevel), -1, 1)))
    crossed = np.array([[np.interp(x, axis[:, 0], axis[:, n]) for n in range(3)] for x in case.interfaces])
    same = len(one.layers.points) == len(crossed)
    crossings = np.linalg.norm(one.layers.points - crossed, axis=1) if same else np.array([np.nan])
    errors: dict[str, object] = {
        "axis": float(np.hypot(*_beside(local, axis, case)[:, :2].T).mean()),
        "tip_along": along,
        "tip_along_sd": float(one.needle_axis.end.sd[0]),
        "tip_across": across,
        "tip_across_sd": float(one.needle_axis.end.sd[1]),
        "entry": entry,
        "entry_sd": one.pose.along_sd,
        "length": one.depth - true_length,
        "length_sd": one.depth_sd,
        "tre": float(np.linalg.norm(moved, axis=1).max()),
        "tre_predicted": float(np.max(one.target_error)),
        "crossing": float(crossings.max()),
        "bevel_deg": float(angle),
        "bevel_stated": bool(np.isfinite(angle)),
        "bevel_sd_deg": float(np.degrees(one.needle_axis.end.roll_sd)),
        "tip_warned": any(list_tip_warnings(one)),
        "warnings": len(one.warnings),
        "what": " | ".join(one.warnings),
    }
    off = [name for name in ERRORS if not abs(float(str(errors[name]))) <= WRONG_MM]
    return errors | {"wrong": bool(off), "where": " ".join(off)}


def summarize(rows: pd.DataFrame, statistic: str) -> pd.DataFrame:
    """Return a line for all volumes, for both spacings along the needle, and for every level of every factor.

    `statistic` ("mean" or "median") is that of the absolute errors of the volumes written.
    """
    fine = rows["spacing_along"] <= FINE_SPACING_MM
    groups = [("all", "", rows)]
    groups += [("spacing", "fine", rows[fine]), ("spacing", "coarse", rows[~fine])]
    slices = rows["voxels"].str.split("x").str[1]
    groups += [("slices", str(level), part) for level, part in rows.groupby(slices)]
    groups += [(factor, str(level), part) for factor in FACTORS for level, part in rows.groupby(factor)]
    return pd.DataFrame([_summarize_group(*group, statistic) for group in groups])


def _summarize_group(factor: str, level: str, part: pd.DataFrame, statistic: str) -> dict[str, object]:
    done = part[part["written"]]
    line: dict[str, object] = {"factor": factor, "level": level, "n": len(part)}
    line |= {"refused": len(part) - len(done), "wrong": int(part["wrong"].sum())}
    if not len(done):
        return line
    line["unwarned"] = int((done["wrong"] & ~done["tip_warned"].astype(bool)).sum())
    for name in ("tip_along", "tip_across", "axis", "entry", "length", "tre", "crossing", "bevel_deg"):
        line[name] = done[name].abs().agg(statistic)
    line["tip/spacing"] = (done["tip_along"].abs() / done["spacing_along"]).agg(statistic)
    for name in ("tip_along", "length"):
        line[f"in_1sd_{name}"] = (done[name].abs() <= done[f"{name}_sd"]).mean()
    return line


def main() -> None:
    """Run the design's rows and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cache", type=Path, required=True, help="folder of the rendered volumes")
    parser.add_argument("--part", choices=("tuning", "apart", "all"), default="tuning")
    parser.add_argument("--seeds", help="FIRST:LAST: volumes drawn by these seeds, needle in the slices")
    parser.add_argument("--flat", help="FIRST:LAST: the same, needle within 1 degree of the slices")
    parser.add_argument("--guides", help="FIRST:LAST: volumes drawn by these seeds, with a guide")
    parser.add_argument("--volumes", type=int, help="only the first so many")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--out", type=Path, help="write every volume's line to this CSV")
    arguments = parser.parse_args()
    design = read_design(arguments.part)
    narrow = arguments.seeds or arguments.flat
    measure = partial(trace_narrow if narrow else score, cache=arguments.cache)
    if narrow:
        way = "inplane" if arguments.seeds else "flat"
        design = [draw_row(seed, way) for seed in range(*map(int, narrow.split(":")))]
    work: tuple[Callable[[Any], dict[str, object]], Sequence[object]] = measure, design
    if arguments.guides:
        work = partial(enter_guided, cache=arguments.cache), range(*map(int, arguments.guides.split(":")))
    lines: list[dict[str, object]] = []
    for _, line in LocalPool(arguments.jobs).run(work[0], work[1][: arguments.volumes]):
        lines.append(line)
        print(f"{line['id']} written {line['written']} {line['where']}: {line['what']}", file=sys.stderr)
        if arguments.out:
            pd.DataFrame(lines).sort_values("id").to_csv(arguments.out, index=False)
    rows = pd.DataFrame(lines).sort_values("id")
    if narrow:
        print(summarize_narrow(rows).T.to_string(header=False, float_format=lambda x: f"{x:.3f}"))
        return
    if arguments.guides:
        print(f"{len(rows)} volumes, {rows['written'].sum()} written, {rows['wrong'].sum()} wrong")
        return
    for statistic in ("mean", "median"):
        print(f"{statistic} absolute errors of the volumes written, mm")
        table = summarize(rows, statistic)
        print(table.to_string(index=False, float_format=lambda x: f"{x:.3f}", na_rep=""))
    print("spacing: along the needle, at most 0.6 mm (fine) or more; tip/spacing: tip_along in parts of it")
    print("unwarned: wrong without a warning about the tip; in_1sd: part within one stated deviation")


if __name__ == "__main__":
    main()
