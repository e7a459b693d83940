"""`needlefit verify`: the table, its files, exit code 6."""

import csv
import json
import re

import pytest
from light_runs import blank_figures  # noqa: F401 - a fixture
from test_cli import run

from needlefit.verification import run as running
from needlefit.verification.check import (
    AcceptanceBound,
    Check,
    CheckOutcome,
    ConvergenceCurve,
    Group,
    Quantity,
    at_most,
    within,
)

H = (4.0, 2.0, 1.0)
NORMS = {"deflection": 4, "slope": 3, "deflection at the nodes": 4, "slope at the nodes": 4}


def refined(rng):
    curve = ConvergenceCurve(
        "A power law", H, {norm: tuple(1e-6 * h**p for h in H) for norm, p in NORMS.items()}
    )
    return CheckOutcome((curve.order("deflection"),), curves=(curve,))


def read_csv(path):
    return list(csv.DictReader(path.read_text(encoding="utf-8").splitlines()))


def crash(rng):
    raise ZeroDivisionError("no luck")


GOOD = (
    Check(
        Group.CLOSED_FORMS,
        "A beam",
        (Quantity("error", at_most(1e-5), "mm"),),
        lambda rng: CheckOutcome((2.5e-7,)),
    ),
    Check(Group.MANUFACTURED, "A power law", (Quantity("order", within(4, 0.2), ""),), refined),
    Check(
        Group.STATED,
        "A spacing",
        (Quantity("tip", AcceptanceBound(), "mm"),),
        lambda rng: CheckOutcome((3.0,), "another model"),
    ),
)
BAD = Check(
    Group.SYMMETRIES,
    "A mirror",
    (Quantity("difference", at_most(0.0), "mm"),),
    lambda rng: CheckOutcome((0.1,)),
)
WORSE = Check(Group.TANGENT, "A step", (Quantity("defect", at_most(1e-8), ""),), crash)


@pytest.fixture
def table(monkeypatch):
    """Return what decides which checks there are: a few quick ones."""

    def choose(*checks):
        monkeypatch.setattr(running, "find_checks", lambda: checks)

    return choose


@pytest.mark.usefixtures("blank_figures")
def test_a_good_table_is_printed_and_written(table, tmp_path, capsys):
    table(*GOOD)
    assert run("verify", "--out", str(tmp_path), "--explain") == 0
    out = capsys.readouterr().out
    assert "Closed forms" in out
    assert "2.50 × 10⁻⁷" in out and "≤ 10⁻⁵" in out and "3.8 to 4.2" in out and "stated" in out
    assert re.search(r"(?m)^All 2 .*; 1 ", out)
    assert f"written: {tmp_path}/verification/" in out
    folder = tmp_path / "verification"
    rows = read_csv(folder / "verification.csv")
    assert [row["verdict"] for row in rows] == ["passes", "passes", "stated"]
    assert float(rows[0]["measured"]) == 2.5e-7 and float(rows[0]["bound_high"]) == 1e-5
    assert rows[0]["unit"] == "mm" and rows[2]["note"] == "another model"
    assert float(rows[1]["measured"]) == pytest.approx(4)
    orders = [row["order"] for row in read_csv(folder / "convergence.csv")]
    assert orders[:3] == ["", "4", "4"]
    about = json.loads((folder / "run.json").read_text())
    assert about["study"]["seed"] == 1 and about["rules"]["spacing"] == 1.0 and "scipy" in about["versions"]


def test_a_verification_is_reported_again_and_compared(table, tmp_path, capsys):
    table(*GOOD)
    assert run("verify", "--out", str(tmp_path)) == 0
    table(*GOOD, BAD)
    assert run("verify", "--out", str(tmp_path / "b")) == 6
    capsys.readouterr()
    assert run("diff", str(tmp_path / "verification"), str(tmp_path / "b" / "verification"), "--json") == 0
    found = {one["where"]: one for one in json.loads(capsys.readouterr().out)}
    assert found["faults"]["matters"] and found["rows of verification"]["after"] == 4


@pytest.mark.usefixtures("blank_figures")
def test_a_failed_row_ends_in_exit_code_6_with_the_table_written(table, tmp_path, capsys):
    table(*GOOD, BAD, WORSE)
    assert run("verify", "--out", str(tmp_path), "--json") == 6
    captured = capsys.readouterr()
    found = json.loads(captured.out)
    assert [row["verdict"] for row in found["rows"]] == ["passes", "passes", "stated", "FAILS", "FAILS"]
    assert found["rows"][4]["measured"] is None
    assert found["summary"].startswith("2 of 4 ")
    lines = [line.split(": ", 3) for line in captured.err.splitlines()]
    assert ["needlefit", "A mirror", "difference", "fails"] in lines
    assert lines[-1][1:3] == ["A step", "defect"] and "ZeroDivisionError: no luck" in lines[-1][3]
    assert "Traceback" not in captured.err
    assert run("verify", "--out", str(tmp_path), "-v") == 6
    assert "in crash" in capsys.readouterr().err


@pytest.mark.usefixtures("blank_figures")
def test_a_fault_of_the_solver_ends_in_exit_code_6(monkeypatch, tmp_path, capsys):
    """Not one of the checks' making: the law's coefficients are wrong by a thousandth."""
    from needlefit.mechanics import packing
    from needlefit.verification.checks import beams

    true = packing.compile_law
    monkeypatch.setattr(
        packing, "compile_law", lambda law, alpha: (1.001 * true(law, alpha)[0], true(law, alpha)[1])
    )
    monkeypatch.setattr(running, "find_checks", lambda: beams.CHECKS)
    assert run("verify", "--out", str(tmp_path)) == 6
    assert "FAIL" in capsys.readouterr().out
