"""Stream a simulated needle by OpenIGTLink, and weight the draws of a fit by measured tips.

    python -m pip install needlefit 'pyigtl>=0.3.4'
    python docs/examples/openigtlink.py SCENE [--run RUN] [--port 18944]

For research only. Lengths in mm, in the constraint frame C: x along the entry, the needle bends along y. In
3D Slicer, put what arrives under the transform from C to RAS. Sent, 30 times a second:

    NeedlefitTip       TRANSFORM  the tip; z points along the needle
    NeedlefitNeedle    POINT      51 points of the centreline, from base to tip
    NeedlefitEstimate  STRING     JSON, after a measured tip: count of tips, effective sample size of the
                                  draws (ess), and the tip's y: 2.5 % quantile, mean, 97.5 % quantile

Taken:

    Input              STRING     JSON: speed_mm_s, base_y_mm, bevel_side (1 or -1); others stay as they are
    Tip                TRANSFORM  the tip as measured, once for each mm of insertion

RUN is a folder of `tune` or `validate` whose tissue model has the layers of SCENE. `needlefit.Steering`
weights its draws by the measured tips. Errors of registration are left out.
"""

import argparse
import json
import time
from dataclasses import replace

import numpy as np
import pyigtl

import needlefit

TIP_SD_MM = 0.5  # of a measured tip across the needle
READING_MM = 1.0  # insertion from one measured tip to the next that is used: errors of near ones are alike
POINTS, INTERVAL_S = 51, 1 / 30


class StreamedNeedle:
    """A needle that goes in at a speed, mm/s: what it takes, and what it sends."""

    def __init__(self, scene: needlefit.Scene, steering: needlefit.Steering | None) -> None:
        first = scene.steps[0]
        inputs = {"controls": first.controls, "rules": scene.rules}
        self.session = needlefit.Session(scene.needle, scene.tissue, first.bevel, **inputs)
        self.speed, self.steering, self.estimate = 0.0, steering, ""
        self.count, self.deepest = 0, 0.0

    def take(self, message: pyigtl.messages.MessageBase) -> None:
        """Carry out inputs, or weight the draws by a measured tip."""
        last, name = self.session.last, message.device_name
        if name == "Input":
            given = json.loads(message.string)
            self.speed = float(given.get("speed_mm_s", self.speed))
            bevel = replace(last.bevel, side=int(given.get("bevel_side", last.bevel.side)))
            base_y = float(given.get("base_y_mm", last.controls.base_y))
            self.session.step(bevel=bevel, base=(base_y, last.controls.base_slope))
            self.follow()
        elif name == "Tip" and self.steering and self.session.depth >= self.deepest + READING_MM:
            learned = self.steering.measure(message.matrix[:2, 3], sd=TIP_SD_MM)
            self.count, self.deepest = self.count + 1, self.session.depth
            tip = self.steering.predict()
            y = [float(one[0]) for one in (tip.low, tip.mean, tip.high)]
            self.estimate = json.dumps({"count": self.count, "ess": learned.effective, "tip_y_mm": y})

    def follow(self) -> None:
        """Give the inputs of the needle to the draws."""
        if self.steering:
            last, bevel = self.session.last, self.steering.now.bevel
            self.steering.advance(replace(last, bevel=replace(bevel, side=last.bevel.side)))

    def advance(self, seconds: float) -> None:
        """Insert or retract; a needle for which the model finds no solution stays where it is and stops."""
        way = max(self.speed * seconds, -self.session.depth)
        if way and not self.session.step(insert=way).converged:
            self.speed = 0.0
        elif way:
            self.follow()

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
    scene, steering = needlefit.open_scene(asked.scene), None
    if asked.run:
        steering = needlefit.Steering(needlefit.load_run(asked.run), asked.scene)
    needle, server = StreamedNeedle(scene, steering), pyigtl.OpenIGTLinkServer(asked.port, local_server=True)
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
