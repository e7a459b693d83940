"""Imported needles are placed: entry, direction, layers, bevel, turns, tips and tracks."""

from pathlib import Path

import numpy as np
import pytest
from import_cases import needle, placed, planned, prepare, write_long, write_markups, write_placed, write_rows
from numpy.testing import assert_allclose
from pytest import approx
from refusals import refusal
from research.fits import score_study

from needlefit.datasets.folds import divide_insertions
from needlefit.datasets.planes import measure_out_of_plane
from needlefit.datasets.read import inspect, read
from needlefit.datasets.select import list_bevels
from needlefit.errors import ConfigError, DataError
from needlefit.geometry.curves import integrate_curvature
from needlefit.geometry.stray_points import find_stray_points
from needlefit.geometry.surfaces import make_sheet, write_surface
from needlefit.project.toml import load
from needlefit.project.unit_warnings import GAUGES_MM
from needlefit.reporting.dataset_import import tabulate_needles, write_import
from needlefit.schemas.scene import SceneRecord, resolve_steps

CASES = Path(__file__).with_name("imports")
NEEDLES = [needle(n, 16) for n in range(3)]


def points_of(paths, **stated):
    """Return the points of the needles, mm, as they are written."""
    return [one.points for one in prepare(paths, **stated).content.curves]


TURNS = "id,depth_mm,bevel_roll_deg\n" + "".join(f"q{n},{25 + 5 * n},90\n" for n in range(1, 5))
CURVATURES = "Nadel;s (cm);Krümmung y [1/m];kappa_z [1/m];sd [1/m]\nq1;1;0,1;3,3;0,1\nq1;4;3,3;-0,2;0,1\n"
SHARP = {
    "pose": "1,0,0",
    "entry_point": "0,0,0",
    "bevel": "0,1,0",
    "point_sd": "0.05",
    "pose_angle_sd": "0.05",
}


def with_shaft(curve, step=3.0):
    """Return a needle that begins 18 mm before its entry."""
    x = np.arange(-18.0, -2.0, step)
    return np.vstack([np.column_stack([x, np.full((len(x), 2), curve[0, 1:])]), curve])


def write_surfaces(folder, *names, sign=1.0):
    for name, x in zip(names, (0.0, 20.0, 35.0), strict=False):
        sheet = make_sheet(name, (sign * x, 0.0, 0.0), (1.0, 0.0, 0.0), 90.0, 2)
        write_surface(sheet, folder / f"{name}.stl")


def test_the_entry_is_the_first_point_unless_another_is_stated(tmp_path):
    file = write_long(tmp_path, NEEDLES)
    assert planned([file])[1]["entry"] == ("first", "assumed")
    file = write_long(tmp_path, [one[::-1] for one in NEEDLES])
    assert_allclose(points_of([file], entry="last")[1].values, NEEDLES[1], atol=1e-6)
    file = write_long(tmp_path, [NEEDLES[0][::-1], *NEEDLES[1:]])
    assert "n1" in refusal(DataError, "--set entry", planned, [file]).what
    assert planned([file], entry="first")[1]["entry"] == ("first", "stated")
    fix = refusal(DataError, "179 degrees", planned, [file], entry="first", pose="1,0,0").fix
    assert f"{file}:2 to {file}:17" in fix
    file = write_long(tmp_path, [one[::-1] for one in NEEDLES])
    assert "--set entry=last" in refusal(DataError, "-0.999", planned, [file], pose="1,0,0").fix


def test_a_needle_is_cut_at_a_surface_and_its_shaft_gives_the_pose(tmp_path):
    write_surfaces(tmp_path, "1_skin", "上", "下")
    write_long(tmp_path, [with_shaft(one) for one in NEEDLES])
    plan, _ = planned([tmp_path], point_sd="0.1", pose="shaft", entry_point="1_skin")
    row = plan.rows[1]
    assert_allclose(row.entry, [0.0, 3.0, 0.0], atol=0.01)
    assert_allclose(row.direction, [1.0, 0.0, 0.0], atol=1e-6)
    assert (row.pose_source, row.layers) == ("first_point", 3)  # a point of the bent needle
    assert [(one.name, one.into) for one in plan.surfaces] == [("上", 2), ("下", 3)]
    x = np.array([*np.arange(-18.0, -2.0, 3.0), 0.0])  # beside the error of a line, that of its bend
    assert 3 * 0.1 / np.linalg.norm(x - x.mean()) < plan.rows[0].pose_angle_sd < np.radians(2.0)
    assert plan.rows[0].pose_shift_sd == 0.1
    options = {"pose": "shaft", "entry_point": "1_skin", "pose_angle_sd": "1"}
    assert np.degrees(planned([tmp_path], **options)[0].rows[0].pose_angle_sd) == approx(1.0)
    assert len(planned([tmp_path], entry_point="first", pose="1,0,0")[0].surfaces) == 3
    refusal(DataError, "--set entry_point", planned, [tmp_path], pose="1,0,0")  # is the first surface a skin?
    refusal(DataError, "--set pose", planned, [tmp_path])
    refusal(DataError, "--set pose", planned, [tmp_path], pose="free")
    written = write_placed(tmp_path / "gel", [tmp_path], **options)
    assert {one.name for one in (written / "layers").iterdir()} == {"上.stl", "下.stl"}


