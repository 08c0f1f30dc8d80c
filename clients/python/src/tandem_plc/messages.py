"""Messages of the machine as frozen dataclasses. Lengths are in mm or degrees, feedrates in mm/min."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass, field
from typing import Any

from .params import Params


class Execution(str, enum.Enum):
    """State word of a coordinate system."""

    READY = "READY"
    ACTIVE = "ACTIVE"
    WAIT = "WAIT"
    FEED_HOLD = "FEED_HOLD"
    PROGRAM_STOPPED = "PROGRAM_STOPPED"
    OPTIONAL_STOP = "OPTIONAL_STOP"
    INTERRUPTED = "INTERRUPTED"
    STOPPED = "STOPPED"
    PROGRAM_COMPLETED = "PROGRAM_COMPLETED"


class OutputState(str, enum.Enum):
    """Stage of a pending output."""

    QUEUED = "QUEUED"
    OUTPUT = "OUTPUT"
    CLAIMED = "CLAIMED"


class Redelivery(str, enum.Enum):
    """How a handler treats an output on which a lost handler may already have worked."""

    ASK = "ask"
    """An operator decides."""
    REDO = "redo"
    """Run the handler again from its start."""
    VERIFY = "verify"
    """Run the handler with ``output.redelivered`` true: the handler inspects the machine first."""


class CancelReason(str, enum.Enum):
    """Reason why an output was cancelled."""

    RESET = "reset"
    STOP = "stop"
    ABORT = "abort"
    ALARM = "alarm"
    TIMEOUT = "timeout"
    OPERATOR = "operator"
    """An operator has reset the output or ended it as failed."""
    SHUTDOWN = "shutdown"
    """The runtime or this program ends, or another boot of the runtime is online."""


@dataclass(frozen=True, kw_only=True)
class Question:
    """A question of a handler to the operator."""

    id: str
    text: str
    choices: tuple[str, ...]
    since: str
    answer: str | None = None


@dataclass(frozen=True, kw_only=True)
class Progress:
    """Progress of a handler."""

    text: str
    percent: float | None = None
    """0 to 100."""


@dataclass(frozen=True, kw_only=True)
class WaitingOn:
    """The output for which a program waits."""

    m: int
    seq: int
    since: str
    progress: Progress | None = None
    question: Question | None = None


@dataclass(frozen=True, kw_only=True)
class State:
    """State of a coordinate system."""

    boot_id: str
    execution: Execution
    transition: str | None
    reason: str | None
    """Such as ``HANDLER_LOST``, ``INTERLOCK`` or ``ALARM``."""
    wait_state: str | None
    waiting_on: WaitingOn | None
    program: int | None
    run_id: str | None
    last_command_id: str | None
    alarm_count: int
    optional_skip: tuple[int, ...]
    optional_stop: bool
    single_block: bool
    dry_run: bool
    rev: int | None = None
    hash: str | None = None
    o_number: int | None = None
    run_kind: str | None = None


@dataclass(frozen=True, kw_only=True)
class PendingOutput:
    """One pending output."""

    id: str
    seq: int
    run_id: str
    m: int
    params: Params
    timing: str
    program: int
    line: int
    attempt: int
    redelivered: bool
    state: OutputState
    handler_id: str | None
    since: str
    instance: str | None = None
    lost: bool = False
    lost_instance: str | None = None
    progress: Progress | None = None
    checkpoint: Any = None
    how: Redelivery | None = None
    redelivery: Redelivery | None = None
    question: Question | None = None


@dataclass(frozen=True, kw_only=True)
class Pending:
    """All pending outputs of a coordinate system."""

    boot_id: str
    outputs: tuple[PendingOutput, ...]


@dataclass(frozen=True, kw_only=True)
class Cancel:
    """An output is cancelled."""

    boot_id: str
    seq: int
    reason: CancelReason


@dataclass(frozen=True, kw_only=True)
class Validate:
    """Asks whether an M code may be issued with these parameters."""

    request_id: str
    program: int
    line: int
    params: Params


@dataclass(frozen=True, kw_only=True)
class HandshakeResult:
    """Result of a claim or reset."""

    boot_id: str
    seq: int
    handler_id: str
    status: str
    text: str | None = None
    of: str | None = None
    """The answered request: ``claim``, ``reset`` and others."""
    instance: str | None = None
    how: Redelivery | None = None
    """For an accepted claim of work that may already have begun."""


@dataclass(frozen=True, kw_only=True)
class HandlerResult:
    """Result of a presence."""

    boot_id: str
    of: str
    status: str
    """``accepted``, ``refused`` (another instance is online), ``taken_over``, or ``confirm`` (requests a presence)."""
    instance: str | None = None
    text: str | None = None


@dataclass(frozen=True, kw_only=True)
class RunEnded:
    """End of a run."""

    at: str
    how: str
    """``completed``, ``stopped``, ``aborted``, ``reset``, ``alarm``, ``lease_lost``, ``replaced``, ``refused`` or
    ``restarted``."""
    text: str


@dataclass(frozen=True, kw_only=True)
class RunWait:
    """The waits of a run for one M code."""

    m: int
    count: int
    total_s: float
    longest_s: float


@dataclass(frozen=True, kw_only=True)
class RunAlarm:
    """An alarm of a run."""

    number: int
    text: str
    line: int | None = None


@dataclass(frozen=True, kw_only=True)
class Run:
    """A run of the loaded program."""

    id: str
    cs: int
    program: int
    parts: int
    """Parts that were ordered."""
    parts_done: int
    began: str
    took_s: float
    """Duration from the start of the run to the end of its last part, s."""
    waits: tuple[RunWait, ...]
    """M codes for which the program waited, the longest wait first."""
    alarms: tuple[RunAlarm, ...]
    hash: str | None = None
    from_line: int | None = None
    end: RunEnded | None = None
    """``None`` while it runs."""
    last_part_s: float | None = None
    waits_for: str | None = None
    """Reason why the next part has not begun yet."""

    @property
    def completed(self) -> bool:
        """True if all parts are completed."""
        return self.end is not None and self.end.how == "completed"


@dataclass(frozen=True, kw_only=True)
class RunState:
    """The current run, otherwise the last run that ended."""

    boot_id: str
    run: Run | None = None


@dataclass(frozen=True, kw_only=True)
class Lease:
    """The control lease."""

    fence: int
    holder: str
    expires_at: str


@dataclass(frozen=True, kw_only=True)
class CommandReply:
    """Progress of a command."""

    command_id: str
    status: str
    """``accepted``, ``done``, ``failed`` or ``rejected``."""
    code: str
    text: str
    state_rev: int
    hash: str | None = None
    variables: dict[str, Any] | None = None
    lease: Lease | None = None
    run_id: str | None = None
    """The run that the command started."""
    moved: dict[str, float] | None = None
    """For a failed ``jog``, ``mdi`` or ``home``: the distance covered by axis letter, mm or degrees."""


@dataclass(frozen=True, kw_only=True)
class Presence:
    """Whether the runtime is online."""

    boot_id: str
    online: bool
    version: str
    started_at: str
    expires_ms: int | None = None
    """Validity of this presence, ms; ``None`` if the presence is not repeated."""


@dataclass(frozen=True, kw_only=True)
class Heartbeat:
    """Published 10 times per second while the servo runs."""

    boot_id: str
    cycle: int


@dataclass(frozen=True, kw_only=True)
class CoordinateSystemInfo:
    """One coordinate system of a machine."""

    number: int
    axes: dict[str, int]
    """Motor number by axis letter."""
    spindle: int | None
    dialect: str
    units: str


@dataclass(frozen=True, kw_only=True)
class IoDeclaration:
    """Declaration of an input or output of the plant in the configuration."""

    kind: str
    """``bool`` or ``number``."""
    on_loss: bool | float | str
    """The value after its owner is lost: a safe value, which also applies at a start, or ``keep``."""
    at_start: bool | float | str | None = None
    """With ``keep``: the value at a start, or ``last``, the last value written before the start."""
    text: str = ""
    """Description for people; empty if the name is sufficient."""
    unit: str | None = None
    min: float | None = None
    max: float | None = None

    def wrong(self, value: bool | float) -> str | None:
        """Return why the input or output cannot have this value; ``None`` if it can."""
        if self.kind == "bool":
            return None if isinstance(value, bool) else f"{value!r}: write True or False"
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
            return f"{value!r}: write a finite number"
        low = -math.inf if self.min is None else self.min
        high = math.inf if self.max is None else self.max
        return None if low <= value <= high else f"{value:g}: write {low:g} to {high:g}"


@dataclass(frozen=True, kw_only=True)
class IoForced:
    """A forced value that replaces the written value."""

    value: bool | float
    by: str


@dataclass(frozen=True, kw_only=True)
class IoState:
    """An input or output of the plant."""

    boot_id: str
    value: bool | float
    """The effective value: the forced value, otherwise the written value."""
    written: bool | float
    """The last written value; before the first write the value at a start, after the loss of the owner ``on_loss``."""
    owner: str | None
    """The last handler that wrote it. Only this handler may write until it is lost. ``None``: no handler wrote it."""
    forced: IoForced | None
    """The value with which an operator has replaced the written value; ``None`` if no value is forced."""
    lost: bool = False
    """True if the owner is lost, so ``on_loss`` applies."""
    unknown: bool = False
    """True if the last value before the start is damaged, until a value is written or forced."""


@dataclass(frozen=True, kw_only=True)
class Birth:
    """Description of the machine."""

    boot_id: str
    machine: str
    coordinate_systems: tuple[CoordinateSystemInfo, ...]
    servo_period_us: int
    io: dict[str, dict[str, IoDeclaration]] = field(default_factory=dict)
    """Inputs (``in``) and outputs (``out``) of the plant, by name."""


@dataclass(frozen=True, kw_only=True)
class LockSource:
    """One source of an interlock or start lock."""

    source: str
    value: bool
    handler_id: str | None
    """The handler that owns the source: only this handler and an operator can clear it, until it is lost."""
    lost: bool
    """True if the source has no owner or its owner is lost, so ``on_loss`` applies."""
    text: str = ""
    forced_by: str | None = None


@dataclass(frozen=True, kw_only=True)
class Lock:
    """The interlock or the start lock, which is on while any of its sources is on."""

    value: bool
    text: str
    sources: tuple[LockSource, ...]


@dataclass(frozen=True, kw_only=True)
class OptionalSkip:
    """Optional block skip inputs, and those that the interpreter uses now."""

    requested: tuple[int, ...]
    effective: tuple[int, ...]
    effective_from_line: int


@dataclass(frozen=True, kw_only=True)
class CapturedPositions:
    """Positions captured by the last G31, by motor."""

    run_id: str | None
    line: int
    motors: tuple[int, ...]
    positions: tuple[float, ...]
    """Machine positions, mm or degrees."""
    captured: tuple[bool, ...]
    """False if the skip input was not received; the position is then where the motor stopped."""


@dataclass(frozen=True, kw_only=True)
class Position:
    """Positions of the last servo cycle, by axis letter."""

    machine: dict[str, float]
    work: dict[str, float]
    actual: dict[str, float]
    distance_to_go: dict[str, float]
    feedrate: float
    spindle_rpm: float
    homed: dict[str, bool] = field(default_factory=dict)
    """Whether the axis is referenced to the machine's zero; an unreferenced axis does not move.

    Empty from a machine that does not report it.
    """


@dataclass(frozen=True, kw_only=True)
class Tool:
    """The tool in the spindle; 0 for none."""

    id: int


@dataclass(frozen=True, kw_only=True)
class PublishedVariables:
    """Variables that the configuration names in ``[[variables.published]]``."""

    variables: tuple[dict[str, Any], ...]
    """Variables in a row: ``kind``, ``from`` and ``values``."""


@dataclass(frozen=True, kw_only=True)
class ToolData:
    """A tool of the table."""

    id: int
    """Tool number, from 1."""
    radius: float
    """mm: the offset of G41 and G42."""
    length: float
    """mm: added to Z by G43, subtracted by G44."""


@dataclass(frozen=True, kw_only=True)
class ToolTable:
    """The tool table, ascending by number."""

    tools: tuple[ToolData, ...]


@dataclass(frozen=True, kw_only=True)
class WorkOffsetValues:
    """Work offsets of a coordinate system, mm or degrees."""

    work_offsets: dict[str, dict[str, float]]
    """``G54`` to ``G59``, each with its value by axis letter."""


@dataclass(frozen=True, kw_only=True)
class Overrides:
    """Overrides, percent."""

    feed: float
    rapid: float
    spindle: float


@dataclass(frozen=True)
class AlarmWords:
    """Alarm text and remedy in one language: 1 to 1000 characters each."""

    text: str
    remedy: str | None = None

    def to_json(self) -> dict[str, str]:
        """Return the declaration as the presence message carries it."""
        return {"text": self.text} if self.remedy is None else {"text": self.text, "remedy": self.remedy}


@dataclass(frozen=True, kw_only=True)
class AlarmRecord:
    """One alarm."""

    id: int
    severity: str
    """``warning`` or ``alarm``."""
    number: int
    """1 to 9999 for an alarm of the runtime; 10000 + code for an alarm of a sequence program."""
    text: str
    cs: int | None
    program: int | None
    line: int | None
    raised_at: str
    cleared_at: str | None
    acknowledged_by: str | None
    remedy: str | None = None
    """The remedy."""
    languages: dict[str, AlarmWords] = field(default_factory=dict)
    """Text and remedy in other languages, by language tag."""
    column: int | None = None


@dataclass(frozen=True, kw_only=True)
class ActiveAlarms:
    """Active alarms, ascending by id."""

    alarms: tuple[AlarmRecord, ...] = field(default=())


@dataclass(frozen=True, kw_only=True)
class HandlerPresence:
    """Whether a handler is online."""

    online: bool
    validates: bool = False
