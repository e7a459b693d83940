"""The first page: its parts agree, and every output prints this one record."""

import re
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import pytest
from reporting_results import stereo, study, with_predictions
from test_page import NO_BROWSER, chromium  # noqa: F401 - a fixture
from world import COMMANDS

from needlefit.cli.execution import show_run
from needlefit.reporting.document import compile_html
from needlefit.reporting.figures import style
from needlefit.studies.first_page import FaultKind, RunFault
from needlefit.studies.fit_tables import lay_out_matrix
from needlefit.studies.kinds.cross_validation import report as cross_validation
from needlefit.studies.report import (
    compose_first_page,
    compose_overview,
    compose_run_report,
    find_report,
    run_to_json,
    write_report,
)

TERMINAL = SimpleNamespace(explain=False, noted=(), warned=False, json=False)


def read(block):
    return block["text"] if isinstance(block["text"], str) else "".join(run["text"] for run in block["text"])


@pytest.mark.parametrize("is_converged", [True, False])
@pytest.mark.parametrize("make", [stereo, partial(study, 2)])
def test_every_output_prints_the_record(make, is_converged, tmp_path, capsys):
    faults = () if is_converged else (RunFault(FaultKind.NOT_CONVERGED, "the chains"),)
    results = replace(with_predictions(make()), faults=faults, interrupted=False)
    page = results.first_page
    verdict = page.verdict
    assert is_converged == (page.advice.finding != "not_converged") and (
        is_converged or verdict.status != "pass"
    )
    assert lay_out_matrix([results]).rows[0][-1] == verdict.word
    for blocks in (compose_first_page(page), compose_overview([results], []).blocks):
        (shown,) = (one for one in blocks if one["kind"] == "verdict")
        assert read(shown).endswith(f"{verdict.sentence}.") and shown["status"] == verdict.status
    assert run_to_json(results)["verdicts"][0]["sentence"] == verdict.sentence
    show_run(TERMINAL, results, tmp_path / "run")
    printed = " ".join(capsys.readouterr().out.split())
    assert printed.startswith(page.answer)
    assert printed.index(page.advice.words) < printed.index(page.method)


def test_a_second_figure_stands_on_the_first_page_too(world, tmp_path, monkeypatch):
    results = world.restore("cross_validation")
    drawn = find_report(results).draw(results, tmp_path)
    names = list(drawn)[:2]
    monkeypatch.setattr(cross_validation, "REPORT", replace(cross_validation.REPORT, first_figures=2))
    report = compose_run_report(results, drawn)
    end = next(n for n, one in enumerate(report.blocks) if one["kind"] == "page_break")
    places = [n for n, one in enumerate(report.blocks) if one["kind"] == "figure"]
    assert [report.blocks[n]["path"].stem for n in places[:2]] == names
    assert places[1] < end < places[2]
    write_report(report, tmp_path)
    assert (tmp_path / "report.pdf").read_bytes().startswith(b"%PDF")


PLACES = """() => {
  const top = (found) => document.querySelector(found).getBoundingClientRect().top;
  return [".origin", ".first table", ".verdict"].map(top);
}"""
CUT = """() => [...document.querySelectorAll(".first .wide, body")].filter(
  (one) => one.scrollWidth > one.clientWidth + 1).length"""


@NO_BROWSER
def test_a_combined_report_has_data_table_and_verdicts_and_cuts_nothing(world, chromium, tmp_path):  # noqa: F811
    results = world.restore("cross_validation")
    page = tmp_path / "report.html"
    page.write_bytes(compile_html(compose_overview([results], [lay_out_matrix([results])])))
    for width in (320, 1280):
        window = chromium.new_page(viewport={"width": width, "height": 800})
        window.goto(page.as_uri())
        places = window.evaluate(PLACES)
        assert places == sorted(places) and window.evaluate(CUT) == 0
        window.emulate_media(media="print", color_scheme="dark")
        paper = window.evaluate("getComputedStyle(document.body).backgroundColor")
        assert min(map(int, re.findall(r"\d+", paper)[:3])) > 240  # printed light
        window.close()


@pytest.mark.parametrize("kind", list(COMMANDS))
def test_every_artist_lies_inside_its_figure(kind, world, tmp_path, monkeypatch):
    """To 0.02 in: a letter may lean over its box."""
    results, figures, save = world.restore(kind), [], style.save_figure
    monkeypatch.setattr(style, "save_figure", lambda *one: (figures.append(one[0]), save(*one))[1])
    drawn = find_report(results).draw(results, tmp_path)
    assert len(figures) == len(drawn)
    for name, figure in zip(drawn, figures, strict=True):
        box, (width, height) = figure.get_tightbbox(), figure.get_size_inches()
        outside = (-box.x0, -box.y0, box.x1 - width, box.y1 - height)
        assert max(outside) <= 0.02, (name, outside)
