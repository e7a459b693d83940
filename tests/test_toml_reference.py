"""Every key of every TOML file has a meaning, and every example of a file loads."""

import re

import pytest

from needlefit.project.locate import shipped_folder
from needlefit.project.toml import load
from needlefit.studies.explanations import describe_files, find_topics, list_files
from needlefit.studies.first_page import lay_out_checks
from needlefit.studies.kind import list_records

EXAMPLES = sorted((shipped_folder() / "docs" / "examples").glob("*.toml"))


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_every_example_loads(path):
    """An example is named by its kind of file and, if there are several, by what it is of."""
    files = [one for one in list_files(list_records()) if path.stem.startswith(one.name)]
    load(path, max(files, key=lambda one: len(one.name)).record)


def test_every_kind_of_file_has_an_example():
    stems = [path.stem for path in EXAMPLES]
    assert all(any(stem.startswith(one.name) for stem in stems) for one in list_files(list_records()))


@pytest.mark.parametrize("kind", ["cross_validation", "fit", "identification", "prediction", "tracks"])
def test_explain_knows_every_word_of_page_one(kind, world):
    page = world.restore(kind).first_page
    tables = [*page.tables, lay_out_checks(page.checks)]
    words = {column.label for table in tables for column in table.columns}
    rows = [row for table in tables if table.name in ("summary", "checks") for row in table.rows]
    words |= {row[0].partition(":")[0].partition(",")[0] for row in rows}
    words = {word for word in words if not word.startswith("Mean over ") and re.search("[^\\W\\d]", word)}
    assert not [word for word in words if not find_topics(word)]


def test_every_key_of_a_file_is_explained():
    files = describe_files(list_records())
    keys = {key.key for _, tables in files for table in tables for key in table.keys}
    assert len(keys) > 150 and not [key for key in keys if not find_topics(key)]


def test_the_tables_of_a_reconstruction_are_explained():
    (passed,) = find_topics("passed.csv")
    assert any(line.startswith("- level_hu: ") for line in passed.paragraphs) and find_topics("refused.csv")
