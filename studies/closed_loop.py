"""How near does a needle come to its target with feedback, where the truth differs from fit and model?

    python studies/closed_loop.py [--needles 50] [--quick]

True moduli differ from the expected ones by a factor of 1.8 (SD), b by 1.4; the base follows 75 % of each
command. Every 10 mm the tip is measured, in `shape` eight points (SD 0.3 mm). `again`: planned again without
measurements; `tip`, `shape`: with draws weighted by these; `proportional`: the base moves by twice the tip's
offset from the straight way; `resolved rate`: by the Jacobian of the end; `true`: with the true parameters.
Columns: mean miss and its standard error (mm); % of misses in the 95 % interval of the plan at each depth.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

import needlefit

TARGET, STOP_MM, SD_MM = np.array([80.0, 3.0]), 10.0, 0.3
OUT, DEPTHS, MU_PA, B_MM = Path("reports/closed_loop.png"), range(0, 80, 10), np.array([5e3, 2e4]), 0.1
TRUTHS = ("as modelled", "play 0.2 mm", "layer 1 mm deeper", "friction 50", "path angle")
CONTROLS = ("open", "again", "tip", "shape", "proportional", "resolved rate", "true")
NEEDLE = {"name": "18 gauge", "length_mm": 150, "outer_diameter_mm": 1.27, "youngs_modulus_gpa": 80}
LAYERS = [{"top_mm": 0.0, "mu_pa": 5e3, "alpha": 1.0}, {"top_mm": 25.0, "mu_pa": 2e4, "alpha": 1.0}]
SCENE = {"depth_mm": 80.0, "needle": NEEDLE, "bevel": {"offset_mm": B_MM}, "layers": LAYERS}


def make_medium(mu_pa: np.ndarray, b_mm: float, spread: float) -> dict:
    parameters = {f"alpha{n}": {"fixed": 1.0} for n in (1, 2)}
    for name, at, by in (("mu1_pa", mu_pa[0], 1.8), ("mu2_pa", mu_pa[1], 1.8), ("bevel_mm", b_mm, 1.4)):
        parameters[name] = {"bounds": [at / 1e3, at * 1e3], "prior": {"median": at, "factor": by**spread}}
    return {"layers": 2, "parameters": parameters}


class Robot:
    """A true needle, and a base that follows a part of each command."""

    def __init__(self, mu_pa: np.ndarray, b_mm: float, gain: float, truth: str) -> None:
        scene = needlefit.open_scene(SCENE)
        tissue, rules, bevel = replace(scene.tissue, mu=1e-6 * mu_pa), scene.rules, needlefit.Bevel(b_mm)
        deeper, rubs = 1.0 * (truth == "layer 1 mm deeper"), 50.0 * (truth == "friction 50")
        tissue = replace(tissue, boundaries=tissue.boundaries + deeper, friction=np.full(2, rubs))
        if truth == "path angle":  # another law of advance
            rules, bevel = replace(rules, advance="path_angle"), needlefit.Bevel(cut_angle=0.3 * b_mm)
        self.needle = needlefit.Session(scene.needle, tissue, bevel, rules=rules)
        self.bevel, self.gain, self.play, self.base_y = bevel, gain, 0.1 * (truth == "play 0.2 mm"), 0.0

    def drive(self, step: needlefit.Step) -> np.ndarray:
        controls, bevel = step.controls, replace(self.bevel, side=step.bevel.side)
        self.base_y = float(np.clip(self.base_y, controls.base_y - self.play, controls.base_y + self.play))
        moved = replace(controls, base_y=self.gain * self.base_y, base_slope=self.gain * controls.base_slope)
        shape = self.needle.go(replace(step, bevel=bevel, controls=moved))
        return needlefit.compute_positions(shape, np.array([step.depth]))[0]


def correct(steering: needlefit.Steering, tip: np.ndarray, control: str) -> tuple[needlefit.Step, ...]:
    """Return the next step of a controller that does not plan."""
    now, base = steering.now, steering.now.controls
    moved, deeper = np.array([base.base_y, base.base_slope]), min(now.depth + STOP_MM, TARGET[0])
    if control == "proportional":
        moved[0] += 2 * (tip[1] - TARGET[1] * now.depth / TARGET[0])
    elif now.depth < TARGET[0] - STOP_MM / 2:
        expected = steering.predict(TARGET[0]).mean[0] - steering.predict().mean[0]
        slopes = steering.jacobian(TARGET[0])[1, :2] * (1.0, 0.01)  # per mm, and per 0.01 of slope
        moved += slopes * (1.0, 0.01) * (TARGET[1] - tip[1] - expected) / (slopes @ slopes + 1e-3)
    y, slope = np.clip(moved, (-10, -0.087), (10, 0.087)).tolist()
    return (replace(now, depth=deeper, controls=replace(base, base_y=y, base_slope=slope)),)


def steer(seed: int, control: str, truth: str) -> dict:
    rng, true = np.random.default_rng(seed), control == "true"
    mu, b = MU_PA * 1.8 ** rng.standard_normal(2), B_MM * 1.4 ** rng.standard_normal()
    medium = make_medium(mu, b, 1e-6) if true else make_medium(MU_PA, B_MM, 1.0)
    options = {"draws": 8 if true else 200, "gain_sd": 0.0 if true else 0.25}
    steering, planned = needlefit.Steering(medium, SCENE, seed=seed, **options), control not in CONTROLS[4:6]
    robot, tip, plans = Robot(mu, b, 1.0 if true else 0.75, truth), np.zeros(3), {0: steering.plan(TARGET)}
    for stop in np.arange(STOP_MM, TARGET[0] + 2 * STOP_MM, STOP_MM):
        depth = steering.now.depth
        if 0 < depth < TARGET[0] - 5 and control in ("tip", "shape"):
            places = np.zeros(1) if control == "tip" else np.linspace(0.0, depth, 8, endpoint=False)
            points = needlefit.compute_positions(robot.needle.now.shape, depth - places)[:, :2]
            points += SD_MM * rng.standard_normal((len(places), 1)) * (0, 1)
            steering.measure(points[0] if control == "tip" else points, control, sd=SD_MM)
        if control in ("again", "tip", "shape", "true") and 0 < depth < TARGET[0] - 5:
            plans[round(depth)] = steering.plan(TARGET)
        seen = np.add(tip, (0, SD_MM * (depth > 0) * rng.standard_normal(), 0))
        for step in plans[max(plans)].cut_at(stop) if planned else correct(steering, seen, control):
            if step.depth > depth:
                tip, _ = robot.drive(step), steering.advance(step)
    miss = np.hypot(*(tip[:2] - TARGET))
    inside = {depth: 100.0 * (miss <= np.quantile(made.misses, 0.95)) for depth, made in plans.items()}
    return {"truth": truth, "control": control, "miss": miss, **(inside if planned else {})}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="three needles as modelled")
    parser.add_argument("--needles", type=int, default=50)
    given = parser.parse_args()
    truths, needles = (TRUTHS[:1], range(3)) if given.quick else (TRUTHS, range(given.needles))
    rows = pd.DataFrame([steer(n, c, t) for t in truths for c in CONTROLS for n in needles])
    cases = rows.groupby(["truth", "control"], sort=False)
    table = cases["miss"].agg(["mean", "sem"]).join(cases[[*DEPTHS]].mean().round())
    print(table.to_string(float_format="{:.3g}".format, na_rep=""))
    OUT.parent.mkdir(exist_ok=True)
    figure, (bars, *axes) = plt.subplots(1, 3, figsize=(9.0, 3.4), layout="constrained")
    means, errors = (table[name].unstack("truth", sort=False) for name in ("mean", "sem"))
    means.plot.bar(ax=bars, yerr=1.96 * errors, rot=90, xlabel="", ylabel="mean miss (mm)")
    bars.legend(fontsize=7)
    for ax, control in zip(axes, ("tip", "shape"), strict=True):
        table.xs(control, level="control")[[*DEPTHS]].T.plot(ax=ax, legend=False, ylim=(0, 103))
        ax.set(xlabel="planned at (mm)", ylabel="misses in 95 % interval (%)", title=control)
    figure.savefig(OUT, dpi=150)


if __name__ == "__main__":
    main()
