"""Topics of a machine below its root, and the form of their messages."""

from __future__ import annotations

from .messages import MESSAGE_OF

FILTERS: tuple[str, ...] = (
    "presence",
    "birth",
    "heartbeat",
    "alarm/active",
    "alarm/event",
    "io/+/+",
    "variables",
    "tools",
    "cs/+/variables",
    "cs/+/work_offsets",
    "cs/+/state",
    "cs/+/run",
    "cs/+/captured",
    "cs/+/position",
    "cs/+/tool/state",
    "cs/+/override/state",
    "cs/+/input/interlock/state",
    "cs/+/input/start_lock/state",
    "cs/+/input/optional_skip/state",
    "cs/+/m_code/pending",
    "cs/+/m_code/+/result",
    "cs/+/m_code/+/cancel",
    "cs/+/m_code/+/validate",
)
"""Topics to which each client subscribes, in addition to its ``reply`` and the topics of its handler."""


def form_of(path: str) -> type | None:
    """Return the dataclass of a topic's messages; ``None`` if clients receive no such topic."""
    levels = path.split("/")
    if len(levels) > 1 and levels[0] in ("cs", "handler", "reply"):
        levels[1] = "+"
    if len(levels) == 3 and levels[0] == "io":
        levels[2] = "+"
    if len(levels) == 5 and levels[2] == "m_code":
        levels[3] = "+"
    return MESSAGE_OF.get("/".join(levels))


def number_at(path: str, level: int) -> int:
    """Return the number in a level of a path; -1 if there is none."""
    levels = path.split("/")
    text = levels[level] if level < len(levels) else ""
    return int(text) if text.isascii() and text.isdigit() else -1
