"""Messages of the machine as frozen dataclasses. Lengths are in mm or degrees, feedrates in mm/min.

Generated from the types of the runtime: ``TANDEM_UPDATE=1 cargo test -p tandem-gateway contract`` generates them again.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass, field
from typing import Any, Literal

from .message_methods import AlarmWordsMethods, IoDeclarationMethods, ParamsMethods, RunMethods


class CancelReason(str, enum.Enum):
    """Why an output was cancelled."""

    RESET = "reset"
    """The ``reset`` command."""
    STOP = "stop"
    """The ``stop`` command."""
    ABORT = "abort"
    """The ``abort`` command."""
    ALARM = "alarm"
    """An alarm of the coordinate system or of the whole machine."""
    TIMEOUT = "timeout"
    """Not reset within its time limit (D36)."""
    OPERATOR = "operator"
    """An operator has reset the output or ended it as failed; sent to the owner."""
    SHUTDOWN = "shutdown"
    """The runtime ends, another boot of the runtime is online, or the sequence program itself ends."""


class Execution(str, enum.Enum):
    """State word of a coordinate system, named as in MTConnect Execution."""

    READY = "READY"
    """A program is loaded, at line 1."""
    ACTIVE = "ACTIVE"
    """A program, manual data input or a jog runs."""
    WAIT = "WAIT"
    """Waits for the reset of an auxiliary function output."""
    FEED_HOLD = "FEED_HOLD"
    """Held by the operator."""
    PROGRAM_STOPPED = "PROGRAM_STOPPED"
    """Stopped by M00."""
    OPTIONAL_STOP = "OPTIONAL_STOP"
    """Stopped by M01."""
    INTERRUPTED = "INTERRUPTED"
    """Stopped between blocks, or held by an input; see the reason."""
    STOPPED = "STOPPED"
    """The run ended before the end of the program; see the reason."""
    PROGRAM_COMPLETED = "PROGRAM_COMPLETED"
    """M02 or M30 has been reached and no output is open."""


class OutputState(str, enum.Enum):
    """State of an open output."""

    QUEUED = "QUEUED"
    """Not issued yet, because the program is held (D18)."""
    OUTPUT = "OUTPUT"
    """Issued, and waiting for the claim of a handler."""
    CLAIMED = "CLAIMED"
    """Owned by a handler; the reset of this handler is pending."""


class Redelivery(str, enum.Enum):
    """Treatment of an output on which a lost handler may already have worked. Later variants are stricter."""

    REDO = "redo"
    """Runs the handler again from its start."""
    VERIFY = "verify"
    """Runs the handler with ``output.redelivered()`` true: the handler must inspect the machine first."""
    ASK = "ask"
    """Does nothing: an operator decides by ``redeliver`` or by a manual reset."""


@dataclass(frozen=True, kw_only=True)
class Message:
    """Members that all messages have."""

    boot_id: BootId
    """The boot that publishes the message."""
    ts: str
    """Time of publication."""
    rev: int | None = None
    """For a state: revision, which increases with each change of this topic."""


@dataclass(frozen=True, kw_only=True)
class ActiveAlarms(Message):
    """Payload of ``alarm/active``."""

    alarms: tuple[AlarmRecord, ...]
    """Active alarms, ascending by id."""


@dataclass(frozen=True, kw_only=True)
class AlarmRecord:
    """One alarm: payload of ``alarm/event``, and an entry of ``alarm/active``."""

    acknowledged_by: str | None
    """Name of the operator who acknowledged the alarm; ``None`` if it is not acknowledged."""
    cleared_at: Timestamp | None
    """Time at which the alarm was cleared; ``None`` while it is active."""
    cs: int | None
    """The coordinate system that the alarm stopped; ``None`` for all."""
    id: int
    """Id of this occurrence of the alarm."""
    line: int | None
    """Line of the source file."""
    number: int
    """Number of the alarm: 1 to 9999 for an alarm of the runtime's table; 10000 + code for a handler's alarm."""
    program: int | None
    """Program number."""
    raised_at: Timestamp
    """Time at which the alarm was raised."""
    severity: AlarmSeverity
    """Warning or alarm."""
    text: str
    """Description of the event."""
    column: int | None = None
    """Column of the source line."""
    languages: dict[str, AlarmWords] = field(default_factory=dict)
    """Text and remedy in other languages, by language tag such as ``de``, if the configuration or the handler provides
    them.
    """
    remedy: str | None = None
    """Remedy, if the alarm table, the configuration or the handler provides one."""


@dataclass(frozen=True, kw_only=True)
class AlarmText:
    """Texts of an alarm of a sequence program. When the alarm is raised, the machine adds the remedy and the
    translations; each panel shows the text in its language.
    """

    code: int
    """0 to 9999; the alarm number is 10000 + this code."""
    text: str
    """Description of the event, 1 to 1000 characters."""
    languages: dict[str, AlarmWords] = field(default_factory=dict)
    """Text and remedy in other languages, by language tag such as ``de``; at most 8."""
    remedy: str | None = None
    """Remedy, 1 to 1000 characters."""


@dataclass(frozen=True)
class AlarmWords(AlarmWordsMethods):
    """Text and remedy of an alarm in one language."""

    text: str
    """Description of the event, 1 to 1000 characters."""
    remedy: str | None = None
    """Remedy, 1 to 1000 characters."""


@dataclass(frozen=True, kw_only=True)
class Birth(Message):
    """Payload of ``birth``: description of the machine. Only ``serves`` changes while the runtime runs."""

    coordinate_systems: tuple[CoordinateSystemInfo, ...]
    """Coordinate systems, ascending."""
    identification: Identification
    """Data of the nameplate."""
    io: IoDeclarations
    """Inputs and outputs of the plant."""
    limits: Limits
    """Limits of the interface."""
    m_codes: dict[str, MCodeInfo]
    """M codes that have settings, by number."""
    machine: str
    """Machine name."""
    motors: tuple[MotorInfo, ...]
    """Motors, ascending."""
    servo_period_us: int
    """Servo period, microseconds."""
    serves: tuple[ServedMCode, ...] = ()
    """M codes that are served now, ascending; at most 1000."""


@dataclass(frozen=True, kw_only=True)
class BrokerInUse:
    """An external MQTT broker to which the runtime is connected."""

    address: str
    """Address of the broker, such as ``mqtt://10.0.0.7:1883``."""
    since: Timestamp
    """Time when the connection was established."""


