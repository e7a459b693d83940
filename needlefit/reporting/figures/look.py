"""Colours and line styles of a needle, used in figures of scenes and on the page of `needlefit view`."""

from typing import Any

from matplotlib.colors import to_rgba

COLOURS = {
    "ink": "#1a1a1a",
    "needle": "#0072b2",
    "points": "#b84f00",
    "path": "#0a2f4a",
    "tip": "#c8102e",
    "guide": "#007a58",
    "load": "#a2457b",
    "measured": "#1a1a1a",
    "band": "#0072b2",
    "halo": "#ffffffd8",
}
"""Colours of the page in its light theme, by the names in its style sheet."""

TIP = COLOURS["tip"]

NEEDLE: dict[str, Any] = {"color": COLOURS["needle"], "lw": 1.4}
PATH: dict[str, Any] = {"color": COLOURS["path"], "lw": 0.9}
HALO: dict[str, Any] = {"color": COLOURS["halo"], "lw": 2.6}
MEASURED: dict[str, Any] = {
    "color": COLOURS["measured"],
    "lw": 1.3,
    "ls": (0, (3.5, 2.0)),
    "dash_capstyle": "round",
}
LOAD: dict[str, Any] = {"fc": to_rgba(COLOURS["load"], 0.32), "ec": COLOURS["load"], "lw": 0.5}
BAND: dict[str, Any] = {"color": COLOURS["band"], "alpha": 0.35, "lw": 0}

POINTS: dict[str, Any] = {"color": COLOURS["points"], "marker": "x", "ms": 2.8, "mew": 0.6, "lw": 0}
BASE: dict[str, Any] = {"color": COLOURS["ink"], "marker": "o", "ms": 5.0, "lw": 0}
GUIDE: dict[str, Any] = {
    "color": COLOURS["guide"],
    "marker": "o",
    "ms": 5.0,
    "mec": "white",
    "mew": 0.5,
    "lw": 0,
}
TIP_MARK: dict[str, Any] = {"color": TIP, "marker": "o", "ms": 4.0, "mec": "white", "mew": 0.4, "lw": 0}