@pytest.mark.parametrize("by", ["entry_point", "depth", "label"])
def test_a_straight_shaft_is_cut_at_the_stated_entry_or_depth(tmp_path, by):
    curves = [with_shaft(NEEDLES[0] + [0, 5.0 * n, 0]) for n in range(3)]
    # of an arc with its first points on a line; along the needle the depth is that of the part in the tissue
    depth = float(np.sum(np.linalg.norm(np.diff(NEEDLES[0], axis=0), axis=1)))
    head, cells = (["depth [cm]"], [[f"{depth / 10:.4f}"]] * 3) if by == "depth" else ((), ())
    file = write_long(tmp_path, curves, head=head, cells=cells)
    if by == "label":
        file.write_text(f"Tiefe,{depth / 10:.4f} cm\n\n" + file.read_text())
    options = {"entry_point": "0,0,0"} if by == "entry_point" else {}
    if by == "entry_point":
        file = write_long(tmp_path, [with_shaft(one - one[0]) for one in NEEDLES])
    plan, made = planned([file], pose="shaft", **options)
    for row, points in zip(plan.rows, points_of([file], pose="shaft", **options), strict=True):
        assert_allclose(row.direction, [1, 0, 0], atol=1e-6)
        assert row.pose_source == ("shaft" if by == "entry_point" else "first_point")
        assert abs(points.values[0, 0]) < 0.01
    assert made["entry_point"][0] == ("0,0,0" if by == "entry_point" else "depth")
    assert "18.0 mm" in made["shaft"][0]


@pytest.mark.parametrize(("spacing", "noise"), [(5.0, 0.2), (1.0, 0.2), (0.5, 0.1), (0.1, 0.2)])
def test_dense_and_noisy_points_are_as_long_as_their_needles(tmp_path, spacing, noise):
    """Arcs of 35 to 60 mm; a stated depth is used as it stands."""
    rng, depths = np.random.default_rng(8), np.arange(35.0, 61.0, 5.0)
    curves = []
    for depth in depths:
        s = np.linspace(0.0, depth, round(depth / spacing) + 1)
        arc = np.column_stack([integrate_curvature(depth, [0.008], s), np.zeros(len(s))])
        curves.append(arc + noise * rng.normal(size=arc.shape))
    answers = {"pose": "1,0,0", "point_sd": f"{noise}"}
    plan, _ = planned([write_long(tmp_path, curves)], **answers)
    gaps = np.array([row.depth for row in plan.rows]) - depths
    sds = np.array([row.depth_sd for row in plan.rows])
    assert (np.abs(gaps) < 3.5 * sds).all() and (sds < (2.0 if spacing > 1 else 1.0) * noise).all()
    cells = [[f"{depth:g}"] for depth in depths]
    plan, _ = planned([write_long(tmp_path, curves, head=["depth [mm]"], cells=cells)], **answers)
    assert [(row.depth, row.depth_sd) for row in plan.rows] == [(depth, 0.0) for depth in depths]


@pytest.mark.parametrize(
    ("stated", "bent", "named"),
    [("+-+-+", "+-+-+", ()), ("+-+-+", "+---+", ("n3",)), ("+-+-+", "+-0-+", ()), ("     ", "+---+", ())],
)
def test_a_needle_that_bends_against_its_stated_side_is_named_whether_its_pose_is_stated(
    tmp_path, stated, bent, named
):
    """Arcs of one direction, by 1.4 to 2.4 mm, 0 is straight; points err by 0.05 mm."""
    rng, x = np.random.default_rng(2), np.linspace(0.0, 1.0, 16)[:, None]
    lengths, signs = np.arange(50, 75, 5), np.array([{"+": 1, "-": -1, "0": 0}[sign] for sign in bent])
    curves = [size * x * [1, 0, 0] + side * (4e-4 * (size * x) ** 2 + 8e-3 * size * x) * [0, 1, 0]
              for size, side in zip(lengths, signs, strict=True)]  # fmt: skip
    curves = [curve + rng.normal(0.0, 0.05, curve.shape) * [0, 1, 1] for curve in curves]
    sides = [[f"{sign}1".strip(" 1") and f"{sign}1"] for sign in stated]
    file = write_long(tmp_path, curves, head=["bevel side"], cells=sides)
    poses = ({}, {"pose": "1,0,0", "bevel": "0,1,0"})
    for n, pose in enumerate(poses if stated.strip() else poses[:1]):
        folder = write_placed(tmp_path / f"{n}", [file], point_sd="0.05", **pose)
        found = [one.insertions for one in inspect(folder).warnings if one.kind == "bevel_side"]
        assert found == ([named] if named else [])


def import_turned(folder, turns=TURNS, **answers):
    """Import the four needles with their turns; return the folder of the dataset."""
    (folder / "turns.csv").write_text(turns)
    paths = [CASES / "two_plane.csv", folder / "turns.csv"]
    return write_placed(folder / "gel", paths, **answers)


def test_tables_of_turns_and_curvatures_belong_to_needles_of_their_names(tmp_path):
    (tmp_path / "turns.csv").write_text(TURNS)
    (tmp_path / "bragg.csv").write_text(CURVATURES)
    paths = [CASES / "two_plane.csv", tmp_path]
    assert "pose=0.999,0.038,-0.037" in refusal(DataError, "pose", planned, paths).what
    refusal(DataError, "turn", planned, paths, pose="1,0,0", bevel="bend")
    plan, made = planned(paths, pose="1,0,0")
    toward = [float(text) for text in made["bevel"][0].split(",")]  # as they bend before they are turned
    assert made["bevel"][1] == "assumed" and toward == approx([0, 1, 0], abs=0.03)
    assert made["turns, curvatures"][1] == "files"
    assert made["bevel_roll_sd"][1] == "assumed"
    assert [np.degrees(row.turns).tolist()[0][1] for row in plan.rows] == approx([90.0] * 4)
    assert plan.rows[2].turns[0][0] == 40.0 and plan.rows[1].curvature is None
    wanted = [[10, 1e-4, 3.3e-3, 1e-4], [40, 3.3e-3, -2e-4, 1e-4]]
    assert_allclose(plan.rows[0].curvature, wanted, atol=1e-9)
    # from up, where bevels that face right have their roll of 0
    plan, _ = planned(paths, pose="1,0,0", bevel="0,1,0", bevel_side="90 deg")
    assert_allclose(plan.rows[0].curvature[0], [10, 3.3e-3, -1e-4, 1e-4], atol=1e-9)
    assert plan.rows[0].turns[0][1] == approx(0.0) and plan.rows[0].bevel == approx([0, 0, 1])


