"""Calibration on synthetic truths: what a replicate is, how dependent tips count, what is refused."""

import numpy as np
import pandas as pd
import pytest
from pydantic import ValidationError
from test_cli import run

from needlefit.project.locate import find_file
from needlefit.studies.job import Settings, prepare
from needlefit.studies.kind import find_kind
from needlefit.studies.kinds.calibration import (
    PREDICTION_DRAWS,
    CalibrationRecord,
    add_intervals,
    prepare_synthetic,
    replicate_synthetic,
)
from needlefit.studies.rank_statistics import (
    HELD_OUT_TIP,
    RANK_DRAWS,
    count_covered,
    place_pit,
    tabulate_coverage,
    tabulate_ecdfs,
)
from needlefit.studies.simulated_data import find_true_value
from needlefit.studies.study_files import load_study
from needlefit.synthetic.truth import draw_specimen

STUDY = """
schema = 2
dataset = "twin"
medium = "chicken"
recipe = "quick"
[tune]
insertions = ["chicken-01"]
[[validate]]
insertions = ["chicken-03", "chicken-02"]
"""


def prepare_study(name: str):
    record = load_study(find_file("study", name))
    assert record is not None
    return prepare(name, record, Settings())


@pytest.fixture
def small(tmp_path, monkeypatch):
    """A study of three insertions, in the folder that it is run in."""
    (tmp_path / "studies").mkdir()
    (tmp_path / "studies/small.toml").write_text(STUDY)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_every_place_is_as_wide_and_the_draws_divide_evenly_among_them():
    assert [place_pit(pit) for pit in (0.0, 0.0124, 0.0126, 0.9999, 1.0)] == [0, 0, 1, 79, 79]
    middles = [place_pit((below + 0.5) / (PREDICTION_DRAWS + 1)) for below in range(PREDICTION_DRAWS + 1)]
    assert set(np.bincount(middles, minlength=RANK_DRAWS + 1)) == {13}


def test_tips_of_one_replicate_count_as_one_trial():
    """Copies of the same ranks change no count; half of each replicate covered is half of the replicates."""
    alone = np.random.default_rng(1).integers(0, RANK_DRAWS + 1, 60)
    copies = {"a": alone, "b": np.column_stack([alone] * 7)}
    for table, keys in ((tabulate_coverage(copies), ["covered"]), (tabulate_ecdfs(copies), ["below"])):
        one, other = (table[table["quantity"] == name] for name in ("a", "b"))
        for key in [*keys, "count_low", "count_high"]:
            assert one[key].to_numpy(dtype=float) == pytest.approx(other[key].to_numpy(dtype=float))
    assert count_covered(np.array([[40, 0], [0, 40]]), 0.5) == 1.0


def test_the_interval_of_a_share_is_wilson_s():
    """Of 10 trials 8: 0.490 to 0.943 (E. B. Wilson, 1927)."""
    (row,) = add_intervals(pd.DataFrame({"covered": [8], "replicates": [10]})).to_dict("records")
    assert (row["share"], row["low"], row["high"]) == pytest.approx((0.8, 0.4902, 0.9433), abs=1e-4)


def test_default_replicates_follow_the_source_of_truths():
    def count(**keys: object) -> int:
        return CalibrationRecord(schema=2, kind="calibration", target="study1", **keys).replicates

    assert [count(), count(sampled=True), count(truth="synthetic")] == [500, 100, 50]
    assert count(truth="synthetic", replicates=3) == 3


@pytest.mark.parametrize(
    "keys", [{"ct": True}, {"truth": "synthetic", "control": "pose"}, {"truth": "synthetic", "sampled": True}]
)
def test_keys_that_exclude_each_other_are_refused(keys):
    with pytest.raises(ValidationError):
        CalibrationRecord(schema=2, kind="calibration", target="study1", **keys)


@pytest.mark.parametrize(
    "options", [("--ct",), ("--truth", "nothing"), ("--truth", "synthetic", "--control", "pose")]
)
def test_options_that_exclude_each_other_are_usage_errors(options, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run("calibrate", "study1", *options) == 2


def test_what_has_no_synthetic_truth_is_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("leave_one_out", "guided_tip:rest", "stereo_holes"):
        assert run("calibrate", name, "--truth", "synthetic", "-q") == 3


def test_other_specimens_are_simulated_where_predictions_learn_from_them():
    same, other = (prepare_synthetic(prepare_study(name), ct=False) for name in ("study1", "study3"))
    assert [one.id for one in same.plan] == sorted(one.id for one in same.job.insertions)
    asked = {one.id for one in other.job.insertions}
    assert asked < {one.id for one in other.plan}


def test_the_true_value_of_a_tied_modulus_is_that_of_its_own_layers():
    job = prepare_study("study1")
    mu = 1e6 * draw_specimen(7, "phantom2", "phantom2").mu
    assert find_true_value(job, "mu1_pa", 7) == pytest.approx(mu[0])
    assert find_true_value(job, "mu4_pa", 7) == pytest.approx(mu[3])
    assert find_true_value(job, "bevel_mm", 7) == pytest.approx(0.103)
    assert np.isnan(find_true_value(job, "bevel_spread", 7))


@pytest.mark.sweep
def test_two_replicates_have_their_own_truths_and_resume_to_the_same_frames(small):
    record = CalibrationRecord(schema=2, kind="calibration", target="small", replicates=2, truth="synthetic")
    calibration = find_kind("calibration")
    whole = calibration.run("one", record, Settings())
    frames = whole.frames
    assert set(frames["coverage"]["quantity"]) == {HELD_OUT_TIP, "mu1_pa", "bevel_mm"}
    assert len(frames["predictions"]) == 4 and whole.run["not_predicted"] == 0
    assert frames["predictions"]["tip_pit"].between(0, 1).all()
    seeds = frames["replicates"]["seed"].unique()
    truths = frames["parameters"].query("parameter == 'mu1_pa'")["truth"]
    drawn = [1e6 * draw_specimen(int(seed), "chicken", "chicken-piece1").mu[0] for seed in seeds]
    assert len(seeds) == 2 and truths.to_numpy() == pytest.approx(drawn, rel=1e-6)
    asked = iter([False, True])
    kept = Settings(checkpoint=small / "kept", stop=lambda: next(asked))
    assert calibration.run("one", record, kept).interrupted
    resumed = calibration.run("one", record, Settings(checkpoint=small / "kept", resume=True))
    assert not resumed.interrupted and whole.run_json == resumed.run_json
    for name, frame in frames.items():
        pd.testing.assert_frame_equal(frame, resumed.frames[name], check_exact=True)


@pytest.mark.sweep
def test_truths_measured_through_ct_carry_cross_sections(small):
    job = prepare("small", load_study(find_file("study", "small")), Settings())
    row = replicate_synthetic(0, prepare_synthetic(job, ct=True))
    plain = replicate_synthetic(0, prepare_synthetic(job, ct=False))
    assert row["seed"] == plain["seed"] and len(row["predictions"]) == 2
    for one, other in zip(row["predictions"], plain["predictions"], strict=True):
        assert one["tip_measured_mm"] == pytest.approx(other["tip_measured_mm"], abs=0.3)
        assert one["tip_measured_mm"] != other["tip_measured_mm"]
