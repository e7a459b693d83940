"""Files that misled an import: what is read of each, or the option that its refusal names."""

from pathlib import Path

import pytest
from refusals import refusal
from test_import_habits import planned

from needlefit.errors import DataError
from needlefit.project.unit_warnings import GAUGES_MM

CASES = Path(__file__).with_name("imports")
DEPTHS = [45, 55, 65, 75, 85, 95]


@pytest.mark.parametrize(
    ("name", "columns", "options", "advised"),
    [
        ("posearray.csv", "", {}, "layout=rows"),
        ("posearray.csv", "", {"layout": "rows"}, "--units"),
        ("matrices.csv", "", {}, "--observable tracks"),
        ("photo_1.csv", "", {}, "--units"),
        ("photo_3.csv", "", {}, "--units"),
        ("bevel_angle.csv", "", {}, '"bevel angle=roll"'),
        ("curvatures_from_base.csv", "", {}, "curvature z=HEADER"),
        (
            "curvatures_from_base.csv",
            "curvature y=curvature_x [1/m],curvature z=curvature_y [1/m]",
            {},
            "reconstructed shapes",
        ),
        ("plan.dcm", "", {}, "CSV"),
        ("needle.vtk", "", {}, "CSV"),
    ],
)
def test_what_is_not_clear_is_refused_with_what_to_state(name, columns, options, advised):
    assert advised in refusal(DataError, "", planned, [CASES / name], columns, **options).fix


@pytest.mark.parametrize(
    ("names", "options", "depths"),
    [
        (["posearray.csv"], {"layout": "rows", "units": "m"}, [30, 40, 50, 60, 70, 80, 90]),
        ([f"photo_{n}.csv" for n in (1, 2, 3)], {"units": "0.0704 mm"}, [45, 55, 65]),
        (["catheters.txt"], {"entry": "last"}, DEPTHS),
        (["bevel_side_and_angle.csv"], {}, DEPTHS),
        (["bevel_angle.csv"], {"bevel_angle": "cut"}, DEPTHS),
        (["known_columns.csv"], {}, DEPTHS),
        (["gauge_22.csv"], {}, [40, 50, 60, 70, 80, 90]),
        (["shapes.jsonl"], {}, DEPTHS),
        (["needles_v73.mat"], {}, DEPTHS),
    ],
)
def test_needles_are_read_as_deep_as_they_were(names, options, depths):
    _, plan, _ = planned([CASES / name for name in names], **options)
    assert [row.depth for row in plan.rows] == pytest.approx(depths, abs=0.3)


def test_known_columns_are_those_of_the_needles():
    content, plan, made = planned([CASES / "known_columns.csv"])
    assert plan.boundaries_mm == {"pork": (20.0,)} and not content.unused
    assert (plan.needle.length_mm, plan.needle.youngs_modulus_gpa) == (200.0, 60.0)
    assert {made[what][1] for what in ("boundaries", "needle length", "modulus", "specimen")} == {"file"}
    _, plan, made = planned([CASES / "gauge_22.csv"])
    assert plan.needle.outer_diameter_mm == GAUGES_MM[22] and made["diameter"] == ("22G", "file")


def test_a_side_counts_where_a_bevel_angle_stands_beside_it():
    _, plan, made = planned([CASES / "bevel_side_and_angle.csv"])
    assert [row.side for row in plan.rows] == [1, -1] * 3 and made["bevel angle"] == ("cut", "file")


def test_matrices_of_a_tip_are_a_track_along_the_stage():
    content, plan, made = planned([CASES / "matrices.csv"], observable="tracks")
    assert made["pose"] == ("1,0,0", "guess") and made["depth"][1] == "assumption"
    assert content.curves[0].readings.depth[[0, -1]] == pytest.approx([0.0, 89.7], abs=0.1)
    assert plan.pose == "tracker"
