"""Pages that compute needles: one HTML file with the kernel in WebAssembly, its data and its script.

The file opens from disk and asks for nothing. esbuild makes its script of modules, those of `needlefit view`
among them; the content security policy names it by its SHA-256, and a worker runs the same text from a blob.
"""

import base64
import hashlib
import html
import json
import math
import re
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from importlib.resources import files
from typing import TYPE_CHECKING, Any

import numpy as np

from needlefit.arrays import Floats, Ints
from needlefit.errors import ConfigError
from needlefit.geometry.curves import TIP_POINTS
from needlefit.mechanics import native
from needlefit.mechanics.control import Bevel, ModelOptions, Step
from needlefit.mechanics.inputs import describe_input_rules
from needlefit.mechanics.laws import LAWS, PowerLaw
from needlefit.mechanics.needle import DEFAULT_DIAMETER_MM
from needlefit.mechanics.packing import compile_law, count_planes, pack_layers
from needlefit.mechanics.scene import Scene
from needlefit.mechanics.tissue import Tissue
from needlefit.metrics import list_metrics
from needlefit.project.help_pages import read_terms
from needlefit.project.input_files import to_json_values

if TYPE_CHECKING:
    from needlefit.inference.forward_model import ParameterDraws

SCRIPT = "reporting/needle_page.js"  #: file of the page's modules, made by `npm run build`
PAGE = "viewer/page/page.html"
STAGE = "viewer/page/stage.html"
STYLES = ("viewer/page/style.css", "viewer/page/controls.css")
FILE_STYLE = "viewer/page/file.css"


def read_package_file(name: str) -> str:
    return (files("needlefit") / name).read_text("utf-8")


def write_policy(scripts: Iterable[str]) -> str:
    """Return the content security policy of a page with these inline scripts."""
    digests = [base64.b64encode(hashlib.sha256(script.encode()).digest()).decode() for script in scripts]
    allowed = " ".join(f"'sha256-{digest}'" for digest in digests)
    return (
        f"default-src 'none'; script-src {allowed} 'wasm-unsafe-eval'; worker-src blob:; "
        "style-src 'unsafe-inline'; img-src data:; base-uri 'none'; form-action 'none'"
    )


def read_style() -> str:
    """Return the style of the part that computes, for a page with a style of its own: within `#explorer`.

    The colours, the first rule of the page's style, are those of the whole page.
    """
    colours, _, rest = "".join(map(read_package_file, STYLES)).partition("\n}\n")
    return f"{colours}\n}}\n#explorer {{{rest}}}\n{read_package_file(FILE_STYLE)}"


def compose_file(title: str, note: str, data: "PageData") -> str:
    """Return the text of an HTML file that is one page of needles; `title` and `note` may be any text."""
    script = read_package_file(SCRIPT)
    style = "".join(map(read_package_file, (*STYLES, FILE_STYLE)))
    parts = {
        "title": html.escape(title), "note": html.escape(note), "policy": write_policy([script]),
        "style": style, "stage": read_package_file(STAGE), "kernel": read_kernel(), "data": data.pack(),
        "script": script,
    }  # fmt: skip
    return re.sub(r"\{\{(\w+)\}\}", lambda match: parts[match[1]], read_package_file(PAGE))


# ---- the data


def kernel_exists() -> bool:
    """Return whether this installation has the kernel in WebAssembly: some compilers cannot build it."""
    return (native.FOLDER / "kernel.wasm").is_file()


@lru_cache(maxsize=1)
def read_kernel() -> str:
    """Return the kernel in WebAssembly, compressed, as base64; ConfigError if there is none."""
    if not kernel_exists():
        raise ConfigError(
            "this installation has no kernel in WebAssembly",
            expected="a file kernel.wasm",
            fix="pip install ziglang, then needlefit again",
        )
    return compress((native.FOLDER / "kernel.wasm").read_bytes())


def compress(content: bytes) -> str:
    """Return bytes as base64 of a raw deflate stream."""
    packed = zlib.compressobj(6, zlib.DEFLATED, -15)
    return base64.b64encode(packed.compress(content) + packed.flush()).decode("ascii")


@dataclass
class PageData:
    """The data of a page, as JSON values; a long list that several needles have is stored once."""

    values: dict[str, Any]
    needles: list[dict[str, Any]] = field(default_factory=list)
    _lists: dict[str, int] = field(default_factory=dict)

    def share(self, numbers: Floats) -> dict[str, int]:
        """Store numbers as one list, and return what stands for it."""
        return {"$": self._lists.setdefault(json.dumps(numbers.ravel().tolist()), len(self._lists))}

    def pack(self) -> str:
        lists = [json.loads(text) for text in self._lists]
        content = to_json_values({"lists": lists, **self.values, "needles": self.needles})
        return compress(json.dumps(content, separators=(",", ":"), allow_nan=False).encode())


