"""Size of the sources by package: tokens of Python code, characters of others, words of the documents.

    python benchmarks/count_lines.py
    python benchmarks/count_lines.py --names

Tokens are those of Python's tokenizer, without comments, docstrings and layout (new lines, indents), so that
neither a packed line nor a shorter name is counted as less. An f-string is one token in every version of
Python. Characters of JavaScript and C++ are counted without the spaces at the ends of lines.

Of the package it also counts words in strings that are no docstrings (a text without a space counts as
none: keys, columns, formats), constants of modules (numbers under names in capitals, also of classes, and
the fields of records of numbers), and names that do not state what they hold: variables, parameters and
attributes called `one`, `found` and so on, each counted where it is bound. `--names` prints these by file.
"""

import ast
import io
import re
import subprocess
import sys
import tokenize
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
GOALS = {
    "needlefit": 355_000,
    "tests": 235_000,
    "JavaScript": 150_000,
    "words of the documents": 22_000,
    "words in strings": 17_000,
    "constants of modules": 900,
    "  of them in imaging": 120,
    "names that say nothing": 250,
}
"""Each count, at most; of `needlefit` and `tests` tokens."""
ARRAYS = {"array", "arange", "linspace", "log", "radians"}
"""Functions of numpy that numbers make numbers."""
RECORDS = {"Known"}
"""Classes whose fields are numbers."""
VAGUE_NAMES = {"one", "found", "own", "what", "at", "every", "each", "known"}
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
    names = subprocess.run(listed, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    return sorted(name for name in set(names.splitlines()) if (ROOT / name).is_file())


def read(name):
    """Return the text of a file, by its path from the root."""
    return (ROOT / name).read_text(encoding="utf-8")


def find_docstrings(text):
    """Return where strings stand that are statements: docstrings, and those behind an attribute."""
    bodies = (getattr(node, "body", None) for node in ast.walk(ast.parse(text)))
    statements = (statement for body in bodies if isinstance(body, list) for statement in body)
    return {
        (statement.lineno, statement.col_offset)
        for statement in statements
        if isinstance(statement, ast.Expr)
        and isinstance(statement.value, ast.Constant)
        and isinstance(statement.value.value, str)
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


def count_string_words(text):
    """Return the number of words in the strings of Python code that are no docstrings."""
    docstrings = find_docstrings(text)
    strings = (
        node.value
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Constant)
        and isinstance(node.value, str)
        and (node.lineno, node.col_offset) not in docstrings
    )
    return sum(len(re.findall(r"[^\W\d_]{2,}", string)) for string in strings if " " in string)


def is_number(node):
    """Return whether an expression is a number, or an array of them, or is calculated from such alone."""
    if isinstance(node, ast.Constant):
        return isinstance(node.value, int | float) and not isinstance(node.value, bool)
    if isinstance(node, ast.UnaryOp | ast.Starred):
        return is_number(node.operand if isinstance(node, ast.UnaryOp) else node.value)
    if isinstance(node, ast.BinOp):
        return is_number(node.left) and is_number(node.right)
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):  # of numpy
        return node.func.attr in ARRAYS and all(map(is_number, node.args))
    return isinstance(node, ast.Tuple | ast.List) and bool(node.elts) and all(map(is_number, node.elts))


def count_constants(text):
    """Return how many numbers a module, and its classes, give to names in capitals; of records all."""
    module = ast.parse(text)
    bodies = [module.body, *(node.body for node in module.body if isinstance(node, ast.ClassDef))]
    pairs = (
        (statement.targets[0] if isinstance(statement, ast.Assign) else statement.target, statement.value)
        for body in bodies
        for statement in body
        if isinstance(statement, ast.Assign | ast.AnnAssign)
    )
    named = [value for name, value in pairs if isinstance(name, ast.Name) and name.id.isupper()]
    return sum(map(is_number, named)) + sum(
        is_number(argument)
        for value in named
        if isinstance(value, ast.Call) and isinstance(value.func, ast.Name) and value.func.id in RECORDS
        for argument in (*value.args, *(keyword.value for keyword in value.keywords))
    )


def list_bound_names(text):
    """Yield each name where it is bound: variables, parameters, attributes of `self` and of classes."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.arg):
            yield node.arg
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node.attr
        elif isinstance(node, ast.ExceptHandler | ast.MatchAs | ast.MatchStar) and node.name:
            yield node.name


def print_vague_names(files):
    """Print how many vague names each file has, and which."""
    for name in files:
        counts = Counter(bound for bound in list_bound_names(read(name)) if bound in VAGUE_NAMES)
        if counts:
            listed = ", ".join(f"{vague} {count}" for vague, count in counts.most_common())
            print(f"{counts.total():>5} {name}: {listed}")


def print_row(label, count):
    """Print a count and, where there is one, its goal."""
    print(f"{label:26}{count:>10}{GOALS.get(label, ''):>10}".rstrip())


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
    print_row("needlefit", sum(sizes.values()))
    for part in ("tests", "benchmarks", "studies", "docs"):
        print_row(part, sum(size for name, size in tokens.items() if name.startswith(f"{part}/")))
    print(f"\n{'characters':26}{'now':>10}")
    for label, endings in OTHER_SOURCES.items():
        sources = [name for name in files if Path(name).suffix in endings and name.startswith("needlefit/")]
        kept = (name for name in sources if name not in BUILT and "/vendor" not in name)
        print_row(label, sum(count_characters(read(name)) for name in kept))
    documents = (name for name in files if name.endswith(".md"))
    package = [read(name) for name in tokens if name.startswith("needlefit/")]
    print()
    print_row("words of the documents", sum(len(read(name).split()) for name in documents))
    print_row("words in strings", sum(map(count_string_words, package)))
    print_row("constants of modules", sum(map(count_constants, package)))
    imaging = (read(name) for name in tokens if name.startswith("needlefit/imaging/"))
    print_row("  of them in imaging", sum(map(count_constants, imaging)))
    vague = [bound for text in package for bound in list_bound_names(text) if bound in VAGUE_NAMES]
    print_row("names that say nothing", len(vague))


if __name__ == "__main__":
    if "--names" in sys.argv[1:]:
        print_vague_names([name for name in list_files("needlefit") if name.endswith(".py")])
    else:
        main()
