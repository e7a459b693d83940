r"""The sentences of reports: one Jinja2 template for each kind of study, which yields Markdown.

A kind hands over numbers; `<kind>.md.j2` beside this module (of a plug-in: in its own package) says them:

    {% block verdict %}
    {{ passed }} of {{ checks }} checks pass; the largest error is {{ error_mm | mm }} mm.
    {% endblock %}
    {% block summary %}
    Every paragraph or bullet is a sentence of its own.
    {% endblock %}
    {% block table_checks %}
    The caption of the table "checks".

    Every further paragraph is a note under it.
    {% endblock %}
    {% block figure_errors %}
    The caption of the figure "errors".
    {% endblock %}
    {% block report %}
    ## Checks

    {{ table("checks") }}

    {{ figure("errors") }}
    {% endblock %}

A template asks only which values there are (`{% if floors %}`), and computes nothing.
Markdown is limited to headings (`##`, `###`), paragraphs, bullets, links, emphasis and code. A paragraph that
is emphasised as a whole is set in small type. `table`, `figure` and `block` refer by name to what the kind
hands over; what it did not make is left out. Values are data: their ASCII punctuation signs are escaped. A
number that is not whole needs a filter: all formats of `table.FORMATS` (`mm`, `percent`, `number`,
`medium`, ...), `quantity` (with the parameter's name), `ratio` (two digits),
`significant(n)`, `words`; `bare` is the symbol of a parameter, `symbols` inserts all of a sentence.

`needlefit.studies.report.StudyReport` makes a report of a text, its values, tables and figures;
`needlefit/studies/kinds/identification.py` is an example.
"""

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from numbers import Integral
from typing import Any

import jinja2
import numpy as np
from markdown_it import MarkdownIt
from markdown_it.token import Token
from markupsafe import Markup

from needlefit.reporting import document
from needlefit.reporting.document import Block, Words
from needlefit.reporting.number_format import (
    format_bare_symbol,
    format_error,
    format_quantity,
    format_to_error,
    insert_symbols,
    join_words,
)
from needlefit.reporting.table import FORMATS, Table, TableLayout

_PUNCTUATION = re.compile(r"([!-/:-@\[-`{-~])")
_ESCAPED = re.compile(r"\\([!-/:-@\[-`{-~])")
_SPACE = re.compile(r"\s+")
_REFERENCE = re.compile(r"\[\[(table|figure|block):(\w+)\]\]")
_INLINE_RULES = ("escape", "backticks", "emphasis", "link", "newline")


def escape_markdown(value: object) -> Markup:
    """Return a value as Markdown that prints it literally, on one line.

    TypeError if it is neither a text nor a whole number: a number needs a filter, which says how it is
    printed.
    """
    if isinstance(value, Markup):
        return value
    if isinstance(value, jinja2.Undefined):
        return Markup(str(value))  # noqa: S704 - raises, but for an `if` without `else`: empty
    if not isinstance(value, str) and (isinstance(value, bool) or not isinstance(value, Integral)):
        raise TypeError(f"{value!r} in a text needs a filter, such as mm or percent")
    return Markup(_PUNCTUATION.sub(r"\\\1", _SPACE.sub(" ", str(value))))  # noqa: S704 - Markdown, escaped


