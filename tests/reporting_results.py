"""Small made-up Run that take every branch of the reports; their errors follow from their shapes."""

from dataclasses import replace
from functools import cache

import numpy as np
import pandas as pd
from light_runs import draw_blank
from numpy.random import default_rng

from needlefit.datasets import paper
from needlefit.inference.sampling.posterior import Posterior
from needlefit.project.locate import find_file
from needlefit.project.toml import load
from needlefit.reporting import document
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.recipe import RecipeRecord
from needlefit.schemas.run_metadata import DatasetMetadata, FitMetadata
from needlefit.schemas.study import StudyRecord
from needlefit.studies.fit_warnings import tabulate_validity
from needlefit.studies.kinds.cross_validation import report
from needlefit.studies.kinds.cross_validation.rows import FRAMES
from needlefit.studies.kinds.cross_validation.run import find_faults
from needlefit.studies.run import Run
from needlefit.studies.score import FAILED


def with_frames(run, **frames):
    """Return a run with some tables replaced."""
    return replace(run, frames={**run.frames, **frames})


DEFLECTION = {("phantom2", 4): 4.3, ("phantom2", 3): 3.4, ("phantom2", 2): 0.9, ("phantom2", 1): 0.4}
MISS = {  # method -> error of the tip as a share of the deflection, plus a shift in mm
    "fitted": (0.04, 0.12),
    "hand_tuned": (0.25, 0.2),
    "straight": (1.0, 0.05),
    "constant_curvature": (0.2, 0.1),
    "linear_curvature": (0.1, 0.1),
}
STEREO = ("fitted", "straight", "constant_curvature", "linear_curvature")
FRACTIONS = np.linspace(0, 1, 101)


def curves(insertion, method, boundaries):
    depth, bend, sway = insertion["depth_mm"], insertion["deflection_mm"], insertion["sway"]
    share, shift = MISS[method]
    share *= 1.6 if boundaries == "planned" else 1.0
    y = bend * FRACTIONS**2.2
    miss = sway * share * abs(bend) * FRACTIONS**2 + shift * np.sin(3 * FRACTIONS + sway)
    miss = miss + 0.25 * sway * np.cos(9 * FRACTIONS + sway)
    miss = miss + insertion["foreign"] * FRACTIONS**1.8 * (method != "straight")
    x = depth * FRACTIONS
    columns = {"j": np.arange(101), "measured_x_mm": x, "measured_y_mm": y}
    columns |= {"simulated_x_mm": x - 0.02 * FRACTIONS, "simulated_y_mm": y + miss}
    return pd.DataFrame(columns | {"measured_z_mm": 0.1 * FRACTIONS, "simulated_z_mm": 0.0})


def scores(points, converged):
    gap = np.hypot(*(points[f"simulated_{a}_mm"] - points[f"measured_{a}_mm"] for a in "xy")).to_numpy()
    bend = points["measured_y_mm"].iloc[-1] - points["measured_y_mm"].iloc[0]
    if not converged:
        gap = np.full(101, np.nan)
    predicted = points["simulated_y_mm"].iloc[-1] if converged else np.nan
    found = {"median_err_mm": np.median(gap), "te_mm": gap[-1], "edp_percent": 100 * gap[-1] / abs(bend)}
    found |= {f"ipe_{name}_mm": getattr(gap, name)() for name in ("mean", "std", "max")}
    found |= {"deflection_mm": bend, "predicted_deflection_mm": predicted, "floor_median_err_mm": 0.2}
    found |= {"floor_ipe_mean_mm": 0.21, "floor_ipe_max_mm": 0.36, "floor_te_mm": 0.22}
    return found | {"edp_flagged": abs(bend) < 0.22, "converged": converged}


