"""The script that compares methods on left-out insertions."""

import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

ROOT = Path(__file__).resolve().parents[1]
STUDIES = ROOT / "studies"
SCRIPT = STUDIES / "left_out_differences.py"


@pytest.fixture
def compare_methods(monkeypatch):
    monkeypatch.syspath_prepend(STUDIES)
    from left_out_differences import compare_methods

    return compare_methods


def test_a_left_out_group_is_one_trial(compare_methods):
    """Differences of three groups 1, 2 and 3 mm; the first has two insertions, which count once."""
    groups = {"a": (0.5, 1.5), "b": (2.0,), "c": (3.0,)}
    of = {"role": "validate", "boundaries": "measured"}
    rows = [
        {"fold": fold, "method": method, **of, "ipe_mean_mm": te, "te_mm": te}
        for fold, more in groups.items()
        for one in more
        for method, te in (("fitted", 1.0), ("straight", 1.0 + one))
    ]
    rows.append({**rows[0], "role": "tune", "te_mm": 99.0})
    found = compare_methods(pd.DataFrame(rows)).set_index(["metric", "method"]).loc[("te_mm", "straight")]
    half = 4.302653 / 3**0.5  # 97.5 % quantile of Student's t with 2 degrees of freedom, SD 1
    expected = (3.0, 2.0, 2.0 - half, 2.0 + half)
    numbers = found[["error_mm", "difference_mm", "low_mm", "high_mm"]].astype(float)
    assert tuple(numbers) == pytest.approx(expected)
    assert (found["model_better"], found["trials"]) == (3, 3)


@pytest.mark.sweep
def test_pieces_of_chicken_are_left_out(tmp_path):
    out = tmp_path / "chicken.png"
    words = [sys.executable, str(SCRIPT), "leave_one_out_chicken", "--quick", "--out", str(out)]
    subprocess.run(words, check=True, cwd=tmp_path, capture_output=True, timeout=900)
    rows = pd.read_csv(out.with_suffix(".csv")).set_index(["metric", "method"])
    assert (rows["trials"] == 3).all() and out.stat().st_size > 10_000
    assert rows.loc[("te_mm", "fitted"), "error_mm"] < rows.loc[("te_mm", "straight"), "error_mm"]
