"""Warnings: their line, what a run keeps of them."""

from needlefit.project.result_warnings import ResultWarning, read_warnings, warnings_entry


def test_a_warning_is_one_line_and_a_run_keeps_its_file_without_the_folder():
    one = ResultWarning("units", "depth is 0.05", "/home/me/mine/insertions.csv:3", "write it in mm")
    assert str(one).startswith("/home/me/mine/insertions.csv:3: depth is 0.05") and "\n" not in str(one)
    assert warnings_entry([one, one])["warnings"] == [
        {"kind": "units", "what": "depth is 0.05", "where": "insertions.csv:3", "fix": "write it in mm"}
    ]
    assert [kept.where for kept in read_warnings(warnings_entry([one]))] == ["insertions.csv:3"]
    assert read_warnings({}) == ()
