"""Candidates for a further insertion: which there are, and that a deeper one adds more."""

from dataclasses import replace

import numpy as np

from needlefit.inference.sampling.importance import Effort
from needlefit.schemas.study import FitRecord
from needlefit.studies.job import Settings
from needlefit.studies.kinds import identification
from needlefit.studies.kinds.identification import list_insertion_candidates, rank_candidates
from needlefit.studies.load import load_study
from needlefit.studies.simulated_design import choose_reference_values, simulate_design


def prepare_chicken(*ids):
    table = {"schema": 1, "dataset": "twin", "medium": "chicken", "recipe": "quick"}
    return load_study("x", FitRecord.model_validate({**table, "tune": {"insertions": ids}}), Settings())


def test_candidates_are_the_other_insertions_into_the_medium_and_a_repeat(monkeypatch):
    job = prepare_chicken("chicken-01", "chicken-04")
    *others, (role, repeated) = list_insertion_candidates(job, job.folds[0])
    assert (role, repeated.id) == ("repeat", "chicken-01")  # the deeper of the two
    assert len(others) == 10 and {one.medium for _, one in others} == {"chicken"}
    depths = [one.depth for _, one in others]
    assert depths == sorted(depths)
    monkeypatch.setattr(identification, "MAX_CANDIDATES", 3)
    fewer = [one.depth for role, one in list_insertion_candidates(job, job.folds[0]) if role == "candidate"]
    assert len(fewer) == 3 and (fewer[0], fewer[-1]) == (depths[0], depths[-1])


def test_a_deep_insertion_adds_more_than_a_shallow_one(monkeypatch):
    monkeypatch.setattr(identification, "OUTER_DRAWS", 40)
    monkeypatch.setattr(identification, "EFFORT", Effort(draws=100, min_ess=150.0))
    job = prepare_chicken("chicken-01")
    few = tuple(one for one in job.dataset.insertions if one.id in ("chicken-01", "chicken-04", "chicken-06"))
    job = replace(job, dataset=replace(job.dataset, insertions=few))
    values, _ = choose_reference_values(job)
    problem = simulate_design(job.problem(job.folds[0]), values)
    found = rank_candidates(job, job.folds[0], problem, problem.parameters.theta(values), Settings())
    assert found["nats"].is_monotonic_decreasing and np.isfinite(found["nats"]).all()
    rows = found.set_index("insertion")
    deep, shallow = rows.loc["chicken-06"], rows.loc["chicken-04"]
    assert deep["nats"] > shallow["nats"] + 3 * shallow["nats_se"]
    assert deep["sd_after"] < shallow["sd_after"] < deep["sd_now"]
    assert rows["role"].to_dict() == {"chicken-01": "repeat"} | dict.fromkeys(
        ("chicken-04", "chicken-06"), "candidate"
    )
