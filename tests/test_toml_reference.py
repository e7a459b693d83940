"""Every key of every TOML file has a meaning and an example in the reference of the site."""

import json
import re

import pytest
from docs_scripts import load_script
from test_cli import run

from needlefit.project import toml_reference as reference
from needlefit.project.locate import shipped_folder
from needlefit.project.toml import load
from needlefit.studies.explanations import find_topics
from needlefit.studies.kind import list_records
from needlefit.studies.report import lay_out_checks


@pytest.fixture(scope="module")
def page():
    """The program that writes the reference of the site."""
    pytest.importorskip("sphinx")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(shipped_folder() / "docs" / "_site")
        yield load_script(shipped_folder() / "docs" / "_site" / "toml_page.py")


def records_within(record, found):
    if record not in found:
        found.add(record)
        for field in record.model_fields.values():
            if inner := reference.find_record(field.annotation):
                records_within(inner, found)
    return found


def test_every_key_has_a_meaning_and_an_example(page):
    files, records = [one for one in reference.list_files(list_records()) if page.list_examples(one)], set()
    for file in files:
        records_within(file.record, records)
    keys = {(reference.find_owner(record, name), name) for record in records for name in record.model_fields}
    examples = {key for file in files for key in page.collect_examples(file)}
    assert {f"{record.__name__}.{name}" for record, name in keys - examples} == set()
    assert len(keys) > 200


def test_every_example_loads(page):
    for file in reference.list_files(list_records()):
        for path in page.list_examples(file):
            load(shipped_folder() / path, file.record)


def test_explain_lists_everything_and_names_what_is_near(capsys):
    assert run("explain", "--json") == 0
    keys = {one["key"] for one in json.loads(capsys.readouterr().out)}
    assert {"coverage", "te_mm", "stretch"} < keys
    assert run("explain", "te_m") == 2
    assert "te_mm" in capsys.readouterr().err


@pytest.mark.parametrize("kind", ["cross_validation", "fit", "identification", "prediction", "tracks"])
def test_explain_knows_every_word_of_page_one(kind, world):
    answer = world.restore(kind).answer
    checks = lay_out_checks(answer)
    tables = [*answer.tables, *([checks] if checks else [])]
    words = {column.label for table in tables for column in table.columns}
    rows = [row for table in tables if table.name in ("summary", "checks") for row in table.rows]
    words |= {row[0].partition(":")[0].partition(",")[0] for row in rows}
    words = {word for word in words if not word.startswith("Mean over ") and re.search("[^\\W\\d]", word)}
    assert not [word for word in words if not find_topics(word)]


def test_explain_prints_every_key_and_column_of_a_file(capsys):
    named = {
        "leave_out": ("insertion", "specimen"),
        "free": ("alpha1",),
        "aiming_width_mm": ("2.0", "95 %"),
        "bevel_side": ("+1", "-1"),
        "study": ("leave_out", "dataset", "recipe"),
        "insertions.csv": ("depth_mm", "bevel_side"),
    }
    for name, known in named.items():
        assert run("explain", name) == 0
        printed = capsys.readouterr().out
        assert all(word in printed for word in known), name
    files = reference.describe_files(reference.list_files(list_records()))
    keys = {key.key for _, tables in files for table in tables for key in table.keys}
    assert len(keys) > 150 and not [key for key in keys if not find_topics(key)]
