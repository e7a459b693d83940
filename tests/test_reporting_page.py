import base64
import hashlib
import html
import re
from html.parser import HTMLParser

import pytest
from reporting_results import study

from needlefit.reporting import document
from needlefit.reporting.document import Document, compile_html, compile_pdf
from needlefit.reporting.table import Table, TableColumn, TableLayout
from needlefit.reporting.text import KindText
from needlefit.studies.fit_figures import draw_overlays
from needlefit.studies.report import compose_run_report


class Outline(HTMLParser):
    """What a page is made of; fails where tags do not close."""

    VOID = ("meta", "img", "link", "br", "hr")

    def __init__(self, page):
        super().__init__()
        self.open, self.tags, self.words = [], [], []
        self.feed(page.decode())
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)

    def all(self, tag):
        return [attributes for name, attributes in self.tags if name == tag]


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    one = study(5)
    path = tmp_path_factory.mktemp("page") / "overlays.pdf"
    drawn = {"overlays": draw_overlays(one).save(path, one.origin)}
    return compile_html(compose_run_report(one, drawn)), one


def test_every_script_is_named_by_the_policy_which_allows_no_network(page):
    text = page[0].decode()
    scripts = re.findall(r'<script(?: id="program")?>(.*?)</script>', text, re.DOTALL)
    digests = [base64.b64encode(hashlib.sha256(one.encode()).digest()).decode() for one in scripts]
    named = " ".join(f"'sha256-{digest}'" for digest in digests)
    (policy,) = re.findall(r'Content-Security-Policy" content="([^"]*)"', text)
    assert f"script-src {named} 'wasm-unsafe-eval'" in html.unescape(policy)
    assert "default-src 'none'" in html.unescape(policy) and " http" not in policy


def test_every_figure_and_table_can_be_reached_and_is_described(page):
    outline = Outline(page[0])
    ids = [attributes["id"] for _, attributes in outline.tags if "id" in attributes]
    assert len(ids) == len(set(ids))
    assert {link["href"][1:] for link in outline.all("a")} <= set(ids)
    assert outline.all("html")[0]["lang"] == "en" and len(outline.all("h1")) == 1
    assert all(image["alt"] and int(image["width"]) > 300 for image in outline.all("img"))
    assert all(head["scope"] == "col" for head in outline.all("th"))


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
    errors = text.lay_out(Table("errors", [{"insertion": "a"}], ("insertion",)), values)
    return text.compose(values, [errors])


def test_a_value_is_printed_literally_wherever_it_stands(text):
    plain, blocks = compose(text), compose(text, HOSTILE)
    assert [one["kind"] for one in blocks] == [one["kind"] for one in plain]
    assert blocks[-1]["text"] == " ".join(HOSTILE.split()).replace("`", "")
    page = Document("Title", "", False, tuple(blocks))
    assert b"<b>" not in compile_html(page).partition(b"<main>")[2].replace(b"<figcaption><b>", b"")
    assert compile_pdf(page).startswith(b"%PDF")


def test_user_text_is_escaped():
    display = TableLayout(
        "t",
        "<b>bold</b>",
        (TableColumn("<i>", align="left"), TableColumn("x")),
        (("mu * b^-1.9", "<script>"),),
    )
    blocks = (document.heading("a & b"), document.table(display))
    content = compile_html(document.Document("<u>", "", False, blocks))
    outline = Outline(content)
    assert not {"i", "u"} & {tag for tag, _ in outline.tags}
    assert b"<td" in content and b"<script></td>" not in content
    assert b"b<sup>\xe2\x88\x921.9</sup>" in content and "a & b" in outline.words
    assert "<script>" in outline.words and "<b>bold</b>" in "".join(outline.words)
