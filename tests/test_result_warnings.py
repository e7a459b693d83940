"""Warnings: their line, what a run keeps of them."""

import ast
import re
from pathlib import Path

import needlefit
from needlefit.project.help_pages import TROUBLESHOOTING_PAGE, read_sections
from needlefit.project.result_warnings import (
    ResultWarning,
    read_warnings,
    warnings_entry,
)
from needlefit.project.unit_warnings import WARNING_KIND


def test_a_warning_is_one_line_and_a_run_keeps_its_file_without_the_folder():
    one = ResultWarning("units", "depth is 0.05", "/home/me/mine/insertions.csv:3", "write it in mm")
    assert str(one).startswith("/home/me/mine/insertions.csv:3: depth is 0.05") and "\n" not in str(one)
    assert warnings_entry([one, one])["warnings"] == [
        {"kind": "units", "what": "depth is 0.05", "where": "insertions.csv:3", "fix": "write it in mm"}
    ]
    assert [kept.where for kept in read_warnings(warnings_entry([one]))] == ["insertions.csv:3"]
    assert read_warnings({}) == ()


def _kinds_in_sources() -> set[str]:
    """Return the kinds of all warnings that the package makes."""
    package = Path(needlefit.__file__).parent
    calls = [
        call
        for path in package.rglob("*.py")
        for call in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(call, ast.Call) and getattr(call.func, "id", "") == "ResultWarning" and call.args
    ]
    named = {WARNING_KIND if isinstance(call.args[0], ast.Name) else call.args[0].value for call in calls}
    assert len(calls) > len(named) > 10
    return named


def test_every_kind_of_warning_has_a_section_that_explains_it():
    sections = read_sections()
    page = (Path(__file__).parents[1] / TROUBLESHOOTING_PAGE).read_text(encoding="utf-8")
    assert set(sections) == set(re.findall(r"^\((.+)\)=$", page, re.MULTILINE))
    assert {ResultWarning(kind, "").help_key for kind in _kinds_in_sources()} <= set(sections)
    for one in sections.values():
        assert (
            one.title
            and one.paragraphs
            and not re.search(r"\]\(|\*\*|^#", "\n".join(one.paragraphs), re.MULTILINE)
        )