@dataclass(frozen=True, kw_only=True)
class CallSite:
    """A call in the program stack."""

    line: int
    """Line of the call."""
    program: int
    """Program number."""


@dataclass(frozen=True, kw_only=True)
class Cancel(Message):
    """Payload of ``m_code/{m}/cancel``."""

    reason: CancelReason
    """Reason of the cancellation."""
    seq: int
    """Sequence number of the output."""


@dataclass(frozen=True, kw_only=True)
class CapturedPositions(Message):
    """Payload of ``captured``: the positions that the last G31 captured."""

    captured: tuple[bool, ...]
    """For each motor: false if the skip input was not received; the position is then where the motor stopped (D41)."""
    line: int
    """Line of the G31, from 1."""
    motors: tuple[int, ...]
    """Motor numbers, ascending."""
    positions: tuple[float, ...]
    """Captured machine positions, mm or degrees."""
    run_id: str | None
    """Id of the run that executed the G31."""


@dataclass(frozen=True, kw_only=True)
class CommandReply(Message):
    """Payload of ``reply/{client_id}``, and of ``GET /commands/{id}``."""

    code: str
    """``ok``, or the code of the refusal or failure."""
    command_id: str
    """Id of the command."""
    state_rev: int
    """Revision of ``state`` at the time of this reply."""
    status: CommandStatus
    """Status of the command."""
    text: str
    """Description of the result for people."""
    hash: str | None = None
    """Hash of the program that is loaded or started; only for ``load`` and ``start``."""
    lease: Lease | None = None
    """The lease that was taken; only for ``lease/take``."""
    moved: dict[str, float] = field(default_factory=dict)
    """Signed distance from the start of the motion to its end, by axis letter, mm or degrees; only for a failed
    ``jog``, ``mdi`` or ``home``. Axes that did not move are left out.
    """
    run_id: str | None = None
    """Id of the run that was started; only for ``start`` and ``run``."""
    variables: VariableValues | None = None
    """Values that were read; only for ``variable/get``."""


@dataclass(frozen=True, kw_only=True)
class CoordinateSystemInfo:
    """One coordinate system."""

    axes: dict[str, int]
    """Motor number by axis letter."""
    dialect: str
    """NC dialect."""
    number: int
    """Number of the coordinate system."""
    spindle: int | None
    """Motor number of the spindle."""
    units: str
    """``mm`` or ``inch`` at start; positions are always mm."""


@dataclass(frozen=True, kw_only=True)
class HandledCode:
    """One M code that a handler serves."""

    cs: int
    """Coordinate system."""
    m: int
    """M number."""


@dataclass(frozen=True, kw_only=True)
class HandlerPresence:
    """Payload of ``handler/{id}/presence``."""

    online: bool
    """False if the handler has left or its connection was lost."""
    alarms: tuple[AlarmText, ...] = ()
    """Texts of the handler's alarms: remedies and languages."""
    connection: int | None = None
    """With ``expires_ms``: number of this connection among those of the instance. An unchanged presence that is
    repeated over the same connection has no effect. After a presence over a new connection, unclaimed outputs are
    published again.
    """
    exclusive: bool = False
    """With ``instance``: the handler begins work on an output as soon as ``m_code/pending`` shows this instance as the
    owner of the output. If no other handler serves the M code, the machine claims each output for this instance in the
    step that issues the output, and no claim is sent (rule H20).
    """
    expires_ms: int | None = None
    """With ``online``: validity of this presence, ms, 300 to 3,600,000. The handler repeats its presence well within
    this time, preferably at a third of it. Otherwise the handler is treated as offline, as if its last will had been
    received. Without this field, only the last will reports that the handler has left.
    """
    handles: tuple[HandledCode, ...] = ()
    """M codes that the handler serves."""
    instance: str | None = None
    """Identifies one process among all that were started with this handler id: 1 to 64 characters without ``/ + # ~``,
    made at the start of the process and kept across reconnections. While one instance is online, another instance is
    refused. Without this field, the connection identifies the instance.
    """
    m_codes: tuple[MCodeDeclaration, ...] = ()
    """Declarations of the M codes: their names, their parameters, and the treatment of their outputs after a loss of
    the handler.
    """
    redelivery: Redelivery | None = None
    """Treatment of an output that was claimed when its handler was lost. The stricter of this value and the value in
    the configuration of the M code applies; if neither is set, ``ask`` applies.
    """
    returns_within_ms: int | None = None
    """With ``online`` false: the handler will return within this time, ms, 1 to 3,600,000. Until then its M codes are
    treated as served, and their outputs wait for the handler; afterwards the M codes are treated as if no handler were
    registered.
    """
    take_over: bool = False
    """With ``online``: this instance replaces the instance that is online, which is notified."""
    validates: bool = False
    """True if the handler answers ``validate``."""