def test_needles_that_were_turned_are_fitted_by_the_path_angle_and_missed_by_less_than_0_3_mm(tmp_path):
    """Two arcs of one curvature at right angles, of no model."""
    folder = import_turned(tmp_path, **SHARP)
    found = score_study(f"{folder}/gel_study.toml", jobs=1)
    errors = found[found["method"] == "fitted"].groupby("role")["te_mm"].mean()
    assert errors.max() < 0.2 and {*errors.index} == {"tune", "validate"}
    # the scene of the deepest needle, to be predicted, turns as that did
    steps = resolve_steps(load(folder / "scene.toml", SceneRecord))
    assert [step.depth_mm for step in steps] == approx([45.0, 90.851], abs=1e-3)
    assert [step.bevel.roll_deg or 0.0 for step in steps] == approx([0.0, 90.0])


@pytest.mark.parametrize(
    ("signs", "named"), [((1, 1), []), ((-1, 1), ["y"]), ((1, -1), ["z"]), ((-1, -1), ["y", "z"])]
)
def test_curvatures_of_the_wrong_sign_are_named_with_their_column(tmp_path, signs, named):
    """Two arcs of a radius of 300 mm: toward +y up to half the depth, then toward +z."""
    folder, rows = import_turned(tmp_path, **SHARP), ["id,s_mm,kappa_y_1_per_mm,kappa_z_1_per_mm,sd_1_per_mm"]
    for one in read(folder).insertions:
        for part, y, z in ((0.9, 1, 0), (0.6, 1, 0), (0.4, 0, 1), (0.1, 0, 1)):
            rows.append(
                f"{one.id},{part * one.depth:.2f},{signs[0] * y / 300:.6f},{signs[1] * z / 300:.6f},1e-4"
            )
    (folder / "curvature.csv").write_text("\n".join(rows))
    stated = (
        (folder / "dataset.toml").read_text().replace('turns = "', 'curvature = "curvature.csv"\nturns = "')
    )
    (folder / "dataset.toml").write_text(stated)
    found = [one.what for one in inspect(folder).warnings if one.kind == "curvature"]
    assert [next(axis for axis in "yz" if f"kappa_{axis}" in what) for what in found] == [*named]


@pytest.mark.parametrize(("roll", "aside"), [(90, False), (45, False), (0, True), (180, True), (-90, True)])
def test_needles_are_judged_beside_the_turns_that_are_stated(tmp_path, roll, aside):
    """They were turned by 90 degrees: in a table of turns, as without one, another turn is wrong."""
    turns = TURNS.replace(",90", f",{roll}").replace("id,", "needle,")
    dataset = read(import_turned(tmp_path, turns, pose="1,0,0", bevel="0,1,0"))
    assert ("bevel_plane" in {one.kind for one in dataset.warnings}) == aside
    away = {name: mm for name, mm, _ in measure_out_of_plane(dataset)}
    wanted = [1.5, 2.2, 2.7, 3.4] if aside else [0.0] * 4
    assert [away[f"q{n}"] for n in range(1, 5)] == approx(wanted, abs=0.15)
    (fix,) = (one.fix for one in dataset.warnings if one.kind == "bevel_plane") if aside else ("",)
    assert ("`bevel_roll_deg`" in fix) == (roll == -90)


def test_a_log_of_tip_poses_is_a_track_and_not_the_shape_of_one_needle(tmp_path):
    out = tmp_path / "em"
    lines = (CASES / "em.csv").read_text().splitlines()
    lines[4] = lines[4].replace("15.030,0.259,0.016", "MISSING,MISSING,MISSING")
    (tmp_path / "em.csv").write_text("\n".join(lines))
    assert "holds" in prepare([CASES / "em.csv"]).mapping.assumed
    write_placed(
        out,
        [tmp_path / "em.csv"],
        holds="tracks",
        bevel="0,1,0",
        medium="gel",
        missing='["MISSING"]',
    )
    dataset = read(out)
    (track,) = dataset.insertions
    assert (track.id, track.medium) == ("em", "gel")
    assert track.points[:, 0].tolist() == [0.0, 5.0, 10.0, *np.arange(20.0, 61.0, 5.0)]
    assert track.points[[0, -1], 1] == approx([0.086, 2.978]) and not track.guide.y.any()
    assert np.ptp(track.points[:, 2]) > 0 and not track.guide.z.any()
    written = {"dataset.toml", "mapping.toml", "tracks.csv", "tissue.toml", "em_fit.toml", "scene.toml"}
    assert {path.name for path in out.iterdir()} == written


@pytest.mark.parametrize("sides", [(1, 1), (1, -1)])
def test_the_bevel_of_logs_is_across_the_needle_and_asked_for_where_tips_bend_to_several_sides(
    tmp_path, sides
):
    """As a tracker of NDI writes them: far from the origin, with a row without coordinates."""
    depths, noise = np.arange(0.0, 75.0, 6.0), np.random.default_rng(5)
    rows = []
    for run_, side in enumerate(sides):
        tips = np.column_stack([100 + depths, side * depths**2 / 520, -40 + 0 * depths])
        tips += noise.normal(0.0, 0.1, tips.shape)
        rows += [f"r{run_},{n},{x},{y},{z},1,{6 * n}" for n, (x, y, z) in enumerate(tips)]
    rows[4] = "r0,4,MISSING,MISSING,MISSING,1,24.0"
    (tmp_path / "log.csv").write_text("\n".join(["run,Frame,Tx,Ty,Tz,Q0,Depth [mm]", *rows]))
    if sides[1] < 0:
        refusal(DataError, "--set bevel", planned, [tmp_path])
        return
    _, made = planned([tmp_path])
    assert made["bevel_side"] == ("1", "assumed") and "missing" in made
    for points in points_of([tmp_path], holds="tracks"):
        assert np.ptp(points.values[:, 0]) == approx(depths[-1] ** 2 / 520, abs=0.4)


