"""The messages between a trial and its page, as JSON."""

import json
import math
from dataclasses import dataclass, field
from typing import Any

from needlefit.errors import ModelError
from needlefit.schemas.limits import MAX_NUMBER
from needlefit.viewer.encoding import encode_scene, encode_state
from needlefit.viewer.interaction.inputs import Change
from needlefit.viewer.serving.trials import InteractiveTrial


def scene_message(trial: InteractiveTrial) -> dict[str, Any]:
    """Return the message of all that stays constant."""
    return encode_scene(trial.viewed_scene, trial.steering) | {
        "needle": trial.name,
        "recording": trial.recorder.path.name,
        "recorded": len(trial.source.steps) if trial.source else 0,
    }


def state_message(trial: InteractiveTrial) -> dict[str, Any]:
    """Return the message of all that changes from step to step."""
    steering = trial.steering
    return encode_state(trial.viewed_scene, steering) | {
        "time_s": trial.time() if steering.number else 0.0,
        "undo": trial.can_undo,
        "redo": trial.can_redo,
        "solver": {"steps": steering.solved, "rate_per_s": trial.speed, "failed": steering.failed},
    }


ACTIONS = frozenset(
    (
        *("hello", "change", "move", "halt", "frame", "undo", "redo", "reset", "play", "replay", "show"),
        *("aim", "markups", "plan", "run", "challenge", "fit", "points", "align"),
        *("release_tracker", "forget_estimate"),
    )
)

MAX_CHANGES = 64
"""Number of inputs that one message may set."""

MAX_SPEED_MM_S = 1000.0
"""mm/s."""

MAX_REPLAY_SPEED = 1000.0
"""Greatest speed of a replay, as a multiple of the recorded speed."""


@dataclass(frozen=True)
class Message:
    """One message from the page.

    Attributes
    ----------
    do : str
        One of `ACTIONS`.
    id : int
        The page's own number of it; answers name it.
    content : dict
        All other keys of the message.
    fault : ModelError or None
        Why it cannot be carried out.
    """

    do: str
    id: int = 0
    changes: tuple[Change, ...] = ()
    content: dict[str, Any] = field(default_factory=dict)
    fault: ModelError | None = None

    def number(self, key: str, default: float | None = None, most: float = math.inf, unit: str = "") -> float:
        """Return a finite number of the message; without a default it is required."""
        value = self.content.get(key, default)
        found = _finite(value)
        if found is None or abs(found) > most:
            upto = f", at most {most:g} {unit}".rstrip() if math.isfinite(most) else ""
            raise ModelError(f"{key} is {value!r:.40} {unit}".rstrip(), expected=f"a finite number{upto}")
        return found

    def text(self, key: str) -> str:
        """Return a text of the message; empty if there is none."""
        value = self.content.get(key)
        return value if isinstance(value, str) else ""

    @property
    def gesture(self) -> int | None:
        """The gesture to which the message belongs, if any."""
        value = self.content.get("gesture")
        return value if isinstance(value, int) and not isinstance(value, bool) else None


def parse_json(text: str | bytes) -> Any:  # noqa: ANN401 - JSON
    """Return the value in a JSON text.

    Raises
    ------
    ValueError
        If it is none, nests too deeply, or has half of a pair of surrogates, which no text can be made of.
    """
    try:
        content = json.loads(text)
        json.dumps(content, ensure_ascii=False).encode()
    except RecursionError:
        raise ValueError("nested too deeply") from None
    return content


def read_message(text: str) -> Message:
    """Return the message that a text contains.

    It has a fault if it is no JSON, or asks for an unknown action, an input that does not exist, or one that
    is not finite; the reply names its number where it can be read.
    """
    try:
        content = parse_json(text)
    except ValueError:
        content = None
    if not isinstance(content, dict):
        return Message(
            "", fault=ModelError("the message is no JSON", expected="an object with `do` and `id`")
        )
    identity = content.get("id")
    number = identity if type(identity) is int else 0
    try:
        if (
            not isinstance(content.get("do"), str)
            or content["do"] not in ACTIONS
            or type(identity) is not int
        ):
            raise ModelError(
                "the message names no action", expected=f"`id`, and `do`: {', '.join(sorted(ACTIONS))}"
            )
        return Message(content["do"], number, _changes(content.get("set", [])), content)
    except ModelError as error:
        return Message("", number, fault=error)


def _changes(rows: object) -> tuple[Change, ...]:
    if not isinstance(rows, list) or len(rows) > MAX_CHANGES:
        raise ModelError("`set` holds no inputs", expected=f"up to {MAX_CHANGES} of [input, item, value]")
    return tuple(_change(row) for row in rows)


def _change(row: object) -> Change:
    if not (isinstance(row, list) and len(row) == 3):
        raise ModelError(f"{row!r:.60} is no input", expected="[input, item, value]")
    name, item, value = row
    number = _finite(value)
    if number is None:
        raise ModelError(f"{name!r:.40} is {value!r:.40}", expected="a finite number")
    if not isinstance(name, str) or not (item is None or type(item) is int):
        raise ModelError(f"{row!r:.60} is no input", expected="[input, item, value]")
    return Change(name[:40], item, number)


def _finite(value: object) -> float | None:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    return number if abs(number) <= MAX_NUMBER else None