#: errors that the page shows and computes itself
SHOWN_METRICS = ("ipe_mean_mm", "te_mm", "edp_percent")


def encode_metrics(count: int) -> list[list[str]]:
    """Return name, label, unit and explanation of the errors that the page shows of so many points."""
    shown = [metric for metric in list_metrics() if metric.name in SHOWN_METRICS]
    return [
        [metric.name, metric.label, metric.unit, metric.explanation]
        for metric in shown
        if count > TIP_POINTS or not metric.of_curve
    ]


def find_measured(count: int) -> slice:
    """Return which of the points of an insertion are drawn as measured: of a tip it alone."""
    return slice(1 if count == TIP_POINTS else 0, None)


def encode_measured(
    name: str, points: Floats, s: Floats, depth: float, floor: float | None, target: Mapping[str, Any]
) -> dict[str, Any]:
    """Return a measured needle as the page draws and compares it.

    `points` (N, 3), mm, lie at beam coordinates `s` (N,) of a needle of the `depth`; `target` has what a
    study compares: `compared`, `pose`, `s` (K,) and `points` (K, 2 or 3).
    """
    drawn = find_measured(len(points))
    return {
        "id": name,
        "depth_mm": depth,
        "metrics": encode_metrics(len(points)),
        "compared": target["compared"],
        **_name_axes(points[drawn]),
        "s": s[drawn].tolist(),
        "floor_mm": floor,
        "target": {"pose": target["pose"], "s": target["s"].tolist(), **_name_axes(target["points"])},
    }


def _name_axes(points: Floats) -> dict[str, list[float]]:
    return dict(zip("xyz", points.T.tolist(), strict=False))


def encode_layers(tissue: Tissue) -> dict[str, Any]:
    """Return moduli, Pa, and shape parameters of all layers."""
    names = ["mu_pa", *LAWS[tissue.law].shape_names]
    rows = np.vstack((tissue.mu * 1e6, tissue.shape))
    return {"layers": [dict(zip(names, layer, strict=True)) for layer in rows.T.tolist()]}


def encode_strength(bevel: Bevel, rules: ModelOptions) -> dict[str, float]:
    """Return how strongly a bevel turns the cut, under the key of the rule of advance."""
    if rules.path_angle:
        return {"cut_angle_deg": math.degrees(bevel.cut_angle)}
    return {"offset_mm": bevel.offset}


def choose_evenly(count: int, most: int) -> Ints:
    """Return the numbers of at most `most` of `count` draws, evenly chosen."""
    return np.linspace(0, count - 1, min(most, count)).astype(np.intp)


#: largest number of needles of a band, evenly chosen from all draws: it is computed again whenever the needle
#: moves
MAX_BAND_DRAWS = 100


def encode_draws(draws: "ParameterDraws", law: str, data: PageData | None = None) -> dict[str, Any]:
    """Return the draws of a band: mu and law of every layer, strength of the bevel, gain of the base.

    Lists that needles of `data` may share are stored there.
    """
    store = data.share if data is not None else lambda numbers: numbers.ravel().tolist()
    drawn = draws.only(choose_evenly(len(draws), MAX_BAND_DRAWS))
    return {
        "sets": len(drawn),
        "mu": store(drawn.mu),
        "law": store(encode_law(law, drawn.shape)),
        "strength": store(drawn.bevel),
        "gain": None if drawn.gain is None else drawn.gain.tolist(),
    }


def encode_law(law: str, shape: Floats) -> Floats:
    """Return the law of all layers at shape parameters (..., p, n) as the kernel has it, or a ModelError."""
    return np.concatenate(compile_law(law, shape), axis=-1)


def encode_step(step: Step) -> dict[str, Any]:
    """Return a step of an insertion, as `Session` of `native/needle.js` takes it."""
    bevel, held, tip = step.bevel, step.controls, step.controls.tip
    strength = bevel.offset or bevel.cut_angle  # the other one is 0
    return {
        "depth": step.depth,
        "inputs": {
            "bevel": {"side": bevel.side, "roll": bevel.roll_deg, "strength": strength},
            "base": {"y": held.base_y, "slope": held.base_slope, "stageSlope": held.stage_slope},
            "guides": [
                {"x": guide.x, "y": guide.y, "slope": guide.slope, "name": guide.name}
                for guide in held.guides
            ],
            "tip": tip and {"y": tip.y, "slope": tip.slope, "z": 0.0},
        },
    }


