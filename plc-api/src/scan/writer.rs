//! Executes the writes of a scan.

use std::collections::BTreeMap;
use std::mem::take;

use plc_protocol::alarm::Alarm;
use plc_protocol::error::Error;
use plc_protocol::io_points::{check_io_declared, check_io_owner};
use plc_protocol::types::CoordinateSystemNumber;
use plc_protocol::types::data::{VARIABLES_AT_ONCE_MAX, VariableArea};
use plc_protocol::types::request::{Input, Refusal, Request};
use plc_protocol::types::state::{Lock, LockSet};

use super::flags::Flags;
use super::image::Image;
use super::scan_question::ScanQuestion;
use super::writes::put;
use crate::alarm_level::{AlarmLevel, is_active};
use crate::handlers::AuxOutput;
use crate::plc::Plc;

/// Executor of the writes of scans.
#[derive(Debug, Default)]
pub(super) struct Writer {
    /// Last value of each flag that the machine has accepted, as the request that sets the flag.
    written: Vec<Request>,
    /// Levels of the alarms that scans have written, by coordinate system (`None`: whole machine) and number.
    alarms: BTreeMap<(Option<CoordinateSystemNumber>, u16), AlarmLevel>,
    /// Refusals of writes of the last scan, which the next scan reads.
    refusals: Vec<Refusal>,
}

impl Writer {
    pub(super) fn take_refusals(&mut self) -> Vec<Refusal> {
        take(&mut self.refusals)
    }

    /// Executes the writes of one scan: first variables, flags and commands, and last the answers of M codes.
    /// Thus the block after an M code sees all writes.
    pub(super) async fn execute_writes(&mut self, plc: &Plc, flags: &Flags, mut image: Image) {
        let writes = take(&mut image.writes);
        for (output, text, percent) in writes.progress {
            if let Err(error) = output.progress(text, percent).await {
                tracing::debug!(%error, m = output.m(), "the machine did not accept the progress of a scan program");
            }
        }
        for request in variable_requests(&writes.variables) {
            self.request(plc, request, &image).await;
        }
        for flag in writes.flags {
            // a later scan writes the flag, after the machine has accepted the handler that owns the flag
            let Some(flag) = owned(flag, plc) else { continue };
            if self.written.contains(&flag) && is_in_effect(&flag, &image) {
                continue;
            }
            if let Err(refusal) = check_io_write(&flag, &image) {
                self.record_refusal(refusal, &image);
                continue;
            }
            if self.request(plc, flag.clone(), &image).await {
                put(&mut self.written, flag);
            }
        }
        for (cs, command) in writes.commands {
            let request = Request::Command {
                cs,
                command,
                meta: plc.command_meta(),
                wait: false,
            };
            self.request(plc, request, &image).await;
        }
        for (place, (level, alarm)) in writes.alarms {
            self.set_alarm(plc, place, (level, alarm), &image).await;
        }
        let mut questions = writes.questions;
        for (place, output) in image.outputs() {
            let asks = questions.remove(place).map(|(_, asked)| asked);
            self.ask(flags, output, asks, &image);
        }
        for (output, how) in writes.answers.into_values() {
            flags.answer(&output, how);
        }
    }

    /// Raises an alarm if its level is on and the alarm is not active.
    async fn set_alarm(
        &mut self,
        plc: &Plc,
        (cs, number): (Option<CoordinateSystemNumber>, u16),
        (level, alarm): (bool, Alarm),
        image: &Image,
    ) {
        let known = self.alarms.entry((cs, number)).or_default();
        let active = is_active(image.alarms(), cs, number);
        if !known.must_raise(level, active, plc.now_s()) {
            return;
        }
        let raised = match plc.raise(cs, alarm).await {
            Ok(()) | Err(Error::NoAnswer { .. }) => true,
            Err(Error::Refused(refusal)) => {
                self.record_refusal(refusal, image);
                false
            }
            Err(error) => {
                tracing::warn!(%error, number, "an alarm of a scan program was not raised");
                false
            }
        };
        if raised && let Some(known) = self.alarms.get_mut(&(cs, number)) {
            known.raised(plc.now_s());
        }
    }

    /// Asks this question about an output from now on; `None` withdraws the current question.
    fn ask(&mut self, flags: &Flags, output: &AuxOutput, asks: Option<ScanQuestion>, image: &Image) {
        let checked = asks.as_ref().map_or(Ok(()), ScanQuestion::check);
        let asks = asks.filter(|_| checked.is_ok());
        if let Err(refusal) = checked {
            self.record_refusal(refusal, image);
        }
        flags.ask(output, asks);
    }

    /// Sends a request; returns true if the machine has accepted it. A refusal is reported to the next scan,
    /// and logged if it is new.
    async fn request(&mut self, plc: &Plc, request: Request, image: &Image) -> bool {
        let Err(refusal) = plc.port().request_as(plc.name(), request).await else {
            return true;
        };
        self.record_refusal(refusal, image);
        false
    }

