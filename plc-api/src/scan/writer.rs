//! Carries out after a scan what the scan has written.

use std::collections::BTreeMap;
use std::mem::take;

use super::flags::Flags;
use super::image::Image;
use super::writes::{Level, put};
use crate::plc::Plc;
use crate::types::data::{VARIABLES_AT_ONCE_MAX, VariableArea};
use crate::types::request::{Input, Refusal, Request};

/// Carries out what scans write, one after the other.
#[derive(Debug, Default)]
pub(super) struct Writer {
    /// What was written last and taken by the machine, one for each flag.
    written: Vec<Level>,
    /// What was refused after the scan before.
    refusals: Vec<Refusal>,
}

impl Writer {
    /// What was refused since this was last called.
    pub(super) fn take_refusals(&mut self) -> Vec<Refusal> {
        take(&mut self.refusals)
    }

    /// Carries out what a scan has written: variables, flags and commands, then the answers, so that the next block
    /// sees what was written before its program went on.
    pub(super) async fn carry_out(&mut self, plc: &Plc, flags: &Flags, mut image: Image) {
        let writes = take(&mut image.writes);
        for (output, text, percent) in writes.progress {
            if let Err(error) = output.progress(text, percent).await {
                tracing::debug!(%error, m = output.m(), "progress of a scan program was not taken");
            }
        }
        for request in variable_requests(&writes.variables) {
            self.request(plc, request, &image).await;
        }
        for level in writes.levels {
            if self.written.contains(&level) && is_so(&level, &image) {
                continue;
            }
            if self.request(plc, level.request(), &image).await {
                put(&mut self.written, level);
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
        for (output, how) in writes.answers.into_values() {
            flags.answer(&output, how);
        }
    }

    /// True when the machine has taken it. A refusal is told to the next scan, and to the log when it is a new one.
    async fn request(&mut self, plc: &Plc, request: Request, image: &Image) -> bool {
        let Err(refusal) = plc.port().request(request).await else {
            return true;
        };
        self.refused(refusal, image);
        false
    }

    fn refused(&mut self, refusal: Refusal, image: &Image) {
        if !image.refusals().contains(&refusal) {
            tracing::warn!(%refusal, "a scan program was refused");
        }
        self.refusals.push(refusal);
    }
}

/// True when the machine says that it is as written; of skip inputs it says nothing.
fn is_so(level: &Level, image: &Image) -> bool {
    match level {
        Level::Input(cs, Input::OptionalSkip(inputs)) => {
            let mut inputs = inputs.iter();
            inputs.all(|(number, value)| image.is_optional_skip(*cs, *number) == *value)
        }
        Level::Input(cs, Input::OptionalStop(value)) => image.is_optional_stop(*cs) == *value,
        Level::Input(cs, Input::SingleBlock(value)) => image.is_single_block(*cs) == *value,
        Level::Input(cs, Input::DryRun(value)) => image.is_dry_run(*cs) == *value,
        Level::Input(cs, Input::Interlock(lock)) => image.interlock(*cs) == Some(lock),
        Level::Input(cs, Input::StartLock(lock)) => image.start_lock(*cs) == Some(lock),
        Level::Input(cs, Input::Override(change)) => image.overrides(*cs).is_some_and(|now| {
            let is_so =
                |wanted: Option<f64>, now: f64| wanted.is_none_or(|wanted| wanted.total_cmp(&now).is_eq());
            is_so(change.feed, now.feed)
                && is_so(change.rapid, now.rapid)
                && is_so(change.spindle, now.spindle)
        }),
        Level::Spindle(cs, wanted) => image.spindle(*cs).is_some_and(|now| {
            let (wanted_rpm, now_rpm) = (wanted.rpm, now.rpm);
            wanted.direction == now.direction && wanted_rpm.total_cmp(&now_rpm).is_eq()
        }),
        Level::Tool(cs, id) => image.tool(*cs) == Some(*id),
        Level::SkipInput(..) => true,
    }
}

/// Neighbours are written together, at one moment.
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