@dataclass(frozen=True, kw_only=True)
class HandlerResult(Message):
    """Payload of ``handler/{id}/result``: the answer to an ``online`` presence, a request to confirm that the instance
    is still online, or the notice that another instance has replaced it.
    """

    instance: str | None
    """Instance to which the message is addressed."""
    of: HandlerAct
    """Always ``presence``."""
    status: HandlerStatus
    """Result of the presence."""
    code: RefusalCode | None = None
    """With ``refused``: machine-readable reason."""
    text: str | None = None
    """With ``refused`` and ``taken_over``: the reason and the remedy."""


@dataclass(frozen=True, kw_only=True)
class HandshakeResult(Message):
    """Payload of ``m_code/{m}/result``."""

    handler_id: str
    """Sender of the message that this result answers."""
    seq: int
    """Sequence number in the message that this result answers."""
    status: HandshakeStatus
    """Result of the message."""
    how: Redelivery | None = None
    """With an accepted claim of an output on which a lost handler may have worked: ``verify`` if the handler must
    inspect the machine first, ``redo`` if it must start from the beginning.
    """
    instance: str | None = None
    """Instance of the sender, as named in the message."""
    of: OutputAct | None = None
    """Kind of the answered message. An older runtime omits this field."""
    text: str | None = None
    """Reason of a rejection, and the remedy."""


@dataclass(frozen=True, kw_only=True)
class Heartbeat(Message):
    """Payload of ``heartbeat``, published 10 times a second while the servo runs; not published while the servo is
    stopped.
    """

    cycle: int
    """Number of servo cycles since the start, without omitted cycles."""


@dataclass(frozen=True, kw_only=True)
class Identification:
    """Data of a machine's nameplate: the table ``[identification]`` of its configuration. Entries that are not
    configured are absent.
    """

    location: str | None = None
    """Location of the machine."""
    manufacturer: str | None = None
    """Name of the manufacturer."""
    model: str | None = None
    """Manufacturer's name for machines of this type."""
    product_instance_uri: str | None = None
    """Globally unique identifier of the machine."""
    serial_number: str | None = None
    """Serial number that the manufacturer assigned."""
    year_of_construction: int | None = None
    """Year in which the machine was built."""


@dataclass(frozen=True, kw_only=True)
class IoDeclaration(IoDeclarationMethods):
    """Configuration of an input or output."""

    kind: IoKind
    """On/off or number."""
    on_loss: IoLoss
    """The value while its owner is lost: a safe value, which also applies at a start, or ``keep``."""
    at_start: IoStart | None = None
    """With ``on_loss`` ``keep``: the value at a start of the machine, or ``last``, the value that was written last
    before the start.
    """
    max: float | None = None
    """Highest allowed number."""
    min: float | None = None
    """Lowest allowed number."""
    text: str = ""
    """Description for people; empty if the name is sufficient."""
    unit: str | None = None
    """Unit of a number."""


@dataclass(frozen=True, kw_only=True)
class IoForced:
    """A forced value that replaces the written value."""

    by: str
    """User or client that forced the value."""
    value: IoValue
    """The value."""


@dataclass(frozen=True, kw_only=True)
class IoState(Message):
    """Payload of ``io/in/{name}`` and ``io/out/{name}``."""

    forced: IoForced | None
    """The forced value that replaces the written value; ``None`` if no value is forced."""
    owner: str | None
    """The handler that owns the input or output, because it wrote the value last. While the owner is not lost, only the
    owner may write; after a loss of the owner (``lost``), any handler may write. ``None`` if no handler has written a
    value since the start: then any handler and any client without presence may write.
    """
    value: IoValue
    """The value in force: the forced value, otherwise the written value."""
    written: IoValue
    """The value that was written last. Before the first write it is the start value; after the loss of the owner it is
    the value of ``on_loss``.
    """
    lost: bool = False
    """True once the owner is lost; the value is then that of ``on_loss``. The owner of an output is lost if it left
    without an announcement and did not return within ``grace_ms``, or did not return within the announced time. The
    owner of an input is also lost at once if it leaves without an announcement.
    """
    unknown: bool = False
    """True if the value that was written last before the start (``at_start = "last"``) is damaged: the previous value
    of the output is unknown until a value is written or forced.
    """


@dataclass(frozen=True, kw_only=True)
class Lease:
    """A control lease that a client holds."""

    expires_at: Timestamp
    """Time when the lease ends unless it is renewed."""
    fence: int
    """Number of the lease; commands under the lease carry this number. It increases with each lease of the coordinate
    system, and is never reused.
    """
    holder: str
    """Name of the holder."""


