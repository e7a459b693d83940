"""Texts of reports: values are data, references become blocks, numbers need a format."""

import jinja2
import pytest

from needlefit.reporting.document import Document, compile_html, compile_pdf
from needlefit.reporting.table import Table
from needlefit.reporting.text import KindText

TEXT = """
{% macro length(value) %}*{{ value | mm }}* mm{% endmacro %}
{% block verdict %}
{{ name }} is off by {{ length(error_mm) }}.
{% endblock %}
{% block table_errors %}
Errors of {{ name }}.

A note.
{% endblock %}
{% block report %}
## Head of {{ name }}

Plain [link](https://example.org) and `code`.

*Small type.*

- one {{ name }}
- **two**

{{ table("errors") }}

{{ figure("missing") }}

{{ name }}
{% endblock %}
"""
HOSTILE = "# *a* [b](c) `d`\n\n- #let x = 1 {{ 1 }} [[table:errors]] <b>"


@pytest.fixture(scope="module")
def text(tmp_path_factory):
    folder = tmp_path_factory.mktemp("plugin") / "text_of_plugin"
    folder.mkdir()
    (folder / "__init__.py").write_text("", encoding="utf-8")
    (folder / "trial.md.j2").write_text(TEXT, encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(folder.parent)
        yield KindText("trial", "text_of_plugin")


def compose(text, name="gel"):
    values = {"name": name, "error_mm": 0.123}
    errors = text.lay_out(Table("errors", "", [{"insertion": "a"}], ("insertion",)), values)
    return text.compose("report", values, [errors])


def test_markdown_becomes_blocks(text):
    kinds = [one["kind"] for one in compose(text)]
    assert kinds == ["heading", "text", "note", "list", "table", "text"]
    assert text.sentences("verdict", {"name": "gel", "error_mm": 0.123}) == ["gel is off by 0.12 mm."]
    table = compose(text)[4]
    assert (table["caption"], table["notes"]) == ("Errors of gel.", ("A note.",))


def test_a_value_is_printed_literally_wherever_it_stands(text):
    plain, blocks = compose(text), compose(text, HOSTILE)
    assert [one["kind"] for one in blocks] == [one["kind"] for one in plain]
    assert blocks[-1]["text"] == " ".join(HOSTILE.split()).replace("`", "")
    page = Document("Title", "", False, tuple(blocks))
    assert b"<b>" not in compile_html(page).partition(b"<main>")[2].replace(b"<figcaption><b>", b"")
    assert compile_pdf(page).startswith(b"%PDF")


@pytest.mark.parametrize("value", [0.5, None, True])
def test_a_number_without_a_format_and_a_missing_value_are_errors(text, value):
    with pytest.raises(TypeError, match="filter"):
        text.render("report", {"name": value})
    with pytest.raises(jinja2.UndefinedError):
        text.render("verdict", {"name": "gel"})
