"""The script that streams a needle by OpenIGTLink, beside a client of the library."""

import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pyigtl
import pytest
from pytest import approx

SCRIPT = Path(__file__).parents[1] / "docs" / "examples" / "openigtlink.py"
PATIENCE_S = 60.0


@pytest.fixture
def client(world):
    """A client of the script, with a scene and a fit of its tissue model."""
    words = (world.folder / "configs/scenes/ahead.toml", "--run", world.find("cross_validation"), "--port", 0)
    command = [sys.executable, str(SCRIPT), *map(str, words)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            host, port = process.stdout.readline().split(":")
            client = pyigtl.OpenIGTLinkClient(host, int(port))
            yield client
            client.stop()
        finally:
            process.kill()


def wait(client, device, holds):
    """Return the first message of a device of which a condition holds."""
    end = time.monotonic() + PATIENCE_S
    while time.monotonic() < end:
        message = client.wait_for_message(device, timeout=PATIENCE_S)
        if message is not None and holds(message):
            return message
    raise AssertionError(f"no such {device}")


def test_a_needle_is_streamed_and_steered_and_draws_are_weighted_by_tips(client, world):
    def say(**inputs):
        client.send_message(pyigtl.StringMessage(json.dumps(inputs), device_name="Input"))

    say(speed_mm_s=20, base_y_mm=0.5, bevel_side=-1)
    wait(client, "NeedlefitTip", lambda tip: tip.matrix[0, 3] > 20)
    say(speed_mm_s=0)
    before = wait(client, "NeedlefitTip", lambda tip: True)
    while (tip := wait(client, "NeedlefitTip", lambda tip: True)).matrix.tolist() != before.matrix.tolist():
        before = tip
    points = np.array(wait(client, "NeedlefitNeedle", lambda one: True).positions)
    assert points.shape == (51, 3) and points[0, 1] == approx(0.5, abs=1e-4)
    assert points[-1] == approx(tip.matrix[:3, 3]) and tip.matrix[1, 3] < 0
    assert np.linalg.det(tip.matrix[:3, :3]) == approx(1, abs=1e-5)

    measured = np.eye(4)
    measured[:2, 3] = points[-1, :2] - (0.0, 0.5)
    for _ in range(2):  # at the same depth a second one is not used
        client.send_message(pyigtl.TransformMessage(measured, device_name="Tip"))
    said = wait(client, "NeedlefitEstimate", lambda one: True)
    found = json.loads(
        wait(client, "NeedlefitEstimate", lambda one: one.timestamp > said.timestamp + 0.2).string
    )
    low, mean, high = found["tip_y_mm"]
    assert found["count"] == 1 and found["ess"] > 1 and low < mean < high
