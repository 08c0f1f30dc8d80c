//! Messages and requests that sequence programs read and write. All others are in `plc_protocol::types`.

pub use plc_protocol::types::{BootId, CoordinateSystemNumber, Timestamp};

/// Texts of alarms.
pub mod alarm_text {
    pub use plc_protocol::types::alarm_text::AlarmWords;
}

/// Commands to a coordinate system.
pub mod command {
    pub use plc_protocol::types::command::{Command, Verb};
}

/// Variables, tools and work offsets.
pub mod data {
    pub use plc_protocol::types::data::{LastRun, ToolChange, ToolData, VariableArea};
}

/// Presence of handlers, which tests read.
pub mod handler {
    pub use plc_protocol::types::handler::HandlerPresence;
}

/// Inputs and outputs of the plant.
pub mod io {
    pub use plc_protocol::types::io::{
        IoDeclaration, IoForced, IoKind, IoLoss, IoPoint, IoSide, IoStart, IoState, IoValue,
    };
}

/// Control leases.
pub mod lease {
    pub use plc_protocol::types::lease::LeaseState;
}

/// Start of a program at a line.
pub mod line_start {
    pub use plc_protocol::types::line_start::{Approach, LineStart, LineState, RestoredOutput};
}

/// Interlocks and start locks.
pub mod lock {
    pub use plc_protocol::types::lock::{Lock, LockSource};
}

/// Declarations of M codes and of their parameters.
pub mod m_code {
    pub use plc_protocol::types::m_code::{
        DeclaredParams, ParamDeclaration, ParamLetter, ServedMCode, ServedMCodesFile,
    };
}

/// Alarms of the machine.
pub mod machine {
    pub use plc_protocol::types::machine::{AlarmRecord, AlarmSeverity};
}

/// Messages of the machine.
pub mod message {
    pub use plc_protocol::types::message::{Message, Payload};
}

/// Age limits of requests.
pub mod not_after {
    pub use plc_protocol::types::not_after::NotAfter;
}

/// Outputs of M codes.
pub mod output {
    pub use plc_protocol::types::output::{
        CancelReason, HandshakeStatus, OutputNotice, OutputState, Params, Pending, PendingOutput, Progress,
        Redelivery, Timing,
    };
}

/// Programs in the store.
pub mod program {
    pub use plc_protocol::types::program::{
        DiagnosticSeverity, ProgramDiagnostic, ProgramInfo, SignatureState,
    };
}

/// Questions to the operator.
pub mod question {
    pub use plc_protocol::types::question::Question;
}

/// Requests and their refusals.
pub mod request {
    pub use plc_protocol::types::request::{
        Input, OverrideChange, Refusal, RefusalCode, Request, SpindleCommand,
    };

    /// Requests with typed answers, for [`ask`](trait.Port.html#method.ask) of a port.
    pub mod typed {
        pub use plc_protocol::types::request::typed::WriteProgram;
    }
}

/// Runs of a coordinate system.
pub mod run {
    pub use plc_protocol::types::run::{Production, Run, RunAlarm, RunEnded, RunOrder, RunWait, Runs};
}

/// States of a coordinate system.
pub mod state {
    pub use plc_protocol::types::state::{
        CallSite, CapturedPositions, Execution, Lock, LockSource, Modal, OptionalSkip, Overrides, Position,
        ProgramLocation, Reason, RunKind, Spindle, SpindleDirection, State, Switch, Tool, WaitingOn,
    };
}

/// Topics of messages.
pub mod topic {
    pub use plc_protocol::types::topic::{CsTopic, Topic};
}
