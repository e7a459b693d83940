"""Every key of every TOML file is documented and has an example, and every example loads."""

import pytest
from docs_scripts import load_script

from needlefit.project.load import load
from needlefit.project.locate import shipped_folder
from needlefit.schemas.base import FileRecord
from needlefit.schemas.recording import RecordingRecord

DOCS = shipped_folder() / "docs"
NOT_WRITTEN_BY_HAND = ("needlefit.schemas.result_files",)
pytestmark = pytest.mark.skipif(not DOCS.is_dir(), reason="not run from the repository")


@pytest.fixture(scope="module")
def reference():
    return load_script(DOCS / "toml_reference.py")


def records_within(record, reference, found):
    if record not in found:
        found.add(record)
        for field in record.model_fields.values():
            if inner := reference.find_record(field.annotation):
                records_within(inner, reference, found)
    return found


def test_every_key_has_a_meaning_and_an_example(reference):
    files, records = reference.list_files(), set()
    for file in files:
        records_within(file.record, reference, records)
    keys = {(reference.find_owner(record, name), name) for record in records for name in record.model_fields}
    examples = {key for file in files for key in reference.collect_examples(file)}
    assert {f"{record.__name__}.{name}" for record, name in keys - examples} == set()
    assert len(keys) > 200


def test_every_example_loads(reference):
    for file in reference.list_files():
        assert file.examples, file.title
        for path in file.examples:
            load(reference.ROOT / path, file.record)


def test_every_file_in_the_folder_of_examples_is_one(reference):
    used = {path for file in reference.list_files() for path in file.examples}
    there = {f"docs/examples/{path.name}" for path in (DOCS / "examples").glob("*.toml")}
    assert there <= used


def test_every_schema_of_a_file_is_on_the_page(reference):
    documented = {file.record for file in reference.list_files()}
    elsewhere = {*reference.WRITTEN_BY_COMMANDS, RecordingRecord}

    def missing(record):
        if record in documented | elsewhere or record.__module__ in NOT_WRITTEN_BY_HAND:
            return []
        inner = [one for one in record.__subclasses__() if one.__module__.startswith("needlefit.")]
        return [name for one in inner for name in missing(one)] if inner else [record.__name__]

    assert missing(FileRecord) == []


def test_the_page_is_written(reference):
    assert (DOCS / "toml.md").read_text("utf-8") == reference.write_page()
