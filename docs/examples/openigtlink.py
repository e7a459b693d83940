"""Stream a simulated needle by OpenIGTLink, and weight the draws of a fit by measured tips.

    python -m pip install needlefit 'pyigtl>=0.3.4'
    python docs/examples/openigtlink.py SCENE [--run RUN] [--port 18944]

For research only. Lengths in mm, in the constraint frame C: x along the entry, the needle bends along y. In
3D Slicer, put what arrives under the transform from C to RAS. Sent, 30 times a second:

    NeedlefitTip       TRANSFORM  the tip; z points along the needle
    NeedlefitNeedle    POINT      51 points of the centreline, from base to tip
    NeedlefitEstimate  STRING     JSON, after a measured tip: count of tips, effective sample size of the
                                  draws (ess), and the 2.5, 50 and 97.5 % quantiles of each parameter

Taken:

    Input              STRING     JSON: speed_mm_s, base_y_mm, bevel_side (1 or -1); others stay as they are
    Tip                TRANSFORM  the tip as measured; only y is used, once for each mm of insertion

RUN is a folder of `tune` or `validate` whose tissue model has the layers of SCENE. Each draw of its posterior
is simulated along the inputs so far, and weighted by the density of the measured tip (importance sampling);
alpha is that of SCENE. Draws are not moved: where ess falls below about 10, fit again. Errors of registration
are left out.
"""

import argparse
import json
import time
from dataclasses import replace

import numpy as np
import pandas as pd
import pyigtl

import needlefit

TIP_SD_MM = 0.5  # of a measured tip across the needle
READING_MM = 1.0  # insertion from one measured tip to the next that is used: errors of near ones are alike
POINTS, INTERVAL_S = 51, 1 / 30


class WeightedDraws:
    """Draws of the moduli (Pa) and b (mm) of a fit, and their weights by the tips measured so far."""

    def __init__(self, draws: pd.DataFrame, layers: int) -> None:
        draws = draws[draws["fold"] == draws["fold"].iloc[0]]
        new = draws["specimen"] == "(new)"  # of a specimen that was not fitted, where specimens differ
        self.names = [*(f"mu{n}_pa" for n in range(1, layers + 1)), "bevel_mm"]
        self.values = draws.loc[new if new.any() else draws["specimen"] == "(tuned)", self.names].to_numpy()
        self.log_weights = np.zeros(len(self.values))
        self.count, self.deepest = 0, 0.0

    def take(self, session: needlefit.Session, measured_y: float) -> bool:
        """Weight the draws by a measured tip; return whether it is used."""
        if session.depth < self.deepest + READING_MM:
            return False
        rules = replace(session.rules, first_cell=session.lattice.first_cell)
        sets = {"mu": self.values[:, :-1] * 1e-6, "offset": self.values[:, -1]}  # MPa, mm
        batch = needlefit.Batch(session.needle, session.tissue, session.input_path(), rules, **sets)
        (shapes,) = needlefit.simulate_batches([batch])
        tips = np.array([shapes[i].tip_lateral for i in range(len(batch))])
        off = np.nan_to_num(measured_y - tips, nan=np.inf)  # a draw without a solution has no weight
        self.log_weights = self.log_weights - 0.5 * (off / TIP_SD_MM) ** 2
        self.count, self.deepest = self.count + 1, session.depth
        return True

    def describe(self) -> str:
        """Return the count of tips, the effective sample size, and quantiles of each parameter as JSON."""
        weights = np.exp(self.log_weights - self.log_weights.max())
        weights /= weights.sum()
        found = {"count": self.count, "ess": 1 / float(weights @ weights)}
        for name, column in zip(self.names, self.values.T, strict=True):
            order = np.argsort(column)
            below = np.cumsum(weights[order]) - weights[order] / 2
            found[name] = np.interp([0.025, 0.5, 0.975], below, column[order]).tolist()
        return json.dumps(found)


class StreamedNeedle:
    """A needle that goes in at a speed, mm/s: what it takes, and what it sends."""

    def __init__(self, scene: needlefit.Scene, draws: WeightedDraws | None) -> None:
        first = scene.steps[0]
        inputs = {"controls": first.controls, "rules": scene.rules}
        self.session = needlefit.Session(scene.needle, scene.tissue, first.bevel, **inputs)
        self.speed, self.draws, self.estimate = 0.0, draws, ""

    def take(self, message: pyigtl.messages.MessageBase) -> None:
        """Carry out inputs, or weight the draws by a measured tip."""
        last, name = self.session.last, message.device_name
        if name == "Input":
            given = json.loads(message.string)
            self.speed = float(given.get("speed_mm_s", self.speed))
            bevel = replace(last.bevel, side=int(given.get("bevel_side", last.bevel.side)))
            base_y = float(given.get("base_y_mm", last.controls.base_y))
            self.session.step(bevel=bevel, base=(base_y, last.controls.base_slope))
        elif name == "Tip" and self.draws and self.draws.take(self.session, float(message.matrix[1, 3])):
            self.estimate = self.draws.describe()

    def advance(self, seconds: float) -> None:
        """Insert or retract; a needle for which the model finds no solution stays where it is and stops."""
        way = max(self.speed * seconds, -self.session.depth)
        if way and not self.session.step(insert=way).converged:
            self.speed = 0.0

    def list_messages(self) -> list[pyigtl.messages.MessageBase]:
        """Return what is sent of the needle as it stands."""
        shape = self.session.now.shape
        points = needlefit.compute_positions(shape, np.linspace(shape.x[0], shape.x[-1], POINTS))
        cos, sin = np.cos(shape.slope[-1]), np.sin(shape.slope[-1])
        tip = np.eye(4)
        tip[:3] = np.column_stack([[-sin, cos, 0.0], [0.0, 0.0, 1.0], [cos, sin, 0.0], points[-1]])
        sent = [pyigtl.TransformMessage(tip, device_name="NeedlefitTip")]
        sent += [pyigtl.PointMessage(points.tolist(), device_name="NeedlefitNeedle")]
        estimate = pyigtl.StringMessage(self.estimate, device_name="NeedlefitEstimate")
        return [*sent, estimate] if self.estimate else sent


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene")
    parser.add_argument("--run", help="folder of a run, whose draws are weighted")
    parser.add_argument("--port", type=int, default=18944)
    asked = parser.parse_args()
    scene, draws = needlefit.open_scene(asked.scene), None
    if asked.run:
        draws = WeightedDraws(needlefit.load_run(asked.run).frames["draws"], scene.tissue.layers)
    needle, server = StreamedNeedle(scene, draws), pyigtl.OpenIGTLinkServer(asked.port, local_server=True)
    print("{}:{}".format(*server.server_address), flush=True)
    last = time.monotonic()
    while True:
        now, seconds = time.monotonic(), time.monotonic() - last
        try:
            for message in server.get_latest_messages():
                needle.take(message)
            needle.advance(seconds)
        except (needlefit.NeedlefitError, ValueError) as error:  # an input that the model does not take
            print(error, flush=True)
            needle.speed = 0.0
        for message in needle.list_messages() if server.is_connected() else ():
            server.send_message(message, wait=False)
        last = now
        time.sleep(INTERVAL_S)


if __name__ == "__main__":
    main()
