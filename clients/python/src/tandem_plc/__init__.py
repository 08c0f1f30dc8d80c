"""Sequence programs for Tandem, the PLC side of a CNC machine, over MQTT.

A handler is an async function that serves an M code: the NC program waits until it returns::

    from tandem_plc import Alarm, Output, Plc, SequenceProgram

    program = SequenceProgram("changer")

    @program.on(6)
    async def change_tool(output: Output, plc: Plc) -> None:
        pocket = output.params.whole("A", 1, 24, "the pocket")
        output.progress(f"pocket {pocket} turns to the spindle")
        ...

    asyncio.run(program.run("mqtt://127.0.0.1:1883/mill-1"))
"""

from .alarms import UserAlarm
from .connection import Credentials
from .coordinate_system import CoordinateSystem
from .errors import (
    AddressError,
    Alarm,
    CommandFailed,
    ConnectError,
    NoAnswer,
    NotConnected,
    OutputEnded,
    ProgramError,
    RequestRefused,
    TakenOver,
    TandemError,
)
from .io import Io
from .m_code_declaration import Param
from .messages import (
    AlarmRecord,
    AlarmWords,
    Birth,
    CancelReason,
    CapturedPositions,
    CommandReply,
    Execution,
    IoDeclaration,
    IoForced,
    IoState,
    Lock,
    LockSource,
    OptionalSkip,
    Overrides,
    Params,
    PendingOutput,
    Position,
    Presence,
    Progress,
    Question,
    Redelivery,
    Run,
    RunAlarm,
    RunEnded,
    RunState,
    RunWait,
    State,
    ToolData,
    WaitingOn,
)
from .output import Output
from .plc import Plc
from .program import Level, SequenceProgram, Serving, stop_signal

__all__ = [
    "AddressError",
    "Alarm",
    "AlarmRecord",
    "AlarmWords",
    "Birth",
    "CancelReason",
    "CapturedPositions",
    "CommandFailed",
    "CommandReply",
    "ConnectError",
    "CoordinateSystem",
    "Credentials",
    "Execution",
    "Io",
    "IoDeclaration",
    "IoForced",
    "IoState",
    "Level",
    "Lock",
    "LockSource",
    "NoAnswer",
    "NotConnected",
    "OptionalSkip",
    "Output",
    "OutputEnded",
    "Overrides",
    "Param",
    "Params",
    "PendingOutput",
    "Plc",
    "Position",
    "Presence",
    "ProgramError",
    "Progress",
    "Question",
    "Redelivery",
    "RequestRefused",
    "Run",
    "RunAlarm",
    "RunEnded",
    "RunState",
    "RunWait",
    "SequenceProgram",
    "Serving",
    "State",
    "TakenOver",
    "TandemError",
    "ToolData",
    "UserAlarm",
    "WaitingOn",
    "stop_signal",
]
