"""Every kind of measurement ends in an answer: a plain file, an import, and the commands that it prints."""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from labs import LABS, TRUTH, place
from numpy.random import default_rng
from pytest import approx
from reporting_results import print_nothing
from test_cli import run

from needlefit.geometry.common_direction import fit_direction
from needlefit.geometry.frames import normalize
from needlefit.project.locate import shipped_folder

PRINTED = re.compile(r"needlefit ((?:check|tune|validate|predict) \S[^\n]*)")


@pytest.mark.parametrize(("sides", "most_deg"), [((1, -1), 0.25), ((1,), 4.0)])
def test_one_direction_is_fitted_to_all_needles(sides, most_deg):
    """Needles of both sides determine their direction of insertion; of one side the bend hides it."""
    rng, along = default_rng(3), normalize([0.080, 0.992, 0.100])
    across, lines = normalize(np.cross(along, [0.0, 0.0, 1.0])), []
    for n, depth in enumerate((50, 60, 70, 80, 55, 65)):
        points = place(depth, np.linspace(0.0, depth, 31), sides[n % len(sides)])
        lines.append(points[:, :1] * along + points[:, 1:] * across + rng.normal(0.0, 0.1, (31, 3)))
    found = fit_direction(lines)
    off_deg = np.degrees(np.arccos(found.vector @ along))
    assert off_deg < 3.0 * found.sd_deg and found.sd_deg < most_deg
    assert len(sides) == 2 or found.sd_deg > 2.0
    assert fit_direction(lines[:2]) is None


@pytest.fixture
def quick(tmp_path, monkeypatch):
    """An empty working folder whose default recipe is the quick one; pages and figures are empty."""
    recipes = tmp_path / "configs/recipes"
    recipes.mkdir(parents=True)
    shutil.copyfile(shipped_folder() / "configs/recipes/quick.toml", recipes / "default.toml")
    print_nothing(monkeypatch)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def import_lab(lab, seed, capsys, **sizes):
    """Write the file of a lab, import it, and return the commands that are printed."""
    lab.write(Path("data.csv"), default_rng(seed), **sizes)
    code = run("import", *lab.files, "--out", "lab", *lab.options())
    printed = "".join(capsys.readouterr())
    assert code == 0, printed
    return PRINTED.findall(printed)


def read_intervals(fit):
    """Return the 95 % intervals of the parameters of a fit."""
    rows = pd.read_csv(f"reports/{fit}/posterior.csv").set_index(["parameter", "probability"])["value"]
    return {name: (rows[name, 0.025], rows[name, 0.975]) for name in TRUTH}


def find_truth(lab):
    """Find the truth in the 95 % intervals of the fit of a lab."""
    fit = "lab_fit" if lab.name == "one" else "lab_study-tune"
    for name, (low, high) in read_intervals(fit).items():
        assert low < TRUTH[name] < high, (name, low, high)


OFTEN = ("ct and camera",)  #: of every session; the others are swept


@pytest.mark.parametrize(
    "lab",
    [
        pytest.param(lab, marks=() if name in OFTEN else pytest.mark.sweep, id=name)
        for name, lab in LABS.items()
    ],
)
def test_a_lab_ends_in_an_answer(lab, quick, capsys):
    commands = import_lab(lab, 1, capsys, needles=3)
    tested = [] if lab.name == "one" else ["validate"]
    assert [line.split()[0] for line in commands] == ["check", "tune", *tested, "predict"]
    for line in commands:
        assert run(line) == 0, "".join(capsys.readouterr())
    if lab.name == "tracker":
        checks = pd.read_csv("reports/lab_study/checks.csv").set_index("check")
        assert checks.loc["closer_than_curves", "passed"] in (True, "True")
    if lab.name == "one":  # nothing is left without it
        assert "same_without" not in {*pd.read_csv("reports/lab_fit/checks.csv")["check"]}
    find_truth(lab)


@pytest.mark.sweep
def test_a_fit_of_free_shapes_knows_what_their_direction_would_determine(quick):
    """The factors that it states are those of a fit to the same shapes with their direction."""
    lab, factors = LABS["shapes"], {}
    lab.write(Path("data.csv"), default_rng(1))
    of_pose = ("pose", "bevel")
    free = [one for one in lab.stated if not one.startswith(of_pose)]
    for name, stated in (("free", free), ("lab", [*free, "pose=1,0,0", "bevel=0,1,0", "pose_angle_sd=0.5"])):
        assert run(f"import data.csv --out {name} --yes --set {' --set '.join(stated)}") == 0
        assert run("tune", f"./{name}/{name}_study.toml") == 0
        factors[name] = {key: high / low for key, (low, high) in read_intervals(f"{name}_study-tune").items()}
    predicted = json.loads(Path("reports/free_study-tune/run.json").read_text())["with_direction"]
    assert predicted.keys() == TRUTH.keys()
    for name, factor in factors["lab"].items():
        assert predicted[name] == approx(factor, rel=0.5) and factors["free"][name] > 2 * factor