def group(rng, role, medium, layers, count, foreign=0.0):
    rows = paper.read_published_table("insertions").query("medium == @medium and layers == @layers").iloc[0]
    depths = np.linspace(rows["depth_min_mm"], rows["depth_max_mm"], count)
    typical = DEFLECTION.get((medium, layers), 0.46 if medium == "chicken" else 1.1)
    return [
        {
            "role": role,
            "insertion": f"{medium}-{layers}-{i + 1:02d}{role[0]}",
            "medium": medium,
            "specimen": f"{medium}-{i // 3 + 1}",
            "layers": layers,
            "depth_mm": float(depths[i]),
            "deflection_mm": float(
                typical * (0.04 if medium == "chicken" and i == 0 else rng.uniform(0.7, 1.3))
            ),
            "sway": float(rng.choice([-1, 1]) * rng.uniform(0.5, 1.5)),
            "foreign": foreign,
        }
        for i in range(count)
    ]


def score_all(insertions, fold, methods, comparison):
    errors, shapes = [], []
    for one in insertions:
        for method in methods:
            for boundaries in ("measured", "planned") if method == "fitted" else ("measured",):
                points = curves(one, method, boundaries)
                key = {"fold": fold, "role": one["role"], "insertion": one["insertion"], "method": method}
                key["boundaries"] = boundaries
                ok = one.get("converged", True) or method != "fitted"
                about = {k: one[k] for k in ("medium", "specimen", "layers", "depth_mm")}
                about["hole"] = one["insertion"]
                about |= {"comparison": comparison, "compared": "plane"}
                errors.append(key | about | scores(points, ok))
                if ok:
                    shapes.append(points.assign(**key))
    return errors, shapes


#: of each kind of parameter: bounds and standard deviation, and what the error-minimising fit leaves
KINDS = {
    "mu": {"bound_low": 1e3, "bound_high": 1e8, "sd": 0.72, "low": 8e3, "high": 8e6},
    "alpha": {"bound_low": -3.0, "bound_high": 5.0, "sd": 40.0, "low": -2.4, "high": 4.6},
    "bevel": {"bound_low": 0.005, "bound_high": 0.5, "sd": 0.09, "low": 0.079, "high": 0.092},
}


def parameters(layers, fold, undetermined, methods):
    """Return rows of the fit, whose exponent is fixed in one layer, and of the paper's set."""
    names = [n for i in range(1, layers + 1) for n in (f"mu{i}_pa", f"alpha{i}")]
    values = dict.fromkeys(names, 1.0) | {"bevel_mm": 0.0847}
    values |= {f"mu{i}_pa": (2.13e5 if i % 2 else 3.1e7) * (1 + 0.05 * fold) for i in range(1, layers + 1)}
    rows = []
    for method in methods:
        for name, value in values.items():
            kind = next(one for one in KINDS if name.startswith(one))
            row = {"fold": fold, "method": method, "parameter": name, "value": value, "status": "published"}
            row |= {"draw_source": "", "determined": "", "condition": "", "note": ""}
            if method == "fitted" and kind == "alpha" and layers == 1:
                row |= {"status": "fixed", "note": "fixed"}
            elif method == "fitted":
                known = kind == "bevel" or (kind == "mu" and not undetermined)
                row |= {"status": "free", **KINDS[kind], "median": value, "draw_source": "importance"}
                row |= {"interval_low": value / 1.2, "interval_high": value * 1.2}
                row |= {"determined": "yes" if known else "no", "note": "" if known else "not shown"}
                if name in ("mu3_pa", "mu4_pa", "alpha3", "alpha4"):
                    row |= {"status": "tied"} | dict.fromkeys(("bound_low", "bound_high", "sd"), np.nan)
            rows.append(row)
    return rows


def starts(layers, fold):
    """Return eight starts of a fit; the first of them failed."""
    values = {name: 1.0 for n in range(1, layers + 1) for name in (f"mu{n}_pa", f"alpha{n}")}
    row = {"fold": fold, "fit": "fitted", "minimized": "metric", "evaluations": 600, "gradients": 0}
    ended = {"objective": 0.25, "excess": 0.0, "within_tolerance": True, "failed_solves": 0}
    failed = {"objective": np.inf, "excess": np.inf, "within_tolerance": False, "failed_solves": 600}
    row |= {"stopped": "tolerance", "joined": None, **values, "bevel_mm": 0.085}
    return [row | {"start": n} | (ended if n else failed) for n in range(8)]


