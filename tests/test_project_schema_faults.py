"""Faults of a file in words: one for each key, and none of pydantic's own names."""

import pytest
from pydantic import ValidationError

from needlefit.errors import ConfigError
from needlefit.project.toml import load, schema_faults
from needlefit.schemas.dataset import MeasurementRecord
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.recipe import RecipeRecord


def faults(record=RecipeRecord, **table):
    with pytest.raises(ValidationError) as caught:
        record.model_validate(table if record is MeasurementRecord else {"schema": 1, **table})
    return schema_faults(caught.value, record)


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


@pytest.mark.parametrize("name", ["mu3_pa", "mu3"])
@pytest.mark.parametrize("parameter", [{"as": "mu1", "spread": 1.2}, {"spread": 1.2}])
def test_a_parameter_that_states_nothing_known_names_its_forms(name, parameter):
    for fault in faults(MediumRecord, layers=3, parameters={name: parameter}):
        assert fault.key.startswith(f"parameters.{name}") and f"parameters.{name}" in fault.fix
        assert 'tie = "mu1_pa", spread = 1.2' in fault.expected


@pytest.mark.parametrize("operator", ["gaussian", "spline", "unknown"])
def test_an_operator_without_its_keys_names_them(operator):
    (fault,) = faults(MeasurementRecord, operator=operator)
    assert operator in fault.what and operator in fault.expected and fault.fix


def test_a_file_of_a_later_schema_is_refused_and_left_alone(tmp_path):
    file, text = tmp_path / "recipe.toml", f"schema = {RecipeRecord.SCHEMA + 1}\n"
    file.write_text(text)
    with pytest.raises(ConfigError) as fault:
        load(file, RecipeRecord)
    assert fault.value.where == f"{file}:1" and "`schema`" in fault.value.what and file.read_text() == text
    for schema in range(1, RecipeRecord.SCHEMA + 1):
        file.write_text(f"schema = {schema}\n")
        load(file, RecipeRecord)