    fn record_refusal(&mut self, refusal: Refusal, image: &Image) {
        if !image.refusals().contains(&refusal) {
            tracing::warn!(%refusal, "a scan program was refused");
        }
        self.refusals.push(refusal);
    }
}

/// Validates a write of an input or output against the published messages before the write is sent, because a
/// broker returns no answer to a refused write.
fn check_io_write(flag: &Request, image: &Image) -> Result<(), Refusal> {
    let Request::WriteIo(point, set) = flag else {
        return Ok(());
    };
    if let Some(birth) = image.birth() {
        check_io_declared(&birth.io, point, Some(set.value))?;
    }
    let state = image.io(point);
    state.map_or(Ok(()), |state| {
        check_io_owner(point, state, set.handler_id.as_deref())
    })
}

/// Adds the handler of the scan program as the owner to a write of a lock source, an input or an output.
/// Returns `None` until the machine has accepted the handler.
fn owned(mut flag: Request, plc: &Plc) -> Option<Request> {
    let (handler_id, instance) = match &mut flag {
        Request::Input(_, Input::Interlock(set) | Input::StartLock(set)) => {
            (&mut set.handler_id, &mut set.instance)
        }
        Request::WriteIo(_, set) => (&mut set.handler_id, &mut set.instance),
        _ => return Some(flag),
    };
    let by = plc.levels().owner()?;
    (*handler_id, *instance) = (Some(by.id()), Some(by.instance()));
    Some(flag)
}

/// Returns true if the state of a lock shows the source with the values that were set. A source that is off
/// is shown only while it has an owner.
fn is_source_shown(input: Option<&Lock>, set: &LockSet) -> bool {
    let mut sources = input.iter().flat_map(|input| &input.sources);
    let own = sources.find(|shown| shown.source == set.source() && shown.handler_id == set.handler_id);
    match own {
        Some(shown) => {
            (shown.value, &shown.text) == (set.value, &set.text) && !shown.lost && shown.forced_by.is_none()
        }
        None => !set.value && set.handler_id.is_none(),
    }
}

/// Returns true if the machine has the written value, or if the value is not published (skip inputs).
fn is_in_effect(flag: &Request, image: &Image) -> bool {
    let is_same = |wanted: f64, now: f64| wanted.total_cmp(&now).is_eq();
    match flag {
        Request::Input(cs, input) => match input {
            Input::OptionalSkip(inputs) => {
                let mut inputs = inputs.iter();
                inputs.all(|(number, value)| image.is_optional_skip(*cs, *number) == *value)
            }
            Input::OptionalStop(value) => image.is_optional_stop(*cs) == *value,
            Input::SingleBlock(value) => image.is_single_block(*cs) == *value,
            Input::DryRun(value) => image.is_dry_run(*cs) == *value,
            Input::Interlock(set) => is_source_shown(image.interlock(*cs), set),
            Input::StartLock(set) => is_source_shown(image.start_lock(*cs), set),
            Input::Override(change) => image.overrides(*cs).is_some_and(|now| {
                let is_so = |wanted: Option<f64>, now| wanted.is_none_or(|wanted| is_same(wanted, now));
                is_so(change.feed, now.feed)
                    && is_so(change.rapid, now.rapid)
                    && is_so(change.spindle, now.spindle)
            }),
        },
        Request::Spindle(cs, wanted) => image
            .spindle(*cs)
            .is_some_and(|now| wanted.direction == now.direction && is_same(wanted.rpm, now.rpm)),
        Request::WriteIo(point, set) => image
            .io(point)
            .is_some_and(|now| (now.written, &now.owner, now.lost) == (set.value, &set.handler_id, false)),
        Request::Tool(cs, id) => image.tool(*cs) == Some(*id),
        _ => true,
    }
}

/// Returns the requests that write the variables; consecutive variables share one request.
fn variable_requests(variables: &BTreeMap<(VariableArea, u32), f64>) -> Vec<Request> {
    let mut ranges: Vec<(VariableArea, u32, Vec<f64>)> = Vec::new();
    for (&(area, number), &value) in variables {
        let follows = |(of, from, values): &(VariableArea, u32, Vec<f64>)| {
            *of == area
                && values.len() < VARIABLES_AT_ONCE_MAX
                && usize::try_from(number - from) == Ok(values.len())
        };
        match ranges.last_mut().filter(|range| follows(range)) {
            Some((.., values)) => values.push(value),
            None => ranges.push((area, number, vec![value])),
        }
    }
    let request = |(area, from, values)| Request::WriteVariables {
        area,
        from,
        values,
        meta: None,
    };
    ranges.into_iter().map(request).collect()
}