def encode_terms(tissue: Tissue) -> dict[str, Any] | None:
    """Return coefficients and exponents of a law where its shape parameters are 0, and their derivatives.

    None of a law that the page cannot compute to the same bits: one that is no sum of powers, or has a
    coefficient or exponent of several parameters.
    """
    law = LAWS[tissue.law]
    if not isinstance(law, PowerLaw):
        return None
    zero, slopes = (np.concatenate(parts, axis=-1) for parts in (law.terms_at_zero, law.term_slopes))
    if (np.count_nonzero(slopes, axis=0) > 1).any():
        return None
    return {"at_zero": zero.tolist(), "slopes": slopes.tolist(), "layers": tissue.layers}


def encode_model(scene: Scene, first_cell: float, changes: Sequence[Any]) -> dict[str, Any]:
    """Return what a page needs to simulate a scene; `model` is that of `native/needle.js`.

    Where `terms` are None the page knows the laws that are in `tables` alone, pairs of shape parameters and
    law.
    """
    tissue, rules = scene.tissue, scene.rules
    sizes, layers = pack_layers(tissue, 1, {})
    return {
        "model": {
            "spatial": count_planes(scene.tip_steps) == 2, "length": scene.needle.length,
            "rigidity": scene.needle.flexural_rigidity,
            "boundaries": tissue.boundaries.tolist(), "terms": sizes["terms"],
            **{name: layers[name].ravel().tolist() for name in ("mu", "thickness", "friction", "law")},
            "spacing": rules.spacing, "element": rules.element, "firstCell": first_cell,
            "pathAngle": rules.path_angle, "switch": rules.switch, "tangent": rules.tangent,
            "tolerance": rules.tolerance, "maxIterations": rules.max_iterations,
            "shape": tissue.shape.tolist(),
        },
        "law": {"terms": encode_terms(tissue), "tables": []},
        "steps": [encode_step(step) for step in scene.steps],
        "changes": changes,
        "rules": describe_input_rules(tissue.law),
    }  # fmt: skip


#: factor by which the sliders of all moduli reach beyond the softest and the stiffest layer
SLIDER_FACTOR = 100.0


def encode_limits(scene: Scene) -> dict[str, Any]:
    """Return how far a page's sliders go; its number fields take what the model takes."""
    mu, bevel = scene.tissue.mu * 1e6, scene.steps[0].bevel
    limits: dict[str, Any] = {"mu_pa": [float(mu.min()) / SLIDER_FACTOR, float(mu.max()) * SLIDER_FACTOR]}
    for parameter, values in zip(LAWS[scene.tissue.law].parameters, scene.tissue.shape.tolist(), strict=True):
        (low, high), (least, most) = parameter.tested, parameter.bounds
        reach = 0.25 * (high - low)
        limits[parameter.name] = [
            max(least, min(low, min(values) - reach)),
            min(most, max(high, max(values) + reach)),
        ]
    if scene.rules.path_angle:
        limits["cut_angle_deg"] = [0.0, min(max(10.0, 3 * math.degrees(bevel.cut_angle)), 44.0)]
    else:
        limits["offset_mm"] = [0.0, max(0.3, 3 * bevel.offset)]
    return limits | {"depth_mm": scene.needle.length}


#: symbols of the model's parameters that the page explains by the glossary; a law explains its own
DEFINED = ("b", "θ", "μ")


def encode_scene(
    scene: Scene,
    first_cell: float,
    names: Sequence[str],
    changes: Sequence[Any],
    title: str,
    origin_mark: str,
) -> dict[str, Any]:
    """Return what a page draws of a scene, and what it needs to simulate it.

    `names` are those of guides, `changes` those of each step, as a steered needle takes them.
    """
    tissue = scene.tissue
    return {
        "title": title,
        "origin_mark": origin_mark,
        "measured": None,
        "draws": None,
        "diameter_mm": scene.needle.outer_diameter or DEFAULT_DIAMETER_MM,
        "length_mm": scene.needle.length,
        "depth_mm": scene.depth,
        "layer_names": list(scene.layer_names),
        "guide_names": list(names),
        "boundaries_mm": tissue.boundaries.tolist(),
        "spacing_mm": scene.rules.spacing,
        "shape_parameters": [
            {key: getattr(parameter, key) for key in ("name", "symbol", "unit", "explanation")}
            for parameter in LAWS[tissue.law].parameters
        ],
        "definitions": {
            term.symbol: f"{term.key.capitalize()}: {term.paragraphs[0]}"
            for term in read_terms()
            if term.symbol in DEFINED
        },
        "fitted": encode_layers(tissue) | encode_strength(scene.steps[0].bevel, scene.rules),
        "limits": encode_limits(scene),
        "simulation": encode_model(scene, first_cell, changes),
    }
