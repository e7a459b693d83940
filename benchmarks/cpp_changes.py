"""Changes of C++ code for mutation testing, found in its syntax tree, and the library that the code becomes.

What is changed: operators of arithmetic, comparison and logic (`&` and `|` join the masks of lanes), numbers,
signs, `+=` and its like (turned, or left out), conditions (negated), indices (off by one). Comments and the
brackets of templates are no such places.
"""

import os
import shlex
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import tree_sitter_cpp
from tree_sitter import Language, Node, Parser

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
from hatch_build import FLAGS, SHARED

COMPILER = [*shlex.split(os.environ.get("NEEDLEFIT_CXX", "g++")), *FLAGS, "-O1", *SHARED]
"""Strict arithmetic as in every build, and few optimisations: a library in three seconds."""

EXCHANGED = [("+", "-", "*", "/"), ("<", "<=", ">", ">=", "==", "!="), ("&&", "||"), ("&", "|"), ("+=", "-=")]
Change = tuple[str, int, int, str]
"""An operator's name, first byte and end of what is replaced, and what takes its place."""


def list_changes(source: str) -> Iterator[list[Change]]:
    """Yield the places of C++ code that can be changed, each with all changes, in order."""
    text = source.encode()
    for node in _walk(Parser(Language(tree_sitter_cpp.language())).parse(text).root_node):
        make = _CHANGES.get(node.type)
        changes = (
            list(make(node, lambda part: text[part.start_byte : part.end_byte].decode())) if make else []
        )
        if changes:
            yield [(name, part.start_byte, part.end_byte, instead) for name, part, instead in changes]


def apply_change(source: str, operator: str, occurrence: int) -> str | None:
    """Return the code with the `occurrence`-th change of this name made; None if there is no such place."""
    found = [change for place in list_changes(source) for change in place if change[0] == operator]
    if occurrence >= len(found):
        return None
    _, start, end, instead = found[occurrence]
    text = source.encode()
    return (text[:start] + instead.encode() + text[end:]).decode()


def build_library(sources: Path, library: Path) -> bool:
    """Compile the kernel in the folder `sources`; return whether that was possible."""
    command = [*COMPILER, str(sources / "abi.cpp"), "-o", str(library)]
    return subprocess.run(command, capture_output=True, check=False).returncode == 0


def _walk(node: Node) -> Iterator[Node]:
    yield node
    for child in node.children:
        yield from _walk(child)


Read = Callable[[Node], str]
Found = Iterator[tuple[str, Node, str]]


def _exchange_operator(node: Node, read: Read) -> Found:
    operator = node.child_by_field_name("operator")
    text = read(operator) if operator else ""
    for group in EXCHANGED:
        if text in group:
            yield from ((f"{text} to {other}", operator, other) for other in group if other != text)


def _change_assignment(node: Node, read: Read) -> Found:
    left, operator = node.child_by_field_name("left"), node.child_by_field_name("operator")
    if read(operator) != "=":
        yield from _exchange_operator(node, read)
        yield f"no {read(operator)}", node, read(left)


def _change_number(node: Node, read: Read) -> Found:
    yield "number + 1", node, f"({read(node)} + 1)"
    yield "number - 1", node, f"({read(node)} - 1)"


def _drop_sign(node: Node, read: Read) -> Found:
    operator = node.child_by_field_name("operator")
    if read(operator) in ("-", "!"):
        yield f"no {read(operator)}", operator, ""


def _negate(node: Node, read: Read) -> Found:
    condition = node.child_by_field_name("value" if node.type == "condition_clause" else "condition")
    if condition:
        yield "negated condition", condition, f"!({read(condition)})"


def _shift_index(node: Node, read: Read) -> Found:
    for index in node.named_children:
        yield "index + 1", index, f"({read(index)}) + 1"
        yield "index - 1", index, f"({read(index)}) - 1"


_CHANGES = {
    "binary_expression": _exchange_operator,
    "assignment_expression": _change_assignment,
    "number_literal": _change_number,
    "unary_expression": _drop_sign,
    "condition_clause": _negate,
    "conditional_expression": _negate,
    "for_statement": _negate,
    "subscript_argument_list": _shift_index,
}