def frames(errors, shapes, params, begun):
    words = ["mu1_pa and bevel_mm only as mu1_pa * bevel_mm^1.9", "bevel_mm with mu2_pa", "mu1_pa / mu2_pa"]
    sds = [0.008, 0.17, 0.91]
    empty = {name: pd.DataFrame(columns=list(columns)) for name, columns in FRAMES.items()}
    return empty | {
        "errors": pd.DataFrame([FAILED | row for row in errors]),
        "shapes": pd.concat(shapes, ignore_index=True),
        "starts": pd.DataFrame(begun, columns=begun[0].keys()),
        "parameters": pd.DataFrame(params).reindex(columns=list(FRAMES["parameters"])),
        "directions": pd.DataFrame({"fold": 1, "parameters": 2, "sd": sds, "sd_ratio": 0.1, "note": words}),
    }


@cache
def study(number, origin="synthetic"):
    """One of the five studies; study 3 holds an insertion that did not converge, 5 a flagged EDP."""
    rng = default_rng(number)
    design = paper.read_published_table("study_design").query("study == @number")
    first = design.iloc[0]
    foreign = {3: 2.8, 4: 2.2}.get(number, 0.0)
    count = int(first["tune_insertions"])
    insertions = group(rng, "tune", first["tune_medium"], int(first["tune_layers"]), count)
    for _, row in design.iterrows():
        n = int(row["validate_insertions"])
        insertions += group(rng, "validate", row["validate_medium"], int(row["validate_layers"]), n, foreign)
    if number == 3:
        insertions[-1]["converged"] = False
    errors, shapes = score_all(insertions, 1, tuple(MISS), "world")
    layers = 1 if number == 5 else 4
    methods = ("fitted", "hand_tuned")
    question = "Does a model tuned on some insertions predict the others?"
    about = {"schema": 1, "title": f"Study {number}: a made-up run", "question": question, "dataset": "twin"}
    about |= {"medium": first["tune_medium"], "paper_study": number, "paper_parameters": f"study{number}"}
    record = StudyRecord.model_validate({**about, "validate": [{"medium": first["validate_medium"]}]})
    fitted = parameters(layers, 1, number != 1, methods)
    begun = starts(layers, 1)
    made = Run(
        kind="cross_validation",
        name=f"study{number}",
        record=record,
        origin=origin,
        dataset_title="A made-up twin of the paper's insertions",
        frames=frames(errors, shapes, fitted, begun),
        metadata=metadata(f"study{number}", record),
        timing={"seconds": 12.5, "out": "somewhere"},
        interrupted=number == 2,
    )
    unconverged = [fault for one in made.posteriors.values() for fault in one.faults]
    return replace(made, faults=find_faults(made.frames["errors"], {}, unconverged))


def metadata(name, record):
    """What such a run knows of its data, and nothing of its folds."""
    return FitMetadata(
        name=name,
        versions={"needlefit": "0.1.0"},
        study=record.model_dump(mode="json", by_alias=True),
        dataset=DatasetMetadata(
            name="twin",
            origin="synthetic",
            sha256="ab" * 32,
            notes=[],
            measurement={},
            boundary_shared_sd_mm=[],
            rigidity={},
        ),
        medium=load(find_file("medium", "phantom2"), MediumRecord),
        recipe=load(find_file("recipe", "default"), RecipeRecord),
        hand_tuned=None,
        rules={},
        compared="plane",
        layers={},
        insertions={},
        new_bevel_sd={},
        search_faults={},
        validity=tabulate_validity([], []),
    )


