"""Size of the sources by package: tokens of Python code, characters of others, words of the documents.

    python benchmarks/count_lines.py

Tokens are those of Python's tokenizer, without comments, docstrings and layout (new lines, indents), so that
neither a packed line nor a shorter name is counted as less. An f-string is one token in every version of
Python. Characters of JavaScript and C++ are counted without the spaces at the ends of lines.
"""

import ast
import io
import subprocess
import tokenize
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
GOAL_TOKENS = 385_000
"""Tokens of the package, at most."""
GOAL_WORDS = 24_500
"""Words of the documents, at most."""
OTHER_SOURCES = {
    "JavaScript": {".js", ".mjs"},
    "C++": {".cpp", ".hpp"},
    "page: HTML, CSS": {".html", ".css"},
    "templates": {".j2", ".typ"},
}
BUILT = {"needlefit/reporting/needle_page.js"}  # of other sources, which count
LAYOUT = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
}


def list_files(*folders):
    """Return the files of folders that git knows or would add, as paths from the root."""
    listed = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "--", *folders]
    found = subprocess.run(listed, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    return sorted(name for name in set(found.splitlines()) if (ROOT / name).is_file())


def read(name):
    """Return the text of a file, by its path from the root."""
    return (ROOT / name).read_text(encoding="utf-8")


def find_docstrings(text):
    """Return where strings stand that are statements: docstrings, and those behind an attribute."""
    bodies = (getattr(node, "body", None) for node in ast.walk(ast.parse(text)))
    statements = (statement for body in bodies if isinstance(body, list) for statement in body)
    return {
        (one.lineno, one.col_offset)
        for one in statements
        if isinstance(one, ast.Expr)
        and isinstance(one.value, ast.Constant)
        and isinstance(one.value.value, str)
    }


def count_tokens(text):
    """Return the number of tokens of Python code."""
    docstrings, depth, count = find_docstrings(text), 0, 0
    begin = getattr(tokenize, "FSTRING_START", None)  # since Python 3.12
    end = getattr(tokenize, "FSTRING_END", None)
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == end:
            depth -= 1
        is_code = token.type not in LAYOUT and token.type != end and token.start not in docstrings
        count += is_code and depth == 0
        if token.type == begin:
            depth += 1
    return count


def count_characters(text):
    """Return the number of characters of a source."""
    return sum(len(line.rstrip()) for line in text.splitlines())


def print_row(label, count, goal=None):
    """Print a count and, where there is one, its goal."""
    print(f"{label:26}{count:>10}{goal or '':>10}".rstrip())


def main():
    """Print the table."""
    files = list_files()
    tokens = {name: count_tokens(read(name)) for name in files if name.endswith(".py")}
    print(f"{'tokens of Python code':26}{'now':>10}{'at most':>10}")
    packages = {name.split("/")[1] for name in tokens if name.startswith("needlefit/")}
    sizes = {
        package: sum(size for name, size in tokens.items() if name.startswith(f"needlefit/{package}"))
        for package in packages
    }
    for package in sorted(sizes, key=sizes.get, reverse=True):
        print_row(f"  {package}", sizes[package])
    print_row("needlefit", sum(sizes.values()), GOAL_TOKENS)
    for part in ("tests", "benchmarks", "studies", "docs"):
        print_row(part, sum(size for name, size in tokens.items() if name.startswith(f"{part}/")))
    print(f"\n{'characters':26}{'now':>10}")
    for label, endings in OTHER_SOURCES.items():
        own = [name for name in files if Path(name).suffix in endings and name.startswith("needlefit/")]
        kept = (name for name in own if name not in BUILT and "/vendor" not in name)
        print_row(label, sum(count_characters(read(name)) for name in kept))
    documents = (name for name in files if name.endswith(".md"))
    print()
    print_row("words of the documents", sum(len(read(name).split()) for name in documents), GOAL_WORDS)


if __name__ == "__main__":
    main()