def test_needles_that_differ_are_each_their_own(tmp_path):
    cells = [["22G", "", "60"], ["18G", "", "60"], ["22G", "", "60"]]
    file = write_long(tmp_path, NEEDLES, head=["gauge", "bore (mm)", "modulus (GPa)"], cells=cells)
    _, plan, made = placed([file], inner_diameter="0.2")
    assert [row.needle for row in plan.rows] == ["needle1", "needle2", "needle1"]
    diameters = {name: one.outer_diameter_mm for name, one in plan.needles.items()}
    assert diameters == {"needle1": GAUGES_MM[22], "needle2": GAUGES_MM[18]}
    assert {one.inner_diameter_mm for one in plan.needles.values()} == {0.2}
    assert "diameter" not in made and made["inner_diameter"] == ("0.2", "stated")
    write_placed(tmp_path / "gel", [file])
    found = {one.id: one.needle.flexural_rigidity for one in read(tmp_path / "gel").insertions}
    assert found["n2"] / found["n1"] == approx((GAUGES_MM[18] / GAUGES_MM[22]) ** 4)


@pytest.mark.parametrize(
    ("depths", "media"),
    [(("20", "21"), ["medium1"]), (("20", "15;35"), ["A", "B"]), (("20", "3.2"), None)],
)
def test_boundaries_that_differ_between_specimens_are_of_media_or_asked_about(tmp_path, depths, media):
    cells = [
        [name, f'"{depth}"'] for name, depth in zip("AABB", [d for d in depths for _ in "12"], strict=True)
    ]
    file = write_long(tmp_path, [needle(n) for n in range(4)], head=["specimen", "boundary"], cells=cells)
    if media is None:
        assert "medium=specimen" in refusal(DataError, "", planned, [file]).fix
        media = ["gel"]
    stated = {"medium": "gel"} if media == ["gel"] else {}
    assert [*planned([file], **stated)[0].boundaries_mm] == media


def test_a_column_of_deviations_is_that_of_each_point(tmp_path):
    rows = [["needle", "x", "y", "z", "sd"]]
    rows += [["a", *point, 0.1 + 0.01 * n] for n, point in enumerate(NEEDLES[0])]
    content, _, made = placed([write_rows(tmp_path / "a.csv", rows)])
    assert_allclose(content.curves[0].points.sd, 0.1 + 0.01 * np.arange(16))
    assert made["point_sd"][1] == "assumed"
    rows = [[*row[:-1], 0.07] if n else row for n, row in enumerate(rows)]
    content, plan, made = placed([write_rows(tmp_path / "a.csv", rows)])
    assert content.curves[0].points.sd is None and plan.point_sd_mm == 0.07
    assert "point_sd" not in made


def test_poses_of_a_tip_without_depths_go_along_the_stage_axis(tmp_path):
    rows = [["time", *(f"T{i}{j}" for i in range(1, 5) for j in range(1, 5))]]
    for n, (x, y, z) in enumerate(NEEDLES[0]):
        rows.append([n, 1, 0, 0, 50 + z, 0, 1, 0, y, 0, 0, 1, -x, 0, 0, 0, 1])
    file = write_rows(tmp_path / "a.csv", rows)
    assert "--set holds=tracks" in refusal(DataError, "tracks", planned, [file]).fix
    content, _, made = placed([file], holds="tracks")
    assert made["pose"] == ("0,0,-1", "assumed") and made["depth"][1] == "assumed"
    assert_allclose(content.curves[0].depths, NEEDLES[0][:, 0], atol=1e-9)
    assert np.ptp(content.curves[0].line[:, 0]) == approx(np.ptp(NEEDLES[0][:, 1]))
    content, _, _ = placed([file], holds="tracks", entry_point="50,0,-10")
    assert content.curves[0].depths[0] == approx(2.0)  # readings before it are left out


@pytest.mark.parametrize("guide", ["2", "none", "3"])
def test_one_of_two_tools_may_be_the_guide(tmp_path, guide):
    head = ["Frame", "Time", *["Q0", "Qx", "Qy", "Qz", "Tx", "Ty", "Tz", "Error"] * 2]
    rows = [
        [n, n / 60, 1, 0, 0, 0, x, y, z, 0.1, 1, 0, 0, 0, -20.0, 0.1 * n, 5.0, 0.1]
        for n, (x, y, z) in enumerate(NEEDLES[0])
    ]
    files = [write_rows(tmp_path / name, [head, *rows]) for name in ("log_1.csv", "log_2.csv")]
    answers = {"holds": "tracks", "bevel": "0,1,0"}
    assert (
        "--set z.column=9 --set 'guide.column=15|16|17'"
        in refusal(DataError, "tracked", planned, files, **answers).fix
    )
    named = {"x__column": "7", "y__column": "8", "z__column": "9", "guide__column": "15|16|17"}
    first, _ = placed(files, **answers, **named)[0].curves
    assert_allclose(first.guide[:, 0], 0.1 * np.arange(16))
    if guide == "3":
        refusal(DataError, "guide", planned, files, **answers, guide=guide)
    if guide == "none":  # the other tool stands beside the way of the tip
        assert "leave_out=2,2-2" in refusal(DataError, "", planned, files, **answers, guide=guide).fix
        assert len(placed(files, **answers, guide=guide, leave_out="2,2-2")[0].curves) == 2
    if guide == "2":
        content, _, made = placed(files, **answers, guide=guide)
        assert len(content.curves) == 2 and made["guide"] == ("2", "stated")
        assert_allclose(content.curves[0].guide[:, 0], 0.1 * np.arange(16))
        write_placed(tmp_path / "runs", files, **answers, guide=guide)
        run, _ = read(tmp_path / "runs").insertions
        assert_allclose(run.guide.y, 0.1 * np.arange(16), atol=1e-4)


