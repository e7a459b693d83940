"""What tunes and what validates, by both readings of the needle that ends at a boundary."""

import pytest

from needlefit.project.locate import find_file
from needlefit.project.toml import load
from needlefit.reporting.table_files import to_records
from needlefit.schemas.study import StudyRecord
from needlefit.studies.job import Settings, prepare
from needlefit.studies.summary import tabulate_design


@pytest.mark.parametrize(
    ("study", "counts"),
    [  # role, layers, by the study's own reading, by the other: the paper's 9 + 5 and 8 + 6
        ("study1", [("tune", 4, 9, 8), ("tune", 3, 0, 1)]),
        ("study2", [("validate", 4, 8, 9), ("validate", 3, 6, 5)]),
        ("study3", [("validate", 3, 10, 10)]),
    ],
)
def test_a_needle_that_ends_at_a_boundary_is_counted_both_ways(study, counts):
    rows = to_records(
        tabulate_design(prepare(study, load(find_file("study", study), StudyRecord), Settings()))
    )
    role = counts[0][0]
    found = [r for r in rows if r["role"] == role and r["layers"] in {c[1] for c in counts}]
    keys = ("role", "layers", "insertions", "insertions_other")
    assert [tuple(row[key] for key in keys) for row in found] == counts
    assert all(row["depth_min_mm"] <= row["depth_max_mm"] for row in rows)
    assert all(0 < row["deflection_min_mm"] <= row["deflection_max_mm"] for row in rows)
