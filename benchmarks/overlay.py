"""What lies over the needle of `needlefit view`: how long its live errors and its band take.

    python benchmarks/overlay.py [--json] [--rounds N]

An insertion of the twin, 40 mm deep. The band is of 100 parameter sets about the paper's hand-tuned one, on
one thread: of a needle that was inserted at once; one whose base was moved and which was drawn back and
pushed in again; one whose base a hand moved all the way, 400 inputs; and one with a guide in the tissue. Then
a loop at 60 Hz stands beside a thread that draws bands without a pause: how late its ticks are. Milliseconds
on the wall, median and 95th percentile.
"""

import argparse
import json
import threading
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from needlefit.inference.forward_model import ParameterDraws
from needlefit.mechanics.control import Guide
from needlefit.mechanics.scene import Scene
from needlefit.mechanics.session import Session
from needlefit.planning.steering import StartedInsertion
from needlefit.viewer.opening import open_target
from needlefit.viewer.overlays import compute_band, compute_live_errors

SUBJECT, DEPTH, DRAWS, RATE = "twin/phantom2-07", 40.0, 100, 60.0

Figures = dict[str, list[float]]


def measure(rounds: int) -> Figures:
    """Return the median and the 95th percentile of each time, ms."""
    subject = open_target(SUBJECT)
    scene, spread = Scene.from_record(subject.record), sets(Scene.from_record(subject.record))
    ways = {name: led(scene, subject.first_cell, lead) for name, lead in LEADS.items()}

    def drawn(session: Session) -> None:
        rules = replace(scene.rules, first_cell=subject.first_cell)
        path = session.input_path()
        compute_band(StartedInsertion(scene.needle, scene.tissue, rules, path, spread))

    once = ways["inserted at once"].now.shape
    figures = {"live errors": timed(lambda: compute_live_errors(subject.measured, once), 20 * rounds)}
    for name, session in ways.items():
        figures[f"band, {name}"] = timed(lambda session=session: drawn(session), rounds)
    return figures | {"ticks beside bands": late(lambda: drawn(ways["base moved by hand"]))}


def sets(scene: Scene) -> ParameterDraws:
    """Return parameter sets about those of the scene."""
    factors = np.exp(0.2 * np.random.default_rng(1).normal(size=(DRAWS, scene.tissue.layers + 1)))
    shape = np.tile(scene.tissue.shape, (DRAWS, 1, 1))
    return ParameterDraws(
        scene.tissue.mu * factors[:, 1:], shape, scene.steps[0].bevel.offset * factors[:, 0]
    )


def at_once(session: Session) -> None:
    """Insert it."""
    session.step(DEPTH)


def back_and_forth(session: Session) -> None:
    """Move its base, draw it back, push it in again."""
    session.step(DEPTH - 5.0)
    session.step(5.0, base=(0.5, 0.01))
    session.step(-5.0)
    session.step(5.0, base=(0.2, 0.0))


def by_hand(session: Session) -> None:
    """Move its base with every tenth of a millimetre."""
    for n in range(round(10 * DEPTH)):
        session.step(0.1, base=(0.5 * np.sin(n / 30), 0.0))


def guided(session: Session) -> None:
    """Hold it in the tissue."""
    session.step(DEPTH / 2)
    session.step(DEPTH / 2, guides=(Guide(5.0, 0.0, None, in_tissue=True),))


LEADS: dict[str, Callable[[Session], None]] = {
    "inserted at once": at_once,
    "drawn back, base moved": back_and_forth,
    "base moved by hand": by_hand,
    "guide in the tissue": guided,
}


def led(scene: Scene, first_cell: float, lead: Callable[[Session], None]) -> Session:
    """Return a needle that was led so."""
    first = scene.steps[0]
    session = Session(scene.needle, scene.tissue, first.bevel, first_cell, first.controls, scene.rules)
    lead(session)
    return session


def timed(work: Callable[[], object], rounds: int) -> list[float]:
    """Return median and 95th percentile of the time that some work takes, ms."""
    work()  # plans the stops
    times = []
    for _ in range(rounds):
        begin = time.perf_counter()
        work()
        times.append(1e3 * (time.perf_counter() - begin))
    return np.percentile(times, (50, 95)).tolist()


def late(work: Callable[[], object], seconds: float = 5.0) -> list[float]:
    """Return how late the ticks of a loop are beside a thread that does nothing but the work, ms."""
    done = threading.Event()

    def again() -> None:
        while not done.is_set():
            work()

    overlays = threading.Thread(target=again)
    overlays.start()
    due, found = time.perf_counter(), []
    for _ in range(round(seconds * RATE)):
        due += 1 / RATE
        time.sleep(max(0.0, due - time.perf_counter()))
        found.append(1e3 * (time.perf_counter() - due))
    done.set()
    overlays.join()
    return np.percentile(found, (50, 95)).tolist()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--rounds", type=int, default=30)
    given = parser.parse_args()
    found = measure(given.rounds)
    if given.json:
        print(json.dumps(found))
    else:
        for name, (middle, most) in found.items():
            print(f"{name:32s}{middle:9.2f}{most:9.2f}")