@pytest.mark.parametrize("named", [True, False])
def test_depths_of_a_stage_are_those_at_the_times_of_the_camera(tmp_path, named):
    """The stage goes 10 mm a second, read at other times than the tip, which the camera sees too early."""
    rows = [("r", t, 4e-2 * (t - 0.05) ** 2) for t in np.arange(-0.45, 6.0, 0.5)]
    write_table(camera := tmp_path / "camera.csv", "run,time [s],tip y [mm]", rows)
    stage = [("r", t, 10 * t) for t in np.arange(0.0, 7.0)]
    rows = stage if named else [row[1:] for row in stage]
    write_table(other := tmp_path / "b.csv", f"{'run,' * named}time [s],depth [mm]", rows)
    assert "depths" in refusal(DataError, "nothing states the depths", planned, [camera], holds="tracks").what
    _, plan, _ = placed([camera, other], holds="tracks", depth_zero="tissue")
    (curve,) = plan.curves
    assert_allclose(curve.depths, np.arange(0.5, 60.0, 5.0), atol=1e-9)
    assert_allclose(curve.line[:, 0], 4e-4 * np.arange(0.0, 60.0, 5.0) ** 2, atol=1e-9)


def test_tips_in_space_have_the_depths_of_a_stage_that_rests_before_it_moves(tmp_path):
    times = np.arange(0.0, 8.0, 0.5)
    depths = 10 * np.maximum(times - 2.0, 0.0)
    tips = [("r", t, 7.0 + depth, 1e-3 * depth**2, 5.0) for t, depth in zip(times, depths, strict=True)]
    write_table(log := tmp_path / "log.csv", "run,time [s],tip x [mm],tip y [mm],tip z [mm]", tips)
    write_table(
        stage := tmp_path / "b.csv", "run,time [s],depth [mm]", [("r", 0, 0), ("r", 2, 0), ("r", 7, 50)]
    )
    (curve,) = placed([log, stage], holds="tracks", pose="1,0,0", bevel="0,1,0")[1].curves
    assert_allclose(curve.depths, np.arange(0.0, 51.0, 5.0), atol=1e-9)
    assert_allclose(curve.line[:, 0], 1e-3 * np.arange(0.0, 51.0, 5.0) ** 2, atol=1e-9)


@pytest.mark.parametrize(("zero", "deepest"), [("8", 42.0), ("first_reading", 50.0)])
def test_depths_along_the_path_of_a_tip_count_from_the_stated_contact(tmp_path, zero, deepest):
    tips = [("r", n, 7.0 + n, 1e-3 * n**2, 5.0) for n in range(51)]
    write_table(log := tmp_path / "log.csv", "run,time [s],tip x [mm],tip y [mm],tip z [mm]", tips)
    options = {"holds": "tracks", "pose": "1,0,0", "bevel": "0,1,0", "depth_zero": zero}
    (curve,) = placed([log], **options)[1].curves
    assert_allclose(curve.depths[[0, -1]], [0.0, deepest], atol=1e-9)


def test_a_shape_that_begins_behind_its_entry_is_as_deep_as_stated(tmp_path):
    """Its points state a depth each, the last one of 60 mm; the first one is 5 mm behind the entry."""
    rows = [("n1", depth, depth + 13.0, 0.0, 0.0, "13,0,0") for depth in np.arange(5.0, 61.0, 5.0)]
    text = "needle;depth [mm];x [mm];y [mm];z [mm];entry point [mm]\n"
    (file := tmp_path / "a.csv").write_text(text + "".join(";".join(map(str, row)) + "\n" for row in rows))
    options = {"holds": "shapes", "point_sd": "0.1"}
    (curve,) = placed([file], pose="free", **options)[1].curves
    assert curve.depth == 60.0
    fix = refusal(DataError, "5.0 mm", placed, [file], pose="1,0,0", bevel="0,1,0", **options).fix
    assert "--set entry_point=first" in fix


def test_one_of_two_tools_in_rows_of_their_own_may_be_left_out(tmp_path):
    """A log of two runs, in which a reading is lost; a table names the runs and their bevels."""
    rows = [
        [run, n, tool, *(point if tool == "tip" else [0, 0, 0]), "MISSING" if n == 3 else "OK"]
        for run in (1, 2)
        for n, point in enumerate(NEEDLES[0])
        for tool in ("tip", "reference")
    ]
    file = write_rows(tmp_path / "a.csv", [["run", "time", "tool", "x", "y", "z", "status"], *rows])
    bevels = write_rows(tmp_path / "b.csv", [["run", "bevel side"], [1, 1], [2, -1]])
    answers = {"holds": "tracks", "bevel": "0,1,0"}
    fix = refusal(DataError, "tracked", planned, [file, bevels], **answers).fix
    words = '{"reference" = "excluded", "MISSING" = "excluded"}'
    assert f"--set 'excluded.column=tool|status' --set 'excluded.words={words}'" in fix
    stated = {"excluded__column": "tool|status", "excluded__words": words}
    _, plan, _ = placed([file, bevels], **answers, **stated)
    assert [(row.id, row.side) for row in plan.rows] == [("1", 1), ("2", -1)]
    assert [len(curve.line) for curve in plan.curves] == [15, 15]


