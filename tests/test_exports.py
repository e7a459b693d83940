"""The last moment of a recording as every file that `simulate --recording` writes."""

import json

import pandas as pd
import pytest
from test_viewer_recording import recorded

from needlefit.planning.recording import read_recording
from needlefit.viewer.export import replay_to_end, write_file


@pytest.mark.sweep
def test_every_file_of_a_recording_is_of_its_last_moment(tmp_path):
    last = recorded(tmp_path / "log.csv").found[-1]
    done = replay_to_end(read_recording(tmp_path / "log.csv"))
    for option, name in {"csv": "shape.csv", "slicer": "shape.mrk.json", "plot": "a.svg"}.items():
        assert write_file(done, option, tmp_path / name)
    # recorded is the deflection of the beam, drawn the y of its tip
    assert pd.read_csv(tmp_path / "shape.csv")["y_mm"].iloc[-1] == pytest.approx(last[-1], abs=1e-6)
    (curve,) = json.loads((tmp_path / "shape.mrk.json").read_text())["markups"]
    assert curve["controlPoints"][-1]["position"][1] == pytest.approx(last[-1], abs=1e-6)
    write_file(done, "plot", tmp_path / "b.svg")
    assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "b.svg").read_bytes() != b""
