"""Faults of a file in words: one for each key, and none of pydantic's own names."""

import pytest
from pydantic import ValidationError

from needlefit.project.load import schema_faults
from needlefit.schemas.recipe import RecipeRecord


def faults(**table):
    with pytest.raises(ValidationError) as caught:
        RecipeRecord.model_validate({"schema": 1, **table})
    return schema_faults(caught.value, RecipeRecord)


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (0, "above 0"),
        ("estimate", "quotes"),
        (float("inf"), "finite"),
    ],
)
def test_a_wrong_union_value_is_one_fault(value, expected):
    (fault,) = faults(likelihood={"noise_scale": value})
    assert fault.key == "likelihood.noise_scale"
    assert expected in fault.expected and '"estimated"' in fault.expected


def test_two_wrong_keys_are_two_faults():
    assert [one.key for one in faults(starts=0, likelihood={"depths": "deep"})] == [
        "starts",
        "likelihood.depths",
    ]