@cache
def _environment(package: str) -> jinja2.Environment:
    """Return Jinja2 for the texts of a package, which may import ours; automatic escapes are Markdown's."""
    package_files = jinja2.PackageLoader("needlefit.reporting", "text")
    loaders = [package_files] if package == __name__ else [jinja2.PackageLoader(package, ""), package_files]
    environment = jinja2.Environment(
        loader=jinja2.ChoiceLoader(loaders),
        undefined=jinja2.StrictUndefined,
        autoescape=True,  # so that what macros return is not escaped again
        finalize=escape_markdown,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    for kind in ("table", "figure", "block"):  # their names are those of files
        environment.globals[kind] = lambda name, kind=kind: Markup(f"[[{kind}:{name}]]")  # noqa: S704
    environment.filters |= {
        **FORMATS,
        "quantity": lambda value, parameter: format_quantity(parameter, value),
        "error": format_error,
        "ratio": lambda value: f"{value:.2g}",
        "rounded": format_to_error,
        "significant": partial(np.format_float_positional, unique=False, fractional=False, trim="-"),
        "bare": format_bare_symbol,
        "symbols": insert_symbols,
        "words": lambda words: join_words([str(word) for word in words]),
    }
    return environment


@dataclass(frozen=True)
class KindText:
    """The text of one kind of study."""

    name: str  # of the file, without `.md.j2`
    package: str = __name__  # that holds the file; a plug-in names its own

    @cached_property
    def _template(self) -> jinja2.Template:
        return _environment(self.package).get_template(f"{self.name}.md.j2")

    def has(self, block: str) -> bool:
        return block in self._template.blocks

    def render(self, block: str, values: Mapping[str, Any]) -> str:
        """Return the Markdown of a block.

        jinja2.UndefinedError if it names a value that there is not.
        """
        context = self._template.new_context({**values})
        blocks, context.blocks = context.blocks, {name: [lambda _: iter(())] for name in context.blocks}
        for _ in self._template.root_render_func(context):
            pass  # defines the macros, and writes no block
        context.blocks = blocks
        return "".join(self._template.blocks[block](context))

    def sentences(self, block: str, values: Mapping[str, Any]) -> list[str]:
        """Return the paragraphs and bullets of a block as plain text; none if there is no such block."""
        if not self.has(block):
            return []
        parsed = _parser().parse(self.render(block, values))
        return [_plain(token) for token in parsed if token.type == "inline"]

    def sentence(self, block: str, values: Mapping[str, Any]) -> str:
        """Return a block as one line of plain text."""
        return " ".join(self.sentences(block, values))

    def lay_out(self, table: Table, values: Mapping[str, Any], drop_empty: bool = False) -> TableLayout:
        """Return a table with caption and notes from the block `table_<name>`, if there is one."""
        head, *notes = self.sentences(f"table_{table.name}", values) or [table.caption]
        return replace(table.lay_out(drop_empty), caption=head, notes=(*notes, *table.notes))

    def compose(
        self,
        values: Mapping[str, Any],
        tables: Iterable[TableLayout] = (),
        figures: Mapping[str, Block] | None = None,
        further: Mapping[str, list[Block]] | None = None,
    ) -> list[Block]:
        """Return the body of a report as blocks, with all that it refers to; `further` are blocks by name."""
        parts = {("table", table.name): [document.table(table)] for table in tables}
        parts |= {("block", name): blocks for name, blocks in (further or {}).items()}
        parts |= {("figure", name): [block] for name, block in (figures or {}).items()}
        return list(_compose(_parser().parse(self.render("report", values)), parts))


@cache
def _parser() -> MarkdownIt:
    return MarkdownIt("zero").enable(["heading", "list", *_INLINE_RULES])


def _compose(tokens: list[Token], blocks: Mapping[tuple[str, str], list[Block]]) -> Iterator[Block]:
    items: list[Words] = []
    lists = 0
    for number, token in enumerate(tokens):
        lists += {"bullet_list_open": 1, "bullet_list_close": -1}.get(token.type, 0)
        if token.type == "bullet_list_close" and not lists:
            yield document.bullets(items)
            items = []
        if token.type != "inline":
            continue
        reference = _REFERENCE.fullmatch(token.content)
        if reference:
            yield from blocks.get((reference[1], reference[2]), [])
        elif lists:
            items.append(_runs(token))
        elif tokens[number - 1].type == "heading_open":
            make = document.heading if tokens[number - 1].tag == "h2" else document.subheading
            yield make(_plain(token))
        else:
            children = [inline for inline in token.children or [] if inline.type != "text" or inline.content]
            small = len(children) > 2 and children[0].type == "em_open" and children[-1].type == "em_close"
            if small and sum(token.type == "em_open" for token in children) == 1:
                yield document.note(_runs(replace(token, children=children[1:-1])))
            else:
                yield document.text(_runs(token))


def _plain(token: Token) -> str:
    words = _runs(token)
    return words if isinstance(words, str) else "".join(run["text"] for run in words)


def _runs(token: Token) -> Words:
    """Return the text of a paragraph: one string, or runs of a style or a link."""
    runs: list[dict[str, str]] = []
    style, target = "", ""
    for child in token.children or []:
        if child.type in ("em_open", "strong_open"):
            style = child.tag
        elif child.type in ("em_close", "strong_close"):
            style = ""
        elif child.type == "link_open":
            target = str(child.attrs["href"])
        elif child.type == "link_close":
            target = ""
        else:
            text = " " if child.type == "softbreak" else child.content
            kind = "code" if child.type == "code_inline" else style
            if kind == "code":  # in which Markdown has no escapes
                text = _ESCAPED.sub(r"\1", text)
            if runs and (runs[-1]["style"], runs[-1]["target"]) == (kind, target):
                runs[-1]["text"] += text
            else:
                runs.append({"text": text, "style": kind, "target": target})
    runs = [run for run in runs if run["text"]]
    if all(not run["style"] and not run["target"] for run in runs):
        return "".join(run["text"] for run in runs)
    return runs