@dataclass(frozen=True, kw_only=True)
class LeaseState(Message):
    """Payload of ``cs/{cs}/lease/state``: all fields are ``None`` while the lease is free."""

    expires_at: Timestamp | None
    """Time when the lease ends unless it is renewed."""
    fence: int | None
    """Number of the lease."""
    holder: str | None
    """Name of the holder."""


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Limits of the interface."""

    open_outputs_max: int
    """Largest number of open outputs in one coordinate system; at this limit the interpreter waits."""
    program_bytes_max: int
    """Largest size of one program, bytes."""


@dataclass(frozen=True, kw_only=True)
class Lock(Message):
    """Payload of ``input/interlock/state`` and ``input/start_lock/state``: an input with the reasons why it is on."""

    value: bool
    """On as long as at least one source is on."""
    sources: tuple[LockSource, ...] = ()
    """Sources of the input by name: those of the configuration, those that are on, and those that have an owner."""
    text: str = ""
    """Reasons, as given by the sources that are on."""


@dataclass(frozen=True, kw_only=True)
class LockSource:
    """One source of an interlock or start lock."""

    handler_id: str | None
    """The handler that owns the source: while the owner is not lost, only this handler and an operator (``force``) may
    clear the source. ``None`` if a client without presence has set the source; any such client may clear it. Also
    ``None``, with ``lost``, for a source of the configuration that has had no owner since the start.
    """
    source: str
    """Name of the source; ``default`` if the message that set it named no source."""
    value: bool
    """On or off."""
    forced_by: str | None = None
    """The operator who set the source instead of its owner, until the owner writes the source again."""
    lost: bool = False
    """True once the owner of the source is lost, and for a source of the configuration until its first owner sets the
    source. While true, the value is that of ``on_loss``.
    """
    text: str = ""
    """Reason, as given by the source."""


@dataclass(frozen=True, kw_only=True)
class MCodeDeclaration:
    """Declaration of an M code by the handler that serves it: its name, and the meaning of its parameters."""

    m: int
    """M number."""
    cs: int | None = None
    """Coordinate system to which the declaration applies. Without this field, the declaration applies to all coordinate
    systems in which the handler serves the M code and which have no separate declaration.
    """
    name: str | None = None
    """Function of the M code, such as ``clamp``: 1 to 40 characters."""
    params: dict[str, ParamDeclaration] | None = None
    """Parameters of the M code: a program with other parameters, or with numbers that a parameter does not accept, is
    not loaded. Without this field every parameter is accepted; an empty map accepts no parameter.
    """
    redelivery: Redelivery | None = None
    """Treatment of an output of this M code that was claimed when its handler was lost. This value replaces the
    ``redelivery`` of the whole presence.
    """


@dataclass(frozen=True, kw_only=True)
class MCodeInfo:
    """Settings of one M code."""

    timeout_ms: int | None
    """Time limit of the reset, ms."""
    timing: Timing
    """Time at which the M code is issued."""
    wait_state: str | None
    """Text that ``state`` shows while the program waits for the M code."""
    name: str | None = None
    """Name of the M code in the configuration."""
    params: dict[str, ParamDeclaration] | None = None
    """Parameters of the M code in the configuration."""


@dataclass(frozen=True, kw_only=True)
class Modal(Message):
    """Payload of ``modal``."""

    f: float
    """Feedrate, mm/min."""
    g: dict[str, str]
    """G code in force by modal group number (``"01"`` to ``"23"``)."""
    s: float
    """Spindle speed, r/min."""
    ta: float
    """Acceleration time, ms."""
    td: float
    """Deceleration time, ms."""
    tool: int | None
    """Selected tool; 0 for none; ``None`` if the tool is unknown because the stored value is damaged."""
    ts_ms: float
    """Jerk time, ms. In JSON it is ``ts_ms``, since ``ts`` is the time of every message."""
    work_offset: str | None
    """``G54`` to ``G59``, or ``None``."""
    mdi: tuple[str, ...] = ()
    """Codes in force at the beginning of the next manual data input that differ from those at start-up, such as G91 or
    G20; empty for the start-up state. Codes of motion (group 01) and of the return level (group 10) are left out.
    """


@dataclass(frozen=True, kw_only=True)
class MotorInfo:
    """One motor."""

    kind: str
    """``linear`` (mm), ``rotary`` (deg) or ``spindle`` (r/min)."""
    max_velocity: float
    """Highest velocity, mm/s or degrees/s (spindle: r/min)."""
    number: int
    """CNC motor number."""
    soft_limits: tuple[float, float] | None
    """Lowest and highest machine position, mm or degrees; ``None`` for a motor without soft limits."""


@dataclass(frozen=True, kw_only=True)
class OptionalSkip(Message):
    """Payload of ``input/optional_skip/state``."""

    effective: tuple[int, ...]
    """Numbers of the block skips that the interpreter applies now."""
    effective_from_line: int
    """First line that was interpreted with ``effective``; earlier lines were read ahead with the previous numbers."""
    requested: tuple[int, ...]
    """Numbers of the block skip inputs that are on, ascending."""


@dataclass(frozen=True, kw_only=True)
class OutputNotice(Message):
    """One output, as in ``m_code/{m}/output``."""

    attempt: int
    """Number of this notice: 1 for the first notice, increased by one each time the output is published again."""
    line: int
    """Line of the source file, from 1."""
    m: int
    """M number, 0 to 191."""
    params: Params
    """Parameters VA to VH."""
    program: int
    """Program number."""
    redelivered: bool
    """True if the output was published before. It is published again after the loss of its handler (``lost`` in
    ``m_code/pending``), at the request of an operator, when a handler for its M code comes online, and when the
    connection to the broker is restored.
    """
    run_id: str
    """Id of the program run that issued the output; never reused, across all starts of the runtime."""
    seq: int
    """Sequence number: strictly increasing in its coordinate system, never reused within a boot."""
    timing: Timing
    """Timing in force for this output."""
    id: str = ""
    """Identifies this output permanently, across all starts of the runtime. Use this id to record work that must be
    done only once, such as counting a part. Empty if an older runtime has published the output.
    """


@dataclass(frozen=True, kw_only=True)
class Overrides(Message):
    """Payload of ``override/state``, percent."""

    feed: float
    """Feed override, 0 to 200."""
    rapid: float
    """Rapid override, 0 to 100."""
    spindle: float
    """Spindle override, 0 to 200."""


@dataclass(frozen=True, kw_only=True)
class ParamDeclaration:
    """Meaning of one parameter, and the numbers that it accepts."""

    max: float | None = None
    """Highest accepted number."""
    min: float | None = None
    """Lowest accepted number."""
    name: str | None = None
    """Name, such as ``force``: 1 to 40 characters."""
    optional: bool = False
    """True if the parameter may be omitted."""
    unit: str | None = None
    """Unit, such as ``kN``: 1 to 16 characters."""
    whole: bool = False
    """True if only whole numbers are accepted."""


@dataclass(frozen=True, kw_only=True)
class Params(ParamsMethods):
    """Parameters VA to VH of an output, in JSON ``A`` to ``H``: numbers as the program gives them, without a unit (G20
    and G21 do not change them); ``None`` if not programmed.
    """

    A: float | None = None
    """Parameter VA."""
    B: float | None = None
    """Parameter VB."""
    C: float | None = None
    """Parameter VC."""
    D: float | None = None
    """Parameter VD."""
    E: float | None = None
    """Parameter VE."""
    F: float | None = None
    """Parameter VF."""
    G: float | None = None
    """Parameter VG."""
    H: float | None = None
    """Parameter VH."""


@dataclass(frozen=True, kw_only=True)
class Pending(Message):
    """Payload of ``m_code/pending``: all open outputs, ascending by ``seq``."""

    outputs: tuple[PendingOutput, ...]
    """Open outputs; empty if no output is open."""


@dataclass(frozen=True, kw_only=True)
class PendingOutput:
    """One open output, as in ``m_code/pending``."""

    attempt: int
    """Number of this notice: 1 for the first notice, increased by one each time the output is published again."""
    handler_id: str | None
    """Owner of the output; ``None`` until a handler has claimed it."""
    line: int
    """Line of the source file, from 1."""
    m: int
    """M number, 0 to 191."""
    params: Params
    """Parameters VA to VH."""
    program: int
    """Program number."""
    redelivered: bool
    """True if the output was published before. It is published again after the loss of its handler (``lost`` in
    ``m_code/pending``), at the request of an operator, when a handler for its M code comes online, and when the
    connection to the broker is restored.
    """
    run_id: str
    """Id of the program run that issued the output; never reused, across all starts of the runtime."""
    seq: int
    """Sequence number: strictly increasing in its coordinate system, never reused within a boot."""
    since: Timestamp
    """Time at which the output entered this state."""
    state: OutputState
    """State of the output."""
    timing: Timing
    """Timing in force for this output."""
    checkpoint: Any = None
    """Last checkpoint of an owner; it is kept when that owner is lost."""
    how: Redelivery | None = None
    """Decision of an operator on how the work on the output continues."""
    id: str = ""
    """Identifies this output permanently, across all starts of the runtime. Use this id to record work that must be
    done only once, such as counting a part. Empty if an older runtime has published the output.
    """
    instance: str | None = None
    """Instance of the owner, if it is known."""
    lost: bool = False
    """True while the output waits because the handler that had claimed it was lost: that handler may have worked on the
    output.
    """
    lost_instance: str | None = None
    """If ``lost``: the instance that had claimed the output, if this instance named itself. Only this instance may
    claim the output without a decision of an operator. If it had never begun the work (H20), it may begin now.
    """
    progress: Progress | None = None
    """Last progress report of the owner."""
    question: Question | None = None
    """Question of the owner to the operator, with the answer once the operator has answered."""
    redelivery: Redelivery | None = None
    """If ``lost``: the stricter of two values, that in the configuration of the M code and that of the lost handler.
    Together with the value of another handler, it decides whether that handler may claim the output.
    """


@dataclass(frozen=True, kw_only=True)
class PlanIdentity:
    """Identity of a plan: all inputs from which the plan is computed. Two plans with the same identity are equal."""

    called: str | None
    """SHA-256 of the lines ``number hash`` of every program that the main program may call, ascending; ``None`` if it
    calls no program.
    """
    hash: str
    """Hash of the main program."""
    inputs: str
    """Revision of all other inputs: start position, line of the start, work offsets, tools, block skips, optional stop,
    dry run, and the values of the P and Q variables that the program reads.
    """


@dataclass(frozen=True, kw_only=True)
class PlannedLocation:
    """A block of a program."""

    line: int
    """Line, from 1."""
    program: int
    """Program number, main or subprogram."""


@dataclass(frozen=True, kw_only=True)
class Position(Message):
    """Payload of ``position``. Lengths are mm and angles degrees, regardless of G20 and G21."""

    actual: dict[str, float]
    """Actual machine position, by axis letter."""
    distance_to_go: dict[str, float]
    """Remaining distance of the running block, by axis letter."""
    feedrate: float
    """Speed on the path, mm/min."""
    following_error: dict[str, float]
    """Commanded minus actual position, by axis letter."""
    machine: dict[str, float]
    """Commanded machine position by axis letter."""
    spindle_rpm: float
    """Actual spindle speed, r/min; negative counter-clockwise."""
    work: dict[str, float]
    """Commanded position in work coordinates, by axis letter."""
    homed: dict[str, bool] = field(default_factory=dict)
    """Whether each axis is homed: its position refers to the zero of the machine, by an absolute encoder or because its
    drive has been homed. An axis that is not homed does not move (alarm 208), and its positions are meaningless. Empty
    if the machine does not report this.
    """


@dataclass(frozen=True, kw_only=True)
class Presence(Message):
    """Payload of ``presence``."""

    online: bool
    """False if the runtime has ended or its connection was lost."""
    started_at: Timestamp
    """Time when the runtime started."""
    version: str
    """Version of the runtime."""
    broker: BrokerInUse | None = None
    """External MQTT broker to which the runtime is connected; absent with the embedded broker, and without a
    connection.
    """
    expires_ms: int | None = None
    """Validity of this presence, ms; the runtime publishes it again at a third of this time. A connected client that
    has received no presence for this time may treat the runtime as offline. Absent if the presence is not repeated.
    """
    url: str | None = None
    """Address of the HMI as other computers reach it, if the configuration sets it (``[http] public_url``)."""


@dataclass(frozen=True, kw_only=True)
class ProgramLocation(Message):
    """Payload of ``program``."""

    block: str
    """Text of that line."""
    interpreted_line: int
    """Line that the interpreter has reached in its pre-read."""
    line: int
    """Line of the block whose motion runs, from 1."""
    nest_level: int
    """0 in the main program, 1 to 8 in subprograms."""
    number: int | None
    """Number of the program that runs now, main or subprogram; 0 for manual data input."""
    stack: tuple[CallSite, ...]
    """Calls that lead to the running program, main program first."""


@dataclass(frozen=True, kw_only=True)
class Progress:
    """Progress of a handler, shown while the program waits."""

    text: str
    """Current step of the work, at most 200 characters."""
    percent: float | None = None
    """Completed share of the work, percent, 0 to 100."""


@dataclass(frozen=True, kw_only=True)
class PublishedVariables(Message):
    """Payload of ``variables`` and ``cs/{cs}/variables``: the variables that ``[[variables.published]]`` of the
    configuration lists, all at the same moment.
    """

    variables: tuple[VariableValues, ...]
    """Ranges of consecutive variables, in the order of the configuration. A damaged value (warning 406) is ``"NaN"``.
    """


@dataclass(frozen=True, kw_only=True)
class Question:
    """A question that a handler asks the operator. ``m_code/pending`` shows the question with its output. ``state``
    shows the question while the program waits for that output and the question has no answer.
    """

    choices: tuple[str, ...]
    """Possible answers: 1 to 8 different texts of 1 to 40 characters."""
    id: str
    """Id of the question; its answer contains the same id."""
    since: Timestamp
    """Time at which the question was asked."""
    text: str
    """Text of the question, 1 to 200 characters."""
    answer: str | None = None
    """The answer; absent until the operator has answered."""


@dataclass(frozen=True, kw_only=True)
class Run(RunMethods):
    """A run of the loaded program, as in ``cs/{n}/run``, ``GET /runs/{id}`` and ``GET /runs``."""

    alarms: tuple[RunAlarm, ...]
    """Alarms of the coordinate system during the run, at most 10."""
    began: Timestamp
    """Time at which the run started."""
    cs: int
    """Coordinate system of the run."""
    end: RunEnded | None
    """End of the run; ``None`` if the run has not ended."""
    from_line: int | None
    """The line at which the run started; ``None`` if it started at the beginning."""
    hash: str | None
    """Hash of the program."""
    id: str
    """Id of the run, unique over all starts of the runtime: the ``run_id`` of ``state``, of outputs and of the journal.
    """
    last_part_s: float | None
    """Duration of the last completed part, s."""
    parts: int
    """Number of ordered parts."""
    parts_done: int
    """Number of completed parts."""
    program: int
    """Main program number."""
    took_s: float
    """Duration from the start of the run to the end of its last part, s."""
    waits: tuple[RunWait, ...]
    """M codes for which the program waited, longest wait first, at most 20."""
    waits_for: str | None
    """Reason why the next part has not started yet, such as the text of the start lock."""


@dataclass(frozen=True, kw_only=True)
class RunAlarm:
    """An alarm of a run."""

    line: int | None
    """Line of the program, if the alarm has one."""
    number: int
    """Number of the alarm."""
    text: str
    """Text of the alarm."""


@dataclass(frozen=True, kw_only=True)
class RunEnded:
    """End of a run."""

    at: Timestamp
    """Time of the end."""
    how: RunEndedHow
    """Kind of the end."""
    place: PlannedLocation | None
    """The block whose motion ran at an early end; ``None`` if the run was completed, or no block had run."""
    text: str
    """Explanation, such as the reason why the next part was refused; otherwise empty."""


@dataclass(frozen=True, kw_only=True)
class RunState(Message):
    """Payload of ``cs/{n}/run``."""

    run: Run | None
    """The run in progress, otherwise the last run that ended; ``None`` if no run has started."""


@dataclass(frozen=True, kw_only=True)
class RunWait:
    """The waits of a run for one M code."""

    count: int
    """Number of waits."""
    longest_s: float
    """Longest wait, s."""
    m: int
    """M number."""
    total_s: float
    """Total duration, s."""


@dataclass(frozen=True, kw_only=True)
class ServedMCode:
    """An M code that is served, and its handler."""

    handler_id: str | None
    """The handler; ``None`` for the stock sequence program of the runtime."""
    m: int
    """M number."""
    cs: tuple[int, ...] = ()
    """Coordinate systems in which the M code is served, ascending."""
    name: str | None = None
    """Name that the handler declares, otherwise the name in the configuration."""
    params: dict[str, ParamDeclaration] | None = None
    """Parameters that the handler declares, otherwise those of the configuration. If neither declares parameters, every
    parameter is accepted.
    """


@dataclass(frozen=True, kw_only=True)
class Spindle(Message):
    """Payload of ``spindle/state``."""

    actual_rpm: float
    """Actual speed, r/min."""
    direction: SpindleDirection
    """Commanded direction."""
    oriented: bool
    """True if the spindle is at the orientation position after ``orient``."""
    rpm: float
    """Commanded speed, r/min."""


@dataclass(frozen=True, kw_only=True)
class StartConditions(Message):
    """Payload of ``cs/{n}/start_conditions``."""

    obstacles: tuple[StartObstacle, ...]
    """Obstacles that prevent a start of the loaded program, or would end its run by an alarm, in the order in which to
    remove them; empty if a start runs the program.
    """


@dataclass(frozen=True, kw_only=True)
class StartObstacle:
    """One obstacle of a start."""

    at: PlannedLocation | None
    """With ``prediction``: the block that causes the alarm; ``None`` if the alarm has no block."""
    kind: StartObstacleKind
    """Kind of the obstacle."""
    refuses: bool
    """True if a start is refused; false if a start is accepted but an alarm ends the run."""
    text: str
    """Description and remedy."""
    detail: str = ""
    """The part of ``text`` that is not fixed: text of the input, holder of the lease, or reason of the fault; otherwise
    empty.
    """
    m_codes: tuple[int, ...] = ()
    """With ``m_code``: M numbers, ascending."""


@dataclass(frozen=True, kw_only=True)
class State(Message):
    """Payload of ``state``."""

    alarm_count: int
    """Active alarms of this coordinate system."""
    dry_run: bool
    """Dry run input."""
    execution: Execution
    """The state word."""
    hash: str | None
    """Hash of the loaded program: during a run the hash of the running text, otherwise the hash of the text that a
    start would run. SHA-256 of the bytes of the file, 64 hexadecimal digits; ``None`` without a program.
    """
    last_command_id: str | None
    """Id of the last accepted command."""
    o_number: int | None
    """Number that the text contains, in dialects whose text contains a number (``O12345678``); this is not the number
    ``program``.
    """
    optional_skip: tuple[int, ...]
    """Optional skip inputs that are on, ascending."""
    optional_stop: bool
    """Optional stop input."""
    program: int | None
    """The loaded main program."""
    reason: Reason | None
    """Reason of the state, or ``None``."""
    run_id: str | None
    """Id of the run; ``None`` before the first start."""
    run_kind: RunKind | None
    """Kind of the run, also while it is paused; ``None`` if no run is active."""
    single_block: bool
    """Single block input."""
    transition: Transition | None
    """Transition to another state, or ``None``."""
    wait_state: str | None
    """``wait_state`` setting of the M code for which the program waits."""
    waiting_on: WaitingOn | None
    """The output for which the program waits."""


@dataclass(frozen=True, kw_only=True)
class StoredData(Message):
    """Payload of ``stored_data``."""

    question: StoredDataQuestion | None
    """The question that a person must answer; ``null`` if the stored files are consistent."""


@dataclass(frozen=True, kw_only=True)
class StoredDataFinding:
    """A part of the stored data that is inconsistent with the other parts."""

    fault: StoredDataFault
    """Kind of the inconsistency."""
    part: StoredDataPart
    """The inconsistent part."""
    text: str
    """Description of the finding, with the files."""


@dataclass(frozen=True, kw_only=True)
class StoredDataQuestion:
    """Stored files that are inconsistent. Until a person accepts or refuses them, their content is not used, and no
    program starts.
    """

    findings: tuple[StoredDataFinding, ...]
    """Inconsistencies that were found."""
    newest_journal_entry: Timestamp | None
    """Time of the newest entry of the journal at that start: all data that were stored before this time should exist.
    ``null`` if the journal has no entry.
    """
    since: Timestamp
    """Time of the start of the runtime that found the inconsistent files."""


@dataclass(frozen=True, kw_only=True)
class Switch(Message):
    """Payload of an input with one value."""

    value: bool
    """On or off."""


@dataclass(frozen=True, kw_only=True)
class TimeLeft(Message):
    """Payload of ``cs/{n}/time_left``: remaining time of the program run in progress."""

    left_s: float | None
    """Time to the end, s, with the current overrides, without holds and without future waits of unknown duration.
    ``None`` if no program runs, the run is not planned yet, or the time is unknown because an override of 0 stops the
    motion or the program waits without a known end.
    """
    plan: PlanIdentity | None
    """The plan of the run from which the time was computed; ``None`` if the run is not planned yet."""
    progress: float | None
    """Completed share of the planned time, 0 to 1; ``None`` if no program runs, or the run is not planned yet."""
    run_id: str | None
    """Id of the run; ``None`` if no program runs."""


@dataclass(frozen=True, kw_only=True)
class Tool(Message):
    """Payload of ``tool/state``."""

    id: int
    """Number of the tool in the spindle; 0 for none."""


@dataclass(frozen=True, kw_only=True)
class ToolData:
    """A tool of the tool table: the dimensions that G41 to G44 use (D17)."""

    id: int
    """Tool number, from 1."""
    length: float
    """Length, mm: G43 adds it to Z, G44 subtracts it."""
    radius: float
    """Radius, mm, 0 or more: the offset of G41 and G42."""


@dataclass(frozen=True, kw_only=True)
class ToolTable(Message):
    """The tool table, ascending by number: response of ``GET /tools`` and payload of ``tools``."""

    tools: tuple[ToolData, ...]
    """Tools of the table."""


@dataclass(frozen=True, kw_only=True)
class Validate(Message):
    """Payload of ``m_code/{m}/validate``: asks, when a program is loaded, whether this M code may be issued with these
    parameters.
    """

    line: int
    """Line of the source file, from 1."""
    params: Params
    """Parameters VA to VH as written in the program."""
    program: int
    """Program number."""
    request_id: str
    """Id of the request; its result contains the same id."""


@dataclass(frozen=True, kw_only=True)
class VariableValues:
    """Values of consecutive variables, all at the same moment: part of the reply to ``variable/get``, and response of
    ``GET /variables/p``.
    """

    from_: int
    """Number of the first variable."""
    kind: VariableKind
    """Letter of the variables."""
    values: tuple[Number, ...]
    """Values of the variables, ascending by number."""


@dataclass(frozen=True, kw_only=True)
class WaitingOn:
    """The output for which a program waits."""

    m: int
    """M number."""
    seq: int
    """Sequence number."""
    since: Timestamp
    """Time when the wait began."""
    progress: Progress | None = None
    """Last progress report of the handler."""
    question: Question | None = None
    """Question of the handler to the operator, while the question has no answer."""


@dataclass(frozen=True, kw_only=True)
class WorkOffsetValues(Message):
    """Work offsets of a coordinate system, mm or degrees: payload of ``cs/{cs}/work_offsets``."""

    work_offsets: dict[str, dict[str, float]]
    """``G54`` to ``G59``, each with its value by axis letter."""


AlarmSeverity = Literal["warning", "alarm"]
"""Severity of an alarm."""

BootId = str
"""Identifies one start of the runtime. Outputs, claims and resets of another boot are stale."""

CommandStatus = Literal["accepted", "rejected", "done", "failed"]
"""Status of a command."""

HandlerAct = Literal["presence"]
"""Message that a ``handler/{id}/result`` answers."""

HandlerStatus = Literal["accepted", "refused", "confirm", "taken_over"]
"""Status in the answer to a presence."""

HandshakeStatus = Literal["accepted", "duplicate", "stale", "unknown", "not_owner", "withheld", "refused"]
"""Result of a claim or a reset."""

IoDeclarations = dict[str, dict[str, IoDeclaration]]
"""All inputs and outputs of a plant, as the configuration declares them."""

IoKind = Literal["bool", "number"]
"""Kind of a value."""

IoValue = bool | float
"""The value of an input or output."""

KeepWord = Literal["keep"]
"""The word ``keep``."""

IoLoss = IoValue | KeepWord
"""The value of an input or output whose owner is lost."""

LastWord = Literal["last"]
"""The word ``last``."""

IoStart = IoValue | LastWord
"""The value of an output at a start of the machine."""

Number = float | Literal["NaN", "inf", "-inf"]

OutputAct = Literal["claim", "reset", "progress", "checkpoint", "ask", "redeliver", "answer"]
"""Message that a ``result`` answers."""

Reason = Literal[
    "HANDLER_LOST",
    "SINGLE_BLOCK",
    "INTERLOCK",
    "BUS_LOST",
    "SERVO_LATE",
    "CLIENT_LOST",
    "BACK_TRACE",
    "BACK_TRACE_END",
    "OVERRIDE_ZERO",
    "ALARM",
    "STOP",
    "ABORTED",
    "NO_PROGRAM",
    "RESTARTED",
]
"""Reason of a state."""

RefusalCode = Literal[
    "not_found",
    "not_allowed",
    "program_runs",
    "start_locked",
    "forbidden",
    "busy",
    "lease_lost",
    "handler_taken",
    "no_answer",
    "command_id_reused",
    "precondition_failed",
    "program_has_errors",
    "wrong_dialect",
    "not_signed",
    "line_refused",
    "invalid",
    "too_large",
    "not_supported",
    "retained",
    "expired",
    "unavailable",
]
"""Machine-readable reason of a refusal."""

RunEndedHow = Literal[
    "completed",
    "stopped",
    "aborted",
    "reset",
    "alarm",
    "lease_lost",
    "replaced",
    "refused",
    "restarted",
]
"""Kind of the end of a run."""

RunKind = Literal["program", "mdi", "home", "jog"]
"""Kind of a run."""

SpindleDirection = Literal["cw", "ccw", "stop", "orient"]
"""Rotation of a spindle."""

StartObstacleKind = Literal[
    "running",
    "alarm",
    "no_program",
    "reset",
    "interlock",
    "start_lock",
    "lease",
    "program",
    "m_code",
    "prediction",
]
"""Kind of an obstacle of a start."""

StoredDataFault = Literal["older", "other_machine", "not_verified"]
"""Kind of inconsistency of a part of the stored data."""

StoredDataPart = Literal["store", "programs", "folders", "journal"]
"""A part of the stored data."""

Timestamp = str
"""A time as RFC 3339 in UTC, such as ``2026-01-31T12:00:00.250000Z``."""

Timing = Literal["after_motion", "with_motion"]
"""Time at which the machine issues an output (D30)."""

Transition = Literal["STARTING", "HOLDING", "STOPPING", "RESUMING", "RESETTING"]
"""Transition to another state."""

VariableKind = Literal["P", "Q"]
"""Letter of the variables that are kept after the end of a program (manual 4-3)."""

MESSAGE_OF: dict[str, type] = {
    "presence": Presence,
    "birth": Birth,
    "heartbeat": Heartbeat,
    "alarm/event": AlarmRecord,
    "alarm/active": ActiveAlarms,
    "reply/+": CommandReply,
    "handler/+/result": HandlerResult,
    "io/in/+": IoState,
    "io/out/+": IoState,
    "variables": PublishedVariables,
    "tools": ToolTable,
    "stored_data": StoredData,
    "cs/+/state": State,
    "cs/+/program": ProgramLocation,
    "cs/+/position": Position,
    "cs/+/modal": Modal,
    "cs/+/m_code/pending": Pending,
    "cs/+/captured": CapturedPositions,
    "cs/+/input/optional_skip/state": OptionalSkip,
    "cs/+/input/optional_stop/state": Switch,
    "cs/+/input/single_block/state": Switch,
    "cs/+/input/dry_run/state": Switch,
    "cs/+/input/interlock/state": Lock,
    "cs/+/input/start_lock/state": Lock,
    "cs/+/spindle/state": Spindle,
    "cs/+/tool/state": Tool,
    "cs/+/override/state": Overrides,
    "cs/+/lease/state": LeaseState,
    "cs/+/run": RunState,
    "cs/+/time_left": TimeLeft,
    "cs/+/start_conditions": StartConditions,
    "cs/+/variables": PublishedVariables,
    "cs/+/work_offsets": WorkOffsetValues,
    "cs/+/m_code/+/output": OutputNotice,
    "cs/+/m_code/+/result": HandshakeResult,
    "cs/+/m_code/+/cancel": Cancel,
    "cs/+/m_code/+/validate": Validate,
    "handler/+/presence": HandlerPresence,
}
"""Class of the messages of a topic, by the path below the machine; ``+`` stands for one level."""