def test_sensors_may_be_placed_from_the_base(tmp_path):
    write_long(tmp_path, NEEDLES[:1])
    rows = [
        ["needle", "sensor location from base [mm]", "curvature_x [1/m]", "curvature_y [1/m]", "sd [1/m]"]
    ]
    write_rows(tmp_path / "bragg.csv", [*rows, ["n1", 120, 2.0, 0.1, 0.05], ["n1", 150, 1.0, 0.2, 0.05]])
    named = {"curvature_y__column": "curvature_x [1/m]", "curvature_z__column": "curvature_y [1/m]"}
    answers = {"pose": "1,0,0", "bevel": "0,1,0", "needle_length": "165"}
    assert "curvature_z.column=" in refusal(DataError, "curvature_z", planned, [tmp_path], **answers).fix
    _, plan, _ = placed([tmp_path], **named, **answers)
    wanted = [[45.0, 2e-3, 1e-4, 5e-5], [15.0, 1e-3, 2e-4, 5e-5]]
    assert_allclose(plan.rows[0].curvature, wanted, atol=1e-12)


def test_a_moving_base_is_the_guide_only_where_that_is_stated(tmp_path):
    lines = list(enumerate(NEEDLES[0].tolist()))
    rows = [["time", "tip x", "tip y", "tip z", "base x", "base y", "base z"]]
    rows += [[n, *point, -20.0, 0.1 * n, 5.0] for n, point in lines]
    columns = write_rows(tmp_path / "columns.csv", rows)
    pairs = [[(n, "tip", *point), (n, "base", -20.0, 0.1 * n, 5.0)] for n, point in lines]
    rows = [["time", "tool", "x", "y", "z"], *(row for pair in pairs for row in pair)]
    answers = {"holds": "tracks", "bevel": "0,1,0", "pose": "1,0,0"}
    for file, stated, status in (
        (columns, {}, "assumed"),
        (write_rows(tmp_path / "rows.csv", rows), {"guide": "base"}, "stated"),
    ):
        content, _, made = placed([file], **answers, **stated)
        assert_allclose(content.curves[0].guide[:, 0], 0.1 * np.arange(16), atol=1e-9)
        assert made["guide"][1] == status
    assert placed([columns], **answers, guide="none")[0].curves[0].guide is None


ENTERED = {"pose": "1,0,0", "entry_point": "0,0,0", "bevel": "0,1,0", "specimen": "block"}


def bend(**depths):
    """Return rows (name, depth, deflection), mm, of needles of these depths, 5 mm apart."""
    return [(name, x, 6e-4 * x**2) for name, depth in depths.items() for x in range(0, depth + 1, 5)]


def test_readings_and_points_have_errors_of_their_own(tmp_path):
    """What a file states of its needles is theirs; the least is that of the dataset."""
    shapes = [(*row, 0.2) for row in bend(a=60)]
    write_table(file := tmp_path / "a.csv", "needle,x [mm],y [mm],sd [mm]", shapes)
    write_table(tracks := tmp_path / "b.csv", "run,depth [mm],deflection [mm]", bend(r=60))
    data = read(write_placed(tmp_path / "out", [file, tracks], point_sd="0.05", **ENTERED))
    assert {one.id: data.noise.of(one).point_sd for one in data.insertions} == {"a": 0.2, "r": 0.05}


def test_a_tip_of_the_name_and_depth_of_a_shape_is_of_this_needle(tmp_path):
    shapes = [(n, s := 1 if n == "a" else -1, x, s * y, 5) for n, x, y in bend(a=60, b=60)]
    write_table(file := tmp_path / "a.csv", "needle,bevel side,x [mm],y [mm],z [mm]", shapes)
    tips = [("a", 60.0, 2.3, 0.03), ("a", 60.0, 2.4, 0.04), ("b", 40.5, -1.1, 0.05)]
    write_table(other := tmp_path / "b.csv", "needle,depth [mm],deflection [mm],sd [mm]", tips)
    stated = {"pose": "1,0,0", "bevel": "0,1,0", "point_sd": "0.1"}
    write_placed(out := tmp_path / "out", [file, other], **stated)
    one, two, further = read(out).insertions
    assert one.tip[0] == approx((2.3 * 16 + 2.4 * 9) / 25) and one.tip[2] == approx(0.024)
    assert one.observation == "points" and two.tip is None
    assert (further.id, further.observation, further.deflection) == ("b-2", "tip", approx(-1.1))


def test_a_track_of_the_name_and_depth_of_a_shape_is_of_the_same_insertion(tmp_path):
    """It shares bevel and fold with the shape; one that ends elsewhere is an insertion of its own."""
    write_table(file := tmp_path / "a.csv", "needle,x [mm],y [mm]", bend(a=60, b=60))
    write_table(tracks := tmp_path / "b.csv", "needle,depth [mm],deflection [mm]", bend(a=60, b=40))
    data = read(write_placed(tmp_path / "out", [file, tracks], point_sd="0.1", **ENTERED))
    folds = divide_insertions(data.insertions, "insertion")
    assert [[one.id for one in held] for held in folds.values()] == [["a", "a-2"], ["b"], ["b-2"]]
    first, *others = list_bevels(data, data.insertions)
    assert others.count(first) == 1 and len({first, *others}) == 3


