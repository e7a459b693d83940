"""Every key of every TOML file has a meaning and an example in the reference of the site."""

import json

import pytest
from docs_scripts import load_script
from test_cli import run

from needlefit.project import toml_reference as reference
from needlefit.project.locate import shipped_folder
from needlefit.project.toml import load
from needlefit.studies.kind import list_records


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
