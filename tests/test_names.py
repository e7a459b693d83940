"""No private word in identifiers, columns, keys, options and headings; no class name used twice."""

import ast
import io
import re
import tokenize
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent

PRIVATE_WORDS = frozenset(
    {
        "answered",
        "blame",
        "blamed",
        "carried",
        "caged",
        "contest",
        "contests",
        "foreknown",
        "foresaw",
        "foresee",
        "foreseen",
        "foresight",
        "foretell",
        "foretells",
        "foretold",
        "inquiries",
        "inquiry",
        "ledger",
        "mend",
        "mended",
        "mends",
        "reread",
        "rereads",
        "rival",
        "rivals",
        "said",
        "says",
        "steepen",
        "steepens",
        "steeper",
        "story",
        "suspicion",
        "tells",
        "told",
        "torn",
        "unsaid",
        "weighed",
        "weighing",
        "whence",
    }
)
"""Words of earlier versions that no field uses for what they meant here: parts of a name."""

PRIVATE_NAMES = frozenset({"as_good", "best_told", "not_told_apart", "ask"})
"""Whole names."""

EARLIER_NAMES = frozenset(
    {
        "needlefit/project/unstamped.py",  # files that earlier versions wrote
        "needlefit/schemas/renamed.py",
        "needlefit/validation/renamed.py",
        "tests/test_migration.py",
        "tests/test_names.py",
    }
)
"""Files that name what earlier versions wrote."""

STREAM_KEYS = frozenset({"foretold", "weighed"})
"""They seed random numbers: another word would be another result."""

PYTHON = [
    path
    for folder in ("needlefit", "benchmarks", "tests", "docs")
    for path in sorted((ROOT / folder).rglob("*.py"))
    if path.relative_to(ROOT).as_posix() not in EARLIER_NAMES and "_site" not in path.parts
]
NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
PART = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+")


def private_parts(name: str) -> set[str]:
    parts = {part.lower() for part in PART.findall(name)}
    return (parts & PRIVATE_WORDS) | ({name} & PRIVATE_NAMES)


def names_of(path: Path) -> Iterator[str]:
    """Yield the identifiers of a Python file, and its strings that are single names (columns, keys)."""
    source = path.read_text(encoding="utf-8")
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.NAME:
            yield token.string
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            name = node.value.removeprefix("--").replace("-", "_")
            if NAME.fullmatch(name) and name not in STREAM_KEYS:
                yield name


def test_names_of_the_code_hold_no_private_word():
    found = defaultdict(set)
    for path in PYTHON:
        for name in set(names_of(path)):
            if private_parts(name):
                found[path.relative_to(ROOT).as_posix()].add(name)
    assert dict(found) == {}


def test_names_of_files_hold_no_private_word():
    paths = [path for path in PYTHON if private_parts(path.stem)]
    assert [path.relative_to(ROOT).as_posix() for path in paths] == []


@pytest.mark.parametrize("folder", ["configs", "studies", "data"])
def test_keys_of_shipped_files_hold_no_private_word(folder):
    keys = {
        (path.name, key)
        for path in (ROOT / folder).rglob("*.toml")
        for key in re.findall(r"(?m)^\s*\[*([\w.-]+)(?=\s*=|\])", path.read_text(encoding="utf-8"))
        if any(private_parts(part) for part in key.replace("-", "_").split("."))
    }
    assert keys == set()


def test_columns_of_shipped_results_hold_no_private_word():
    columns = {
        (path.parent.name, path.name, column)
        for path in (ROOT / "reports" / "reference").rglob("*.csv")
        for column in path.read_text(encoding="utf-8").partition("\n")[0].split(",")
        if private_parts(column) or private_parts(path.stem)
    }
    assert columns == set()


def test_headings_hold_no_private_word():
    files = [*(ROOT / "docs").rglob("*.md"), *ROOT.glob("*/README.md"), ROOT / "README.md"]
    headings = {
        (path.name, line)
        for path in files
        if "_site" not in path.parts
        for line in path.read_text(encoding="utf-8").splitlines()
        if line.startswith("#") and any(private_parts(word) for word in NAME.findall(line))
    }
    assert headings == set()


def test_no_class_name_is_used_twice():
    places = defaultdict(list)
    for path in PYTHON:
        if path.is_relative_to(ROOT / "needlefit"):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.ClassDef):
                    places[node.name].append(path.relative_to(ROOT).as_posix())
    assert {name: where for name, where in places.items() if len(where) > 1} == {}
