"""Topics of a machine below its root, and the form of their messages."""

from __future__ import annotations

from typing import Any

from .messages import (
    ActiveAlarms,
    AlarmRecord,
    Birth,
    Cancel,
    CapturedPositions,
    CommandReply,
    HandlerPresence,
    HandlerResult,
    HandshakeResult,
    Heartbeat,
    IoState,
    Lock,
    OptionalSkip,
    Overrides,
    Pending,
    Position,
    Presence,
    PublishedVariables,
    RunState,
    State,
    Tool,
    ToolTable,
    Validate,
    WorkOffsetValues,
)

_FORMS: dict[str, Any] = {
    "presence": Presence,
    "birth": Birth,
    "heartbeat": Heartbeat,
    "alarm/active": ActiveAlarms,
    "alarm/event": AlarmRecord,
    "handler/+/presence": HandlerPresence,
    "handler/+/result": HandlerResult,
    "io/+/+": IoState,
    "variables": PublishedVariables,
    "tools": ToolTable,
    "cs/+/variables": PublishedVariables,
    "cs/+/work_offsets": WorkOffsetValues,
    "cs/+/state": State,
    "cs/+/run": RunState,
    "cs/+/captured": CapturedPositions,
    "cs/+/position": Position,
    "cs/+/tool/state": Tool,
    "cs/+/override/state": Overrides,
    "cs/+/input/interlock/state": Lock,
    "cs/+/input/start_lock/state": Lock,
    "cs/+/input/optional_skip/state": OptionalSkip,
    "cs/+/m_code/pending": Pending,
    "cs/+/m_code/+/result": HandshakeResult,
    "cs/+/m_code/+/cancel": Cancel,
    "cs/+/m_code/+/validate": Validate,
}

FILTERS: tuple[str, ...] = tuple(path for path in _FORMS if not path.startswith("handler/"))
"""Topics to which each client subscribes, in addition to its ``reply`` and the topics of its handler."""

_LEVELS = {tuple(path.split("/")): form for path, form in _FORMS.items()}


def form_of(path: str) -> Any | None:
    """Return the dataclass of a topic's messages; ``None`` for a topic that this package does not use."""
    levels = path.split("/")
    if levels[0] == "reply" and len(levels) == 2:
        return CommandReply
    for at in ("cs", "handler"):
        if levels[0] == at and len(levels) > 1:
            levels[1] = "+"
    if levels[0] == "io" and len(levels) == 3:
        levels[1:] = ["+", "+"]
    if len(levels) == 5 and levels[2] == "m_code":
        levels[3] = "+"
    return _LEVELS.get(tuple(levels))


def number_at(path: str, level: int) -> int:
    """Return the number in a level of a path; -1 if there is none."""
    levels = path.split("/")
    text = levels[level] if level < len(levels) else ""
    return int(text) if text.isascii() and text.isdigit() else -1
