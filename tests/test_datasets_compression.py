"""Compression tests as files: every way to say stretch and stress, and every way to get them wrong."""

import math

import numpy as np
import pytest
from compression_cases import specimen, write
from refusals import refusal

from needlefit.datasets.compression import read_compression
from needlefit.errors import DataError

ONE = specimen(-3.0, 0.8)
KPA = (-1e3 * ONE.stress).tolist()
STRETCH = ONE.stretch.tolist()


def table(tmp_path, **columns):
    """A file gel.csv of these columns."""
    rows = list(zip(*columns.values(), strict=True))
    return write(tmp_path / "gel.csv", ",".join(columns), rows)


@pytest.mark.parametrize(("unit", "factor"), [("pa", 1e3), ("kpa", 1.0), ("mpa", 1e-3)])
@pytest.mark.parametrize("sign", [1, -1])
def test_units_and_either_sign_give_stresses_in_mpa_negative_in_compression(tmp_path, unit, factor, sign):
    path = table(tmp_path, stretch=STRETCH, **{f"true_stress_{unit}": [sign * factor * y for y in KPA]})
    test = read_compression(path)
    assert test.measure == "true" and test.specimens[0].name == "gel"
    assert test.specimens[0].stress == pytest.approx(ONE.stress, rel=1e-12)
    assert ("positive" in " ".join(test.warnings)) == (sign > 0)


@pytest.mark.parametrize(("size", "value"), [("area_mm2", 50 * math.pi), ("diameter_mm", 10 * math.sqrt(2))])
def test_force_and_displacement_need_the_specimen_s_size_once(tmp_path, size, value):
    once = [""] * (len(STRETCH) - 1)
    path = table(
        tmp_path,
        sample=["a"] * len(STRETCH),
        displacement_mm=[20 * (1 - x) for x in STRETCH],
        height_mm=[20, *once],
        force_n=[y * 1e-3 * 50 * math.pi for y in KPA],
        **{size: [value, *once]},
    )
    test = read_compression(path)
    assert test.measure == "nominal" and test.specimens[0].name == "a"
    assert test.specimens[0].stretch == pytest.approx(ONE.stretch)
    assert test.specimens[0].stress == pytest.approx(ONE.stress, rel=1e-9)


def test_the_option_states_the_measure_of_stress(tmp_path):
    path = table(tmp_path, stretch=STRETCH, stress_kpa=KPA)
    assert read_compression(path, "true").measure == "true"
    error = refusal(DataError, "stress", read_compression, path)
    assert "--stress" in error.fix
    with pytest.raises(DataError, match=r"nominal.*--stress.*true"):
        read_compression(table(tmp_path, stretch=STRETCH, nominal_stress_kpa=KPA), "true")
    refusal(DataError, "no such file", read_compression, tmp_path / "none.csv")


def test_what_is_left_out_reversed_or_averaged_is_reported(tmp_path):
    back = [0.5 * y for y in KPA[::-1]]
    path = table(tmp_path, stretch=[*STRETCH, *STRETCH[::-1]], nominal_stress_kpa=[*KPA, *back])
    test = read_compression(path)
    assert test.specimens[0].stretch == pytest.approx(ONE.stretch)
    assert "gel.csv:61" in test.warnings[1] and "50 %" in test.warnings[1]
    test = read_compression(table(tmp_path, stretch=STRETCH[::-1], nominal_stress_kpa=KPA[::-1]))
    assert test.specimens[0].stress == pytest.approx(ONE.stress)
    assert "smallest stretch up" in test.warnings[1]
    many = np.linspace(1, 0.8, 1000)
    path = table(tmp_path, stretch=many, nominal_stress_kpa=10 * (1 - many))
    test = read_compression(path)
    one = test.specimens[0]
    assert len(one.stretch) == 200 and one.stretch[0] == pytest.approx(np.mean(many[:5]))
    assert one.stress == pytest.approx(-0.01 * (1 - one.stretch))
    assert "200 points" in test.warnings[1]
    shaken = np.array(STRETCH) + 0.002 * np.random.default_rng(1).normal(size=60)
    test = read_compression(table(tmp_path, stretch=np.minimum(shaken, 1), nominal_stress_kpa=KPA))
    assert len(test.specimens[0].stretch) == 60 and np.all(np.diff(test.specimens[0].stretch) <= 0)
    waits = 500
    path = table(
        tmp_path,
        stretch=[STRETCH[0]] * waits + list(STRETCH),
        nominal_stress_kpa=[KPA[0]] * waits + list(KPA),
    )
    (one,) = read_compression(path).specimens
    assert one.stretch[-1] < one.stretch[0] == pytest.approx(STRETCH[0])


