"""Every key of every TOML file has a meaning and an example, and `explain` prints it."""

import json

import pytest
from test_cli import run

from needlefit.project.locate import shipped_folder
from needlefit.project.toml import load
from needlefit.schemas.base import FileRecord
from needlefit.schemas.recording import RecordingRecord
from needlefit.studies import toml_reference as reference
from needlefit.studies.kind import KINDS
from needlefit.studies.toml_reference import list_files

NOT_WRITTEN_BY_HAND = ("needlefit.schemas.result_files",)


def records_within(record, found):
    if record not in found:
        found.add(record)
        for field in record.model_fields.values():
            if inner := reference.find_record(field.annotation):
                records_within(inner, found)
    return found


def test_every_key_has_a_meaning_and_an_example():
    files, records = [one for one in list_files() if one.examples], set()
    for file in files:
        records_within(file.record, records)
    keys = {(reference.find_owner(record, name), name) for record in records for name in record.model_fields}
    examples = {key for file in files for key in reference.collect_examples(file)}
    assert {f"{record.__name__}.{name}" for record, name in keys - examples} == set()
    assert len(keys) > 200


def test_every_example_loads():
    for file in list_files():
        for path in file.examples:
            load(shipped_folder() / path, file.record)


def test_every_file_in_the_folder_of_examples_is_one():
    used = {path for file in list_files() for path in file.examples}
    there = {f"docs/examples/{path.name}" for path in (shipped_folder() / "docs/examples").glob("*.toml")}
    assert there <= used


def test_every_schema_of_a_file_is_explained():
    documented = {file.record for file in list_files()}
    elsewhere = {*(KINDS[name].record for name in reference.WRITTEN_BY_COMMANDS), RecordingRecord}

    def missing(record):
        if record in documented | elsewhere or record.__module__ in NOT_WRITTEN_BY_HAND:
            return []
        inner = [one for one in record.__subclasses__() if one.__module__.startswith("needlefit.")]
        return [name for one in inner for name in missing(one)] if inner else [record.__name__]

    assert missing(FileRecord) == []


@pytest.mark.parametrize("file", list_files(), ids=lambda file: file.name)
def test_explain_prints_every_key_of_a_file(file, capsys):
    assert run("explain", file.name, "--json") == 0
    ((topic,)) = json.loads(capsys.readouterr().out)
    text = "\n".join(topic["paragraphs"])
    for record in records_within(file.record, set()):
        assert all(f"  {field.alias or name}: " in text for name, field in record.model_fields.items())


@pytest.mark.parametrize(
    ("name", "key"),
    [*((one, one) for one in ("coverage", "te_mm", "mu3_pa", "baseline", "stretch")), ("TE", "tip error")],
)
def test_explain_knows_warnings_columns_and_terms(name, key, capsys):
    assert run("explain", name, "--json") == 0
    assert {one["key"] for one in json.loads(capsys.readouterr().out)} == {key}


def test_explain_lists_everything_and_names_what_is_near(capsys):
    assert run("explain", "--json") == 0
    keys = {one["key"] for one in json.loads(capsys.readouterr().out)}
    assert {"coverage", "te_mm", "stretch", "study.toml"} < keys
    assert run("explain", "te_m") == 2
    assert "te_mm" in capsys.readouterr().err
