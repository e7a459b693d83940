"""What every inquiry rests on: pieces that are kept, answers that are stored, evidence that is rounded."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from test_cli import run as run_cli

from needlefit.errors import ConfigError, DataError
from needlefit.inference.forward_model import make_options, predict
from needlefit.project.checkpoint import open_checkpoint
from needlefit.project.folders import write_manifest
from needlefit.studies.job import Job, Settings
from needlefit.studies.kind import find_kind
from needlefit.studies.kinds.sensitivity import REPORT, VariationRecord, apply_variation
from needlefit.studies.paper_cells import prepare_jobs
from needlefit.studies.reference import round_frame
from needlefit.studies.run_differences import compare_runs
from needlefit.studies.runner import run_tasks
from needlefit.studies.study_files import load_study

THIRD = 1 / 3
RECIPE = (Path(__file__).parent.parent / "configs/recipes/quick.toml").read_text(encoding="utf-8")


def _pieces(done: list[str]):
    def piece(key: str, value: float):
        def compute():
            done.append(key)
            return {
                "errors": [{"of": key, "te_mm": value}],
                **({"more": [{"of": key}]} if key == "b" else {}),
            }

        return compute

    values = {"a": THIRD, "b": np.float64(2 / 3), "c": float("inf"), "d": float("nan")}
    return {key: piece(key, value) for key, value in values.items()}


def _stopping_after(count: int, done: list[str]) -> Settings:
    return Settings(stop=lambda: len(done) >= count)


def test_interrupted_tasks_resume_to_the_same_rows(tmp_path):
    whole = list(run_tasks(_pieces([]), "x", Settings(), open_checkpoint(None, False, {})))
    assert [part["errors"][0]["of"] for part in whole] == ["a", "b", "c", "d"]
    assert whole[0]["errors"][0]["te_mm"] == THIRD and type(whole[1]["errors"][0]["te_mm"]) is float
    first: list[str] = []
    kept = open_checkpoint(tmp_path, False, {"work": 1})
    part = list(run_tasks(_pieces(first), "x", _stopping_after(3, first), kept))
    assert part == whole[:2]  # the third was caught half done
    second: list[str] = []
    again = list(run_tasks(_pieces(second), "x", Settings(), open_checkpoint(tmp_path, True, {"work": 1})))
    assert second == ["c", "d"]
    assert json.dumps(again) == json.dumps(whole)


class _BackwardPool:
    """Finishes the last task first; stops after so many."""

    remote = False

    def __init__(self, count: int) -> None:
        self._count = count

    def run(self, work, items, stop):
        for n in reversed(range(len(items))[-self._count :]):
            yield n, work(items[n])


@pytest.mark.parametrize(("count", "of"), [(4, "abcd"), (2, "cd")])
def test_rows_come_in_the_order_of_tasks_that_finish_in_another(count, of):
    parts = run_tasks(_pieces([]), "x", Settings(pool=_BackwardPool(count)), open_checkpoint(None, False, {}))
    assert [part["errors"][0]["of"] for part in parts] == list(of)


def test_a_task_row_keeps_no_value_that_json_would_change():
    tasks = {"a": lambda: {"x": [{"at": Path()}]}}
    with pytest.raises(TypeError, match="Path"):
        list(run_tasks(tasks, "x", Settings(), open_checkpoint(None, False, {})))


def test_evidence_is_rounded_to_five_decimals_of_a_length_and_five_digits():
    frame = pd.DataFrame(
        {
            "te_mm": [0.1234567, -0.000002, np.inf],
            "mu1_pa": [123456.0, 0.0, np.nan],
            "edp_percent": [12.34567, 0.001234567, 1e9 / 3],
            "insertions": [7, 8, 9],
            "note": ["a", "b", "c"],
        }
    )
    got = round_frame(frame)
    assert got["te_mm"].tolist() == [0.12346, 0.0, np.inf]
    assert str(got["te_mm"][1]) == "0.0"
    assert got["mu1_pa"].tolist()[:2] == [123460.0, 0.0] and np.isnan(got["mu1_pa"][2])
    assert got["edp_percent"].tolist() == [12.346, 0.0012346, 3.3333e8]
    assert got[["insertions", "note"]].equals(frame[["insertions", "note"]])


def test_an_unknown_kind_of_study_lists_the_known_ones(tmp_path):
    file = tmp_path / "odd.toml"
    file.write_text("schema = 1\nkind = { odd = 1 }\n")
    with pytest.raises(ConfigError, match="kind"):
        load_study(file)
    file.write_text('schema = 1\nkind = "odd"\n')
    with pytest.raises(ConfigError, match=r"(?s)`odd`.*left_out"):
        load_study(file)


@pytest.fixture
def project(tmp_path, monkeypatch):
    for folder in ("studies", "configs/fits", "configs/recipes"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / "configs/recipes/few.toml").write_text(RECIPE.replace("starts = 4", "starts = 2"))
    for name, insertions in (("pieces", ["chicken-01", "chicken-04", "chicken-05"]), ("one", ["chicken-04"])):
        chosen = f"[tune]\ninsertions = {json.dumps(insertions)}\n"
        fit = f'schema = 1\ndataset = "twin"\nmedium = "chicken"\nrecipe = "few"\n{chosen}'
        (tmp_path / f"configs/fits/{name}.toml").write_text(fit)
    (tmp_path / "studies/left.toml").write_text(
        'schema = 1\nkind = "left_out"\nfits = ["pieces", "one"]\ngroups = ["specimen"]\n'
    )
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.sweep
def test_specimens_are_left_out_in_turn_and_one_alone_is_not_applicable(project, capsys):
    assert run_cli("validate", "left", "--reference", "-q") == 0
    out = capsys.readouterr().out
    assert "One" in out and "not applicable" in out
    summary = pd.read_csv("reports/left/summary.csv").query("metric == 'te_mm'").set_index("fit")
    assert summary.loc["one", "note"].startswith("not applicable")
    assert np.isnan(summary.loc["one", "value"])
    errors = pd.read_csv("reports/left/errors.csv")
    errors = errors[(errors["fit"] == "pieces") & (errors["method"] == "fitted")]
    left, sample = (
        errors[errors["left_out"] == how].set_index("insertion") for how in ("specimen", "nothing")
    )
    assert left["fold"].to_dict() == {
        "chicken-01": "without chicken-piece1",
        "chicken-04": "without chicken-piece2",
        "chicken-05": "without chicken-piece2",
    }
    gap = (left["te_mm"] - sample["te_mm"]).mean()
    assert summary.loc["pieces", "difference"] == pytest.approx(gap, abs=1e-7)
    predicted = pd.read_csv("reports/left/predictive.csv")
    assert predicted["insertion"].drop_duplicates().tolist() == ["chicken-01", "chicken-04", "chicken-05"]
    evidence = pd.read_csv("reports/reference/left/summary.csv").query("metric == 'te_mm'").set_index("fit")
    assert evidence.loc["pieces", "value"] == pytest.approx(summary.loc["pieces", "value"], rel=5e-3)
    before = {path.name: path.read_bytes() for path in Path("reports/left").iterdir()}
    assert run_cli("report", "left", "-q") == 0
    assert {path.name: path.read_bytes() for path in Path("reports/left").iterdir()} == before
    assert {"report.pdf", "report.html", "summary.pdf", "left_out.tex"} <= before.keys()
    macros = Path("reports/left/numbers.tex").read_text(encoding="utf-8")
    value = f"{summary.loc['pieces', 'value']:.2f}"
    assert rf"\nfnum{{left-left-out-pieces-specimen-te-left-out-mm}}{{{value}}}" in macros
    figures = {name.removesuffix(".pdf") for name in before if name.endswith(".pdf")} - {"report"}
    assert all(f"{figure}.csv" in before for figure in figures)


def _answer(folder: Path, kind: str, **frames: pd.DataFrame) -> Path:
    folder.mkdir()
    (folder / "run.json").write_text(json.dumps({"kind": kind, "faults": []}))
    for name, frame in frames.items():
        frame.to_csv(folder / f"{name}.csv", index=False)
    write_manifest(folder)
    return folder


def test_two_results_differ_in_rows_lengths_and_numbers(tmp_path):
    first = pd.DataFrame({"fit": ["a", "b"], "te_mm": [0.2, 0.4], "pareto_k": [0.5, 0.2]})
    other = pd.DataFrame({"fit": ["b", "a"], "te_mm": [0.41, 0.2], "pareto_k": [0.4, 0.5]})
    one, two = (_answer(tmp_path / n, "left_out", summary=f) for n, f in (("1", first), ("2", other)))
    assert compare_runs(one, one) == []
    length, number = compare_runs(one, two)  # rows are found by their words, in whatever order
    assert (length.before, length.after, length.matters) == (0.4, 0.41, True)
    assert "insertions" not in length.why and "0.01 mm" in length.why
    assert (number.before, number.after, number.matters) == (0.2, 0.4, True)
    three = _answer(tmp_path / "3", "left_out", summary=first.assign(fit=["a", "c"]))
    (rows,) = compare_runs(one, three)
    assert rows.where == "rows of summary" and rows.why.startswith("2 rows")


def test_errors_of_results_are_compared_insertion_by_insertion(tmp_path):
    first = pd.DataFrame({"insertion": ["a", "b", "c"], "te_mm": [0.2, 0.4, 0.3]})
    worse = first.assign(te_mm=first["te_mm"] + [0.1, 0.1, 0.1])
    (found,) = compare_runs(
        _answer(tmp_path / "1", "left_out", errors=first), _answer(tmp_path / "2", "left_out", errors=worse)
    )
    assert found.matters and "on 3 insertions" in found.why


def test_results_of_different_analyses_are_not_compared(tmp_path):
    one, two = (_answer(tmp_path / kind, kind) for kind in ("left_out", "plan"))
    study = tmp_path / "study"
    study.mkdir()
    (study / "run.json").write_text('{"kind": "fit"}')
    (study / "errors.csv").write_text("fold\n")
    write_manifest(study)
    for pair in ((one, two), (one, study), (study, two)):
        with pytest.raises(DataError, match="different") as fault:
            compare_runs(*pair)
        assert fault.value.exit_code == 3


NEXT = {
    "schema": 1,
    "kind": "next_insertion",
    "dataset": "twin",
    "medium": "chicken",
    "recipe": "quick",
    "template_insertion": "chicken-02",
    "tune": {"insertions": ["chicken-01"]},
    "depths_mm": [40.0],
    "entries": [{"name": "above"}],
}
LEFT = {"schema": 1, "kind": "left_out", "fits": ["chicken"]}
DEEP = [{"name": "a", "entry": "above", "depth_mm": 4e3}]
ALONE = {
    "schema": 1,
    "kind": "comparison",
    "dataset": "twin",
    "medium": "chicken",
    "insertions": {"insertions": ["chicken-01"]},
}


@pytest.mark.parametrize(
    ("record", "what", "where"),
    [
        ({**NEXT, "template_insertion": "none"}, "dataset", "template_insertion"),
        ({**NEXT, "depths_mm": [40, 9e3]}, "9000 mm", "depths_mm"),
        ({**NEXT, "quantities": DEEP}, "4000 mm", "quantities.1.depth_mm"),
        ({**LEFT, "fits": ["no"]}, "fit .*`no`", "fits"),
        (ALONE, "one group", "folds"),
    ],
    ids=["like", "depths", "quantities", "fits", "folds"],
)
def test_a_faulty_study_is_reported_with_its_name_and_key(record, what, where):
    with pytest.raises(ConfigError, match=what) as error:
        kind = find_kind(record["kind"])
        kind.run("mine", kind.record.model_validate(record), Settings())
    assert error.value.where == f"study mine, key `{where}`"


@pytest.fixture(scope="module")
def job() -> Job:
    return prepare_jobs(["study2"], [], Settings())["study2"]


def vary(job: Job, **changes: object) -> Job:
    return apply_variation(job, VariationRecord(factor="x", name="y", **changes))


def test_a_variation_changes_what_it_names_and_nothing_else(job):
    changed = vary(job, constraint_switch=0.0, first_cell_mm=0.5, thickness_mm=20.0, boundary_shift_sd=2.0)
    now, before = make_options(changed.medium), make_options(job.medium)
    assert (now.switch, now.tangent, now.first_cell, now.spacing) == (0.0, 1.0, 0.5, before.spacing)
    assert changed.medium.thickness_mm == 20.0 and changed.dataset.needle == job.dataset.needle
    for one, other in zip(changed.insertions, job.insertions, strict=True):
        np.testing.assert_allclose(one.boundaries, other.boundaries + 2 * other.boundary_sd)
        assert one.sequence == other.sequence


def test_the_path_angle_takes_the_place_of_b_and_is_tuned_again(job):
    changed = vary(job, advance="path_angle")
    assert make_options(changed.medium).path_angle and changed.medium.law == job.medium.law
    renamed = ["cut_angle_deg" if name == "bevel_mm" else name for name in job.parameters.free]
    assert list(changed.parameters.free) == renamed and changed.parameters.ties == job.parameters.ties
    values = {**job.hand_tuned, "cut_angle_deg": 3.0}
    assert predict(values, changed.medium, job.dataset.needle, job.insertions[0]).converged


def test_a_stiffer_needle_in_as_much_stiffer_tissue_bends_alike(job):
    stiff, needle = vary(job, rigidity_factor=1.1).dataset.needle, job.dataset.needle
    hollow = vary(job, inner_diameter_mm=1.27 / 2).dataset.needle
    assert hollow.flexural_rigidity == pytest.approx(15 / 16 * needle.flexural_rigidity)
    values = dict(job.hand_tuned)
    more = {name: 1.1 * value if name.startswith("mu") else value for name, value in values.items()}
    soft, hard = (
        predict(given, job.medium, tube, job.insertions[-1]).u
        for given, tube in ((values, needle), (more, stiff))
    )
    np.testing.assert_allclose(hard, soft, atol=1e-7)


def test_a_variation_that_changes_nothing_is_refused(tmp_path):
    file = tmp_path / "nothing.toml"
    file.write_text(
        'schema = 1\nkind = "sensitivity"\nstudies = ["small"]\n[[variations]]\nfactor = "x"\nname = "y"\n'
    )
    with pytest.raises(ConfigError, match="changes nothing"):
        load_study(file)


def test_parts_of_the_advance_along_the_tangent_are_refused_beside_the_path_angle():
    with pytest.raises(ValueError, match="leave out `tangent_part`"):
        VariationRecord(factor="advance", name="both", advance="path_angle", tangent_part=0.5)


def test_a_small_study_under_variations(world, tmp_path):
    answer = world.restore("sensitivity")
    studies = answer.frames["studies"].set_index(["aspect", "tuned", "metric"])["change"].sort_index()
    assert abs(studies.loc["rigidity", "again", "te_mm"]) < 1e-2
    assert abs(studies.loc["rigidity", "kept", "te_mm"]) > 1e-2
    assert ("constraint spacing", "kept") not in studies.index  # b is per spacing
    ratios = answer.frames["parameter_changes"].set_index(["aspect", "parameter"])["ratio"]
    assert ratios["rigidity", "mu1_pa"] == pytest.approx(1.1, rel=0.01)
    assert pd.isna(ratios["constraint spacing", "bevel_mm"])
    assert "2 variations" in REPORT.summarize(answer)[0]
    assert REPORT.draw(answer, tmp_path)["studies"].is_file()
    again, kept, *_ = REPORT.lay_out(answer)
    assert len(again.rows) == 3 and len(kept.rows) == 2
    assert answer.run["variations"]["constraint spacing: 2 mm"]["constraint_spacing_mm"] == 2.0
    # where no variation keeps the parameters
    studies = answer.frames["studies"]
    spaced = answer.with_frames(studies=studies[studies["aspect"] != "rigidity"])
    assert "No variation keeps the parameters." in REPORT.summarize(spaced)
