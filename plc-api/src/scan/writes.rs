//! The writes of one scan.

use std::collections::BTreeMap;
use std::mem::discriminant;

use plc_protocol::alarm::Alarm;
use plc_protocol::types::CoordinateSystemNumber;
use plc_protocol::types::command::Command;
use plc_protocol::types::data::VariableArea;
use plc_protocol::types::request::{Input, Request};

use super::flags::FlagKey;
use super::scan_question::ScanQuestion;
use crate::handlers::AuxOutput;

/// Values that one scan has written.
#[derive(Debug, Default)]
pub(super) struct Writes {
    /// Flags of the machine, such as inputs, spindle, tool and skip inputs, each as the request that sets the
    /// flag.
    pub(super) flags: Vec<Request>,
    pub(super) variables: BTreeMap<(VariableArea, u32), f64>,
    pub(super) commands: Vec<(CoordinateSystemNumber, Command)>,
    pub(super) progress: Vec<(AuxOutput, String, Option<f64>)>,
    /// Alarms with their levels, by coordinate system (`None`: whole machine) and number.
    pub(super) alarms: BTreeMap<(Option<CoordinateSystemNumber>, u16), (bool, Alarm)>,
    pub(super) questions: BTreeMap<FlagKey, (AuxOutput, ScanQuestion)>,
    pub(super) answers: BTreeMap<(CoordinateSystemNumber, u16), (AuxOutput, Result<(), Alarm>)>,
}

/// Adds the value of a flag; replaces an earlier value of the same flag.
pub(super) fn put(flags: &mut Vec<Request>, flag: Request) {
    match flags.iter_mut().find(|known| is_same_flag(known, &flag)) {
        Some(known) => *known = flag,
        None => flags.push(flag),
    }
}

fn is_same_flag(one: &Request, other: &Request) -> bool {
    match (one, other) {
        (Request::Input(cs, one), Request::Input(other_cs, other)) => {
            cs == other_cs
                && match (one, other) {
                    (Input::OptionalSkip(one), Input::OptionalSkip(other)) => one.keys().eq(other.keys()),
                    (Input::Interlock(one), Input::Interlock(other))
                    | (Input::StartLock(one), Input::StartLock(other)) => one.source() == other.source(),
                    _ => discriminant(one) == discriminant(other),
                }
        }
        (Request::Spindle(one, _), Request::Spindle(other, _))
        | (Request::Tool(one, _), Request::Tool(other, _)) => one == other,
        (Request::SkipInput(one, _), Request::SkipInput(other, _)) => one == other,
        (Request::WriteIo(one, _), Request::WriteIo(other, _)) => one == other,
        _ => false,
    }
}
