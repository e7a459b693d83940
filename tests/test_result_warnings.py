"""Warnings: their line, what a run keeps of them."""

from needlefit.project.result_warnings import ResultWarning, stored, warnings_of


def test_a_warning_is_one_line_and_a_run_keeps_its_file_without_the_folder():
    one = ResultWarning("units", "depth is 0.05", "/home/me/mine/insertions.csv:3", "write it in mm")
    assert str(one).startswith("/home/me/mine/insertions.csv:3: depth is 0.05") and "\n" not in str(one)
    assert stored([one, one])["warnings"] == [
        {"kind": "units", "what": "depth is 0.05", "where": "insertions.csv:3", "fix": "write it in mm"}
    ]
    assert [kept.where for kept in warnings_of(stored([one]))] == ["insertions.csv:3"]
    assert warnings_of({}) == ()
