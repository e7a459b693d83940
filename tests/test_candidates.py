"""Candidates for a further insertion: which there are, and that a deeper one adds more."""

from needlefit.schemas.study import FitRecord
from needlefit.studies.job import Settings
from needlefit.studies.kinds import identification
from needlefit.studies.kinds.identification import list_insertion_candidates
from needlefit.studies.load import load_study


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
