"""What fits keep of solutions outside the model's assumptions: counts, warnings, never a penalty."""

import json

import numpy as np
import pytest
from inference_cases import NEEDLE, TRUTH, dataset, insertion, medium, two_layers

from needlefit.errors import ConfigError, NeedlefitError
from needlefit.inference.forward_model import predict
from needlefit.inference.problem import find_outside_validity
from needlefit.project.result_warnings import read_warnings
from needlefit.schemas.limits import MAX_LAYERS
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.recipe import RecipeRecord, SampleRecord
from needlefit.schemas.scene import SceneRecord
from needlefit.studies.kinds.sensitivity import VariationRecord
from needlefit.studies.score import Scorer, model_predictor
from needlefit.studies.validity import ValidityCounts, describe_outside, list_outside

STEEP = {**TRUTH, "bevel_mm": 0.9}


def test_parameter_sets_are_outside_where_any_of_their_needles_is():
    problem = two_layers(count=2)
    thetas = [problem.parameters.theta({**TRUTH, "bevel_mm": b}) for b in (0.02, 0.08, 0.5, 0.9)]
    found = find_outside_validity(problem, thetas)
    for theta, beyond in zip(thetas, found, strict=True):
        shapes = problem.shapes(theta)
        assert beyond == any(shape.converged and not shape.valid for shape in shapes)
    assert not found[0] and found[-1]
    assert find_outside_validity(problem, []).shape == (0,)
    assert all(np.isfinite(problem.objective(theta)) for theta in thetas)  # nothing is penalised


def test_scored_simulations_are_counted_and_named():
    one = insertion(41.0, (25.0,), (1, 2))
    data = dataset([one])
    scorer = Scorer(data, "listed", {one.id: {"te_mm": 0.25}})
    for method, values in (("fitted", TRUTH), ("fitted", STEEP), ("hand_tuned", STEEP)):
        place = {"fold": "all", "role": "tune", "method": method}
        scorer.score(place, one, model_predictor(values, medium(), data))
    assert predict(STEEP, medium(), NEEDLE, one).converged
    table = json.loads(json.dumps(scorer.counts.table()))
    assert table["scored"] == {"simulations": 3, "outside": 2}
    assert table["fitted_outside"] == 1
    assert [row["method"] for row in table["scored_outside"]] == ["fitted", "hand_tuned"]
    (row,) = [row for row in table["scored_outside"] if row["method"] == "fitted"]
    assert row["insertion"] == one.id and row["faults"]
    (words,) = list_outside({"validity": table})
    assert words.startswith("1 ")
    assert "2 of 3" in describe_outside({"validity": table})


def test_a_run_inside_its_limits_has_no_warning():
    counts = ValidityCounts()
    counts.draws.add(400, 0)
    assert list_outside({"validity": counts.table()}) == []
    assert describe_outside({"validity": counts.table()}) == ""
    assert describe_outside({}) == "" and list_outside({}) == []
    counts.draws.add(400, 3)  # fewer than one in a hundred
    assert list_outside({"validity": counts.table()}) == []
    counts.draws.add(400, 30)
    assert len(list_outside({"validity": counts.table()})) == 1
    assert read_warnings({}) == ()


BASE = {"schema": 1, "layers": 1, "parameters": {}}


@pytest.mark.parametrize(
    ("record", "key", "tables"),
    [
        (MediumRecord, "layers", BASE | {"layers": MAX_LAYERS + 1}),
        (MediumRecord, "constraint_spacing_mm", BASE | {"constraint_spacing_mm": 0.001}),
        (MediumRecord, "constraint_spacing_mm", BASE | {"constraint_spacing_mm": 1e7}),
        (VariationRecord, "constraint_spacing_mm", {"of": "a", "name": "b", "constraint_spacing_mm": 1e7}),
        (RecipeRecord, "starts", {"schema": 1, "starts": 10**9}),
        (RecipeRecord, "evaluations", {"schema": 1, "evaluations": 10**12}),
        (SampleRecord, "walkers", {"walkers": 10**7}),
        (SampleRecord, "steps", {"ensembles": 50, "walkers": 1000, "steps": 20000}),
        (SceneRecord, "depth_mm", {"schema": 1, "depth_mm": 9e8}),
    ],
)
def test_one_key_cannot_ask_for_gigabytes(record, key, tables):
    from needlefit.project.toml import check

    with pytest.raises(ConfigError) as caught:
        check(tables, record, "a file")
    assert key in caught.value.what


def test_an_oversized_chain_is_refused_before_it_starts():
    from needlefit.inference.sampling.sample import sample

    problem = two_layers(count=1)
    many = SampleRecord(ensembles=10, walkers=40, steps=10_000)
    many = many.model_copy(update={"steps": 10**7})  # past the schema, as a program may
    with pytest.raises(NeedlefitError):
        sample(problem, np.array(problem.lower), many, np.random.default_rng(1))
