//! State that built-in function blocks keep from call to call.

use plc_api::function_blocks::{
    DownCounter, FallingEdge, OffDelay, OnDelay, Pulse, ResetDominant, RisingEdge, SetDominant, UpCounter,
    UpDownCounter,
};

#[derive(Debug, Clone, PartialEq)]
pub(crate) enum State {
    Nothing,
    RisingEdge(RisingEdge),
    FallingEdge(FallingEdge),
    SetDominant(SetDominant),
    ResetDominant(ResetDominant),
    OnDelay(OnDelay),
    OffDelay(OffDelay),
    Pulse(Pulse),
    UpCounter(UpCounter),
    DownCounter(DownCounter),
    UpDownCounter(UpDownCounter),
    /// The progress that was reported last.
    Progress(Option<(String, f64)>),
    /// Edges of commands.
    Edges([RisingEdge; 7]),
}
