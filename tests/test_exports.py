"""The last moment of a recording as every file that the page exports."""

import io
import json

import pandas as pd
import pytest
from test_viewer_recording import recorded

from needlefit.planning.recording import read_recording
from needlefit.viewer.export import EXPORT_TYPES, export, replay_to_end, write_picture


@pytest.mark.sweep
def test_every_export_of_a_recording_is_of_its_last_moment(tmp_path) -> None:
    log = tmp_path / "log.csv"
    last = recorded(log).found[-1]
    written = {kind: export(log, kind) for kind in EXPORT_TYPES}
    table = pd.read_csv(io.BytesIO(written["shape.csv"]))
    # recorded is the deflection of the beam, drawn the y of its tip
    assert table["y_mm"].iloc[-1] == pytest.approx(last[-1], abs=1e-6)
    (curve,) = json.loads(written["shape.mrk.json"])["markups"]
    assert curve["controlPoints"][-1]["position"][1] == pytest.approx(last[-1], abs=1e-6)
    assert written["inputs.csv"] == log.read_bytes()
    done = replay_to_end(read_recording(log))
    for name in ("a.svg", "b.svg"):
        write_picture(done, tmp_path / name)
    assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "b.svg").read_bytes() != b""