def test_a_preload_gives_a_warning(tmp_path):
    assert not [
        warning for warning in read_compression(_loaded(tmp_path, 0.0)).warnings if "at stretch 1" in warning
    ]
    warnings = read_compression(_loaded(tmp_path, 0.1)).warnings
    assert " 9 % " in warnings[1] and "stretch 1" in warnings[1]  # 0.1 / 1.1


def _loaded(tmp_path, part):
    return table(tmp_path, stretch=STRETCH, nominal_stress_kpa=[y + part * KPA[-1] for y in KPA])


@pytest.mark.parametrize(
    ("columns", "expected"),
    [
        ({"stretch": [100 * x for x in STRETCH], "nominal_stress_kpa": KPA}, "percent"),
        ({"stretch": [1 - x for x in STRETCH], "nominal_stress_kpa": KPA}, "strain"),
        ({"stretch": [x - 1 for x in STRETCH], "nominal_stress_kpa": KPA}, "strain"),
        ({"stretch": [2 - x for x in STRETCH], "nominal_stress_kpa": KPA}, "tension"),
        (
            {"stretch": [0.99 + 0.01 * x for x in [*[1.0] * 54, *STRETCH[:6]]], "nominal_stress_kpa": KPA},
            "hardly",
        ),
        ({"stretch": [x + 0.1 for x in STRETCH], "nominal_stress_kpa": KPA}, "tension and compression"),
        ({"stretch": STRETCH, "nominal_stress_kpa": [y - KPA[30] for y in KPA]}, "through zero"),
        ({"stretch": STRETCH, "nominal_stress_kpa": [0] * 60}, "0 throughout"),
        (
            {"stretch": STRETCH, "nominal_stress_kpa": [*KPA[:-1], ""]},
            "gel.csv:61: nominal_stress_kpa ",
        ),
        ({"stretch": ["x", *STRETCH[1:]], "nominal_stress_kpa": KPA}, "gel.csv:2: stretch is 'x'"),
        ({"stretch": STRETCH[:5], "nominal_stress_kpa": KPA[:5]}, " 5 "),
        ({"stretch": STRETCH, "stress": KPA}, "no columns give the stress"),
        ({"stretch": STRETCH, "force_n": KPA}, "no columns give the stress"),
        ({"strain": STRETCH, "nominal_stress_kpa": KPA}, "no columns give the stretch"),
        ({"stretch": STRETCH, "nominal_stress_kpa": KPA, "true_stress_kpa": KPA}, "is given by"),
        ({"sample": [""] * 60, "stretch": STRETCH, "nominal_stress_kpa": KPA}, "sample is empty"),
        (
            {"displacement_mm": KPA, "height_mm": [*[20] * 30, *[21] * 30], "nominal_stress_kpa": KPA},
            "height_mm of specimen gel is 20, 21",
        ),
        (
            {"stretch": [*STRETCH, *STRETCH[::-1], *STRETCH], "nominal_stress_kpa": [*KPA, *KPA[::-1], *KPA]},
            " 2 times",
        ),
    ],
)
def test_faulty_tables_are_refused_with_a_fix(tmp_path, columns, expected):
    error = refusal(DataError, "", lambda: read_compression(table(tmp_path, **columns)))
    assert expected in str(error)
    assert error.fix or "fix:" in str(error)