@cache
def stereo():
    """Leave one out over aligned, measured shapes: three folds, no paper row, no hand-tuned set."""
    alike = {"medium": "gel", "layers": 1, "depth_mm": 110.0, "sway": 0.01, "foreign": 0.0}
    shapes_of = [
        alike | {"insertion": f"insertion{i}_120", "specimen": f"insertion{i}", "deflection_mm": 9.0 + i}
        for i in range(1, 4)
    ]
    errors, shapes, params, begun = [], [], [], []
    for fold, held in enumerate(shapes_of, start=1):
        both = [one | {"role": "validate" if one is held else "tune"} for one in shapes_of]
        e, s = score_all(both, fold, STEREO, "aligned")
        errors, shapes = errors + e, shapes + s
        params += parameters(1, fold, fold != 2, ("fitted",))
        begun += starts(1, fold)
    about = {"title": "Leave one insertion out", "question": "Does the model predict a further shape?"}
    about |= {"dataset": "stereo", "medium": "gel", "leave_out": "insertion"}
    record = StudyRecord.model_validate({"schema": 1, **about})
    return Run(
        kind="cross_validation",
        name="stereo_insertions",
        record=record,
        origin="measured",
        dataset_title="Made-up stereo shapes",
        frames=frames(errors, shapes, params, begun),
        metadata=metadata("stereo_insertions", record),
        timing={},
        interrupted=False,
    )


def with_predictions(results, levels=(0.1, 0.4, 0.7, 0.97)):
    """Run with predictions of their held-out needles: levels in turn, bands about the measured shape."""
    rows, bands = [], []
    held = results.frames["errors"].query(
        "role == 'validate' and method == 'fitted' and boundaries == 'measured'"
    )
    for n, (_, one) in enumerate(held.iterrows()):
        level = levels[n % len(levels)]
        row = {name: one[name] for name in ("fold", "insertion", "specimen", "medium", "layers", "depth_mm")}
        row |= {"draw_source": "importance", "certified": True, "hole": one["hole"]}
        tip, half = float(one["deflection_mm"]), 0.3
        row |= {"tip_measured_mm": tip, "tip_median_mm": tip, "tip_crps_mm": 0.1, "shape_crps_mm": 0.1}
        row |= {"specimen_treatment": "same", "tip_95_width_error_mm": 0.02}
        for what in ("tip", "shape", "points"):
            row |= {f"{what}_pit": level, f"{what}_in_50": 0.25 <= level <= 0.75}
            row |= {f"{what}_in_95": 0.025 <= level <= 0.975}
        for size in (50, 95):
            row |= {f"tip_{size}_low_mm": tip - half, f"tip_{size}_high_mm": tip + half}
        rows.append(row)
        along = results.frames["shapes"].query(
            "insertion == @one.insertion and method == 'fitted' and j % 5 == 0"
        )
        along = along[along["boundaries"] == "measured"]
        y = along["measured_y_mm"]
        band = {"fold": one["fold"], "insertion": one["insertion"], "x_mm": along["measured_x_mm"]}
        band |= {"measured_mm": y, "median_mm": y, "low_50_mm": y - 0.1, "high_50_mm": y + 0.1}
        bands.append(pd.DataFrame(band | {"low_95_mm": y - half, "high_95_mm": y + half}))
    predictive = pd.DataFrame(rows).reindex(columns=list(FRAMES["predictive"]))
    return with_frames(results, predictive=predictive, bands=pd.concat(bands, ignore_index=True))


def sampled(low, high, r_hat=1.0):
    """Study 5 with b drawn evenly between two bounds; the fit ended at 0.0847 mm."""
    draws = np.tile(np.linspace(low, high, 400), 4).reshape(4, 400, 1)
    acceptance, nothing = np.array([0.3, 0.4, 0.3, 0.4]), np.zeros((4, 400))
    diagnostics = np.array([r_hat, 1.0]), np.ones(2)
    posterior = Posterior(("bevel_mm",), draws, nothing, acceptance, *diagnostics, 400, 10, 0)
    one = study(5)
    fold = str(one.frames["parameters"]["fold"].iloc[0])
    return replace(one, posteriors={fold: posterior})


def skip_figures(monkeypatch):
    """Draw no figures of studies and fits: they take longest, and other tests look at them."""
    monkeypatch.setattr(report, "REPORT", replace(report.REPORT, figures=lambda _: {}))


def print_nothing(monkeypatch):
    """Draw no figures, and leave reports empty."""
    for name in ("compile_pdf", "compile_html"):
        monkeypatch.setattr(document, name, lambda _: b"a page")
    skip_figures(monkeypatch)
    draw_blank(monkeypatch)