@pytest.mark.parametrize("step", [0.1, 0.5, 5.0])
def test_noise_is_no_stray_point(step):
    random = np.random.default_rng(round(10 * step))
    for _ in range(100):
        curve = needle(0, int(60 / step) + 1)
        assert not len(find_stray_points(curve + random.normal(0.0, 0.2, curve.shape)))
        cluster = np.vstack([curve[: max(4, len(curve) // 8)], curve[-1:]])  # dense at the entry, and the tip
        assert not len(find_stray_points(cluster))


def write_table(path, head, rows):
    path.write_text("\n".join([head, *(",".join(map(str, row)) for row in rows)]) + "\n")


def test_an_import_replaces_an_earlier_one_and_nothing_else(tmp_path):
    file, out = write_long(tmp_path, NEEDLES), tmp_path / "gel"
    for medium in ("agar", "gelatine"):
        write_import(out, prepare([file], medium=medium), overwrite=True)
        assert {one.medium for one in read(out).insertions} == {medium}
    refusal(ConfigError, "exists", write_import, out, prepare([file]))
    (out / "notes.txt").write_text("mine")
    refusal(ConfigError, "notes.txt", write_import, out, prepare([file]), overwrite=True)
    assert (out / "notes.txt").read_text() == "mine"


@pytest.mark.parametrize(("head", "axes"), [("guide z", ""), ("guide y", "z"), ("guide [mm]", "z")])
def test_a_guide_is_placed_along_the_axis_of_its_column(tmp_path, head, axes):
    rows = [["time", "tip x", "tip y", "tip z", "depth", head]]
    rows += [[n, 5.0, x, 1e-3 * x**2, x, 3.0 * x / 60.0] for n, x in enumerate(np.linspace(0.0, 60.0, 31))]
    file = write_rows(tmp_path / "log.csv", rows)
    if axes:  # along the needle, or along no stated axis: its motion would be lost
        assert f"guide.axes={axes}" in refusal(DataError, "guide", planned, [file]).fix
    content, _, _ = placed([file], **({"guide__axes": axes} if axes else {}))
    assert_allclose(content.curves[0].guide[[0, -1], 0], [0.0, 3.0], atol=1e-9)


@pytest.mark.parametrize("kind", ["Fiducial", "Plane"])
def test_points_and_planes_of_slicer_are_boundaries(tmp_path, kind):
    for n, curve in enumerate(NEEDLES):
        write_markups(tmp_path / f"n{n}.mrk.json", f"n{n}", curve)
    points = np.array([[20.0, -30.0, -30.0], [20.0, 40.0, -30.0], [20.0, 0.0, 50.0]])
    write_markups(tmp_path / "layer.mrk.json", "layer", points, kind)
    stated = {"pose": "1,0,0", "entry_point": "first"}
    if kind == "Fiducial":
        fix = refusal(DataError, "of 3 points", planned, [tmp_path], **stated).fix
        assert "--set surfaces=layer.mrk.json" in fix
        stated["surfaces"] = "layer.mrk.json"
    plan, _ = planned([tmp_path], **stated)
    assert [surface.name for surface in plan.surfaces] == ["layer"]
    assert [row.layers for row in plan.rows] == [2, 2, 2]
    data = read(write_placed(tmp_path / "data", [tmp_path], **stated))
    assert data.insertions[0].boundaries == approx([20.0], abs=0.1)
    write_markups(tmp_path / "layer.mrk.json", "layer", points[0] + np.outer(np.arange(5.0), [0, 1, 0]))
    refusal(DataError, "no plane", planned, [tmp_path], **stated | {"surfaces": "layer.mrk.json"})


@pytest.mark.parametrize("by_reading", [True, False])
def test_a_bevel_may_turn_between_the_readings_of_a_run(tmp_path, by_reading):
    """Two runs in the frame of a tracker; up to 20 mm they bend toward y, as their bevels face."""
    facing, rows = {"a": (0, 180), "b": (180, 90)}, []
    for name, (first, then) in facing.items():
        side = 1 - first / 90
        for x in np.arange(0.0, 61.0, 5.0):
            roll = f"{then if x > 20 else first} deg" if by_reading else f"{first} deg"
            rows.append((name, roll, x, x, 4e-4 * side * min(x, 20.0) ** 2, 0.0))
    head = "run,roll,depth [mm],tip x [mm],tip y [mm],tip z [mm]"
    write_table(file := tmp_path / "a.csv", head, rows)
    turns = [(name, 20, f"{then} deg") for name, (_, then) in facing.items()]
    write_table(beside := tmp_path / "turns.csv", "run,turn depth [mm],bevel side", turns)
    files = [file] if by_reading else [file, beside]
    runs = read(write_placed(tmp_path / "out", files, holds="tracks", point_sd="0.1")).insertions
    assert [(run.side, run.turns) for run in runs] == [(1, ((20.0, 180.0),)), (-1, ((20.0, 270.0),))]
    assert runs[0].points[4] == approx([20, 0.16, 0], abs=1e-3)


def test_tips_at_a_tracker_are_read_across_the_insertion_and_rolled_from_the_stated_up(tmp_path):
    """Four runs off all axes, whose bevels face 12, 3, 6 and 9 o'clock; and one of 4 readings.

    Of each a reading is lost, and one is 0.05 mm less deep than that before, by noise.
    """
    frame = np.linalg.qr(np.array([[0.7, 0.2, -0.6], [0.1, 0.9, 0.3], [0.0, 0.0, 1.0]]).T)[0] * [-1, -1, 1]
    along, up = frame.T[:2]
    right, rows = np.cross(along, up), []
    for name, clock, toward in zip("abcd", (12, 3, 6, 9), (up, right, -up, -right), strict=True):
        depths = np.insert(np.arange(0.0, 61.0, 5.0), 5, 19.95)
        tips = [x * along + 4e-4 * x**2 * toward for x in depths]
        rows += [(name, clock, 0.5 * n, *tip, "OK") for n, tip in enumerate(tips)]
        rows.append((name, clock, 9.0, 0, 0, 0, "MISSING"))
    rows += [("e", 12, n, *(n * along), "OK") for n in range(4)]
    write_table(file := tmp_path / "a.csv", "run,bevel clock,time,tip x,tip y,tip z,status", rows)
    stated = {"holds": "tracks", "unit": "mm", "point_sd": "0.1", "pose": ",".join(map(str, along))}
    assert "--set bevel=" in refusal(DataError, "several ways", planned, [file], **stated).fix
    stated["bevel"] = ",".join(map(str, up + 0.3 * along))
    fault = refusal(DataError, "4 readings", write_placed, tmp_path / "x", [file], **stated)
    assert "--set leave_out=e" in fault.fix
    runs = read(write_placed(tmp_path / "out", [file], leave_out="e", specimen="one", **stated)).insertions
    assert [[turn for _, turn in run.turns] for run in runs] == [[], [90.0], [180.0], [270.0]]
    assert [len(run.points) for run in runs] == [13] * 4
    assert [run.deflection for run in runs] == approx([1.44] * 4, abs=1e-3)
    ends = [run.points[-1, 1:] for run in runs]
    assert_allclose(ends, 1.44 * np.array([[1, 0], [0, 1], [-1, 0], [0, -1]]), atol=1e-3)
    along_needle = stated | {"bevel": stated["pose"]}
    refusal(DataError, "60 degrees", planned, [file], **along_needle)


def test_a_needle_that_is_a_tenth_as_long_or_has_a_gauge_in_its_name_is_asked_about(tmp_path):
    file = write_long(tmp_path, [*NEEDLES, needle(1, 16) / 10.0])
    assert "leave_out=n4" in refusal(DataError, "n4 is 5.", planned, [file]).fix
    assert len(planned([file], leave_out="n4")[0].rows) == 3
    assert len(planned([file], lengths="differ")[0].rows) == 4
    file = write_long(tmp_path, [NEEDLES[0] / 10.0], head=["depth [mm]"], cells=[["60"]])
    fix = refusal(DataError, "depth", planned, [file], entry_point="first").fix
    assert "--set unit=cm" in fix
    file.write_text(write_long(tmp_path, NEEDLES).read_text().replace("n1,", "22G x 150 mm,"))
    assert "--set diameter=22G" in refusal(DataError, "22G", planned, [file]).fix


def test_rows_of_swapped_columns_and_an_entry_in_another_unit_are_named(tmp_path):
    curves = [needle(n) for n in range(4)]
    curves[1] = curves[1][:, [1, 0, 2]]
    rows = [[f"n{n}", *point] for n, curve in enumerate(curves) for point in curve]
    points = write_rows(tmp_path / "a.csv", [["needle", *"xyz"], *rows])
    fix = refusal(DataError, "n1", prepare, [points], pose="1,0,0").fix
    assert "a.csv:18" in fix and "--set" not in fix
    shifted = [[name, 1e3 + x, y, z] for name, x, y, z in rows if name != "n1"]
    points = write_rows(tmp_path / "b.csv", [["needle", *"xyz"], *shifted])
    names = [[f"n{n}", 1.005, 0.003 * n, 0.0] for n in (0, 2, 3)]
    facts = write_rows(tmp_path / "c.csv", [["needle", *(f"entry {axis}" for axis in "xyz")], *names])
    fix = refusal(DataError, "N0|n0", prepare, [points, facts], pose="1,0,0").fix
    assert "--set entry_point.unit=m" in fix
    plan = prepare([points, facts], pose="1,0,0", entry_point__unit="m").plan
    assert [row.entry[0] for row in plan.rows] == approx([1005.0] * 3)


def test_curvatures_at_several_depths_are_insertions_of_one_hole(tmp_path):
    rows = [
        (name, depth, sensor, 0.01 * depth, 0.0) for name in "ab" for depth in (20, 40) for sensor in (5, 10)
    ]
    header = "needle,depth [mm],distance from tip [mm],curvature y [1/m],curvature z [1/m]"
    write_table(read := tmp_path / "fbg.csv", header, rows)
    write_table(facts := tmp_path / "facts.csv", "needle,bevel side", [("a", 1), ("b", -1)])
    _, plan, _ = placed([read, facts], pose="1,0,0", bevel="0,1,0")
    assert [(row.id, row.depth, row.hole, row.side) for row in plan.rows] == [
        *(("a-20", 20.0, "a", 1), ("a-40", 40.0, "a", 1)),
        *(("b-20", 20.0, "b", -1), ("b-40", 40.0, "b", -1)),
    ]
    assert_allclose([curve.sensors[0][1] for curve in plan.curves], [2e-4, 4e-4, 2e-4, 4e-4])


def test_the_table_of_free_shapes_has_their_deflections_from_the_direction_that_fits_all(tmp_path):
    """Errors of 0.1 mm let the first direction of one needle err by more than its deflection."""
    rng, x, rows = np.random.default_rng(3), np.linspace(0.0, 60.0, 21), []
    for n in range(6):
        line = np.column_stack([x, (-1) ** n * 2.0 * (x / 60) ** 3, 0 * x]) + rng.normal(0, 0.1, (21, 3))
        rows += [(f"n{n}", *point, (-1) ** n) for point in line]
    write_table(file := tmp_path / "a.csv", "needle,x [mm],y [mm],z [mm],bevel side", rows)
    made = write_placed(tmp_path / "gel", [file], pose="free", bevel="0,1,0", point_sd="0.1")
    table = tabulate_needles(read(made))
    assert_allclose(table["deflection (mm)"], 2.0, atol=0.4)
    assert [*table["bends, from its bevel"]] == ["toward"] * 6


def test_the_table_names_a_needle_that_bends_across_the_plane_of_its_bevel(tmp_path):
    x = np.linspace(0.0, 60.0, 21)
    bends = {"a": (3.0, 0.0), "b": (0.0, 3.0), "c": (0.0, 0.05)}  # mm, toward the bevel and across
    rows = [(n, 60 * t, y * t**3, z * t**3, 1) for n, (y, z) in bends.items() for t in x / 60]
    write_table(file := tmp_path / "a.csv", "needle,x [mm],y [mm],z [mm],bevel side", rows)
    made = write_placed(tmp_path / "gel", [file], pose="1,0,0", bevel="0,1,0", point_sd="0.1")
    sides = tabulate_needles(read(made))["bends, from its bevel"]
    assert [*sides] == ["toward", "ACROSS", "not clear"]
