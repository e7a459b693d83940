"""No private word in identifiers, columns, keys, options and headings; no class name used twice."""

import ast
import io
import re
import tokenize
from collections import defaultdict
from collections.abc import Iterable, Iterator
from functools import cache
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
        "needlefit/studies/renamed.py",
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


ANY_PRIVATE = re.compile("|".join(sorted(PRIVATE_WORDS)) + r"|as[_-]good|\bask\b", re.IGNORECASE)


@cache
def read_source(path: Path) -> str:
    return path.read_text(encoding="utf-8")


def private_parts(name: str) -> set[str]:
    parts = {part.lower() for part in PART.findall(name)}
    return (parts & PRIVATE_WORDS) | ({name} & PRIVATE_NAMES)


def may_hold_private(path: Path) -> bool:
    """Return whether a file holds such a word anywhere: only then what the word names is worth a look."""
    source = read_source(path)
    if not ANY_PRIVATE.search(source):
        return False
    return any(
        private_parts(word) for word in {*NAME.findall(source), *NAME.findall(source.replace("-", "_"))}
    )


def names_of(path: Path) -> Iterator[str]:
    """Yield the identifiers of a Python file, and its strings that are single names (columns, keys)."""
    source = read_source(path)
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
    for path in filter(may_hold_private, PYTHON):
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


PRIVATE_PROSE = re.compile(
    r"\b(foretell\w*|foretold|foresight|foreseen|foreknown|rivals?|contests?|told|tells?|said|says"
    r"|whence|thereof|whereby|mend(?:ed|s)?|blam(?:e|ed|es)|inquir\w+|as good as|at the best"
    r"|above the best|hand-tuned|suspicion\w*|steepen\w*|stretched freely|in your own hand"
    r"|speaks for|to beat|weighing|weighed|cannot be had)\b",
    re.IGNORECASE,
)
"""Words and phrases that no reader of pages and messages meets."""


def test_pages_hold_no_private_word():
    pages = [*(ROOT / "docs").glob("*.md"), *(ROOT / "docs" / "guides").glob("*.md"), ROOT / "README.md"]
    assert find_private_prose(pages) == set()


def test_messages_hold_no_private_word():
    found = set()
    for path in PYTHON:
        name = path.relative_to(ROOT).as_posix()
        if name.startswith("needlefit/"):
            for text in messages_of(path):
                found |= {(name, match[0]) for match in PRIVATE_PROSE.finditer(text)}
    assert found == set()


PAGE_SUFFIXES = frozenset({".js", ".html", ".css", ".typ", ".tex", ".csv"})


def test_pages_and_templates_of_the_package_hold_no_private_word():
    package = ROOT / "needlefit"
    paths = [path for path in package.rglob("*") if path.suffix in PAGE_SUFFIXES]
    assert paths
    assert find_private_prose(paths) == set()


def test_shipped_studies_and_configurations_hold_no_private_word():
    paths = [path for folder in ("studies", "configs") for path in (ROOT / folder).rglob("*.toml")]
    assert paths
    assert find_private_prose(paths) == set()


def find_private_prose(paths: Iterable[Path]) -> set[tuple[str, str]]:
    """Return (file, private word) of every one in texts."""
    return {
        (path.relative_to(ROOT).as_posix(), match[0])
        for path in paths
        for match in PRIVATE_PROSE.finditer(path.read_text(encoding="utf-8"))
    }


def messages_of(path: Path) -> Iterator[str]:
    """Yield the strings of a Python file that hold a space and are no docstrings."""
    tree = ast.parse(read_source(path))
    docstrings = {
        id(statement.value)
        for node in ast.walk(tree)
        for statement in (node.body if isinstance(getattr(node, "body", None), list) else ())
        if isinstance(statement, ast.Expr)
    }
    for node in ast.walk(tree):
        text = getattr(node, "value", None) if isinstance(node, ast.Constant) else None
        if isinstance(text, str) and " " in text and id(node) not in docstrings:
            yield text


def test_no_class_name_is_used_twice():
    places = defaultdict(list)
    for path in PYTHON:
        if path.is_relative_to(ROOT / "needlefit"):
            for name in re.findall(r"(?m)^\s*class (\w+)", read_source(path)):
                places[name].append(path.relative_to(ROOT).as_posix())
    assert {name: where for name, where in places.items() if len(where) > 1} == {}
