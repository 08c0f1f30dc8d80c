//! A run that a program has ordered: its progress and its end.

use crate::coordinate_system::CoordinateSystem;
use crate::error::{Error, Result};
use crate::hub::Filter;
use crate::types::command::Command;
use crate::types::message::Payload;
use crate::types::request::typed;
use crate::types::run::{Run, RunOrder, RunQuery, Runs};
use crate::types::topic::{CsTopic, Topic};
use crate::types::{BootId, CoordinateSystemNumber};

/// A run that was ordered. Dropping it changes nothing.
///
/// ```no_run
/// # async fn example(plc: plc_api::Plc) -> plc_api::Result<()> {
/// let mill = plc.coordinate_system(1);
/// let end = mill.run(1).await?.ended().await?;
/// println!("{} of {} parts in {} s", end.parts_done, end.parts, end.took_s);
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone)]
pub struct OrderedRun {
    of: CoordinateSystem,
    id: String,
}

impl CoordinateSystem {
    /// Loads a program and starts it: one part.
    ///
    /// # Errors
    /// Not allowed now, the program has errors, or a start lock is on.
    pub async fn run(&self, program: u16) -> Result<OrderedRun> {
        self.order(RunOrder::program(program)).await
    }

    /// Loads a program, if one is named, and runs it once for each part. A part after the first begins after
    /// `PROGRAM_COMPLETED` alone: not after an alarm, a stop, a reset, a lost lease or a restart. While the interlock or the
    /// start lock is on, it waits.
    ///
    /// # Errors
    /// As [`CoordinateSystem::run`]; `parts` is not 1 to 1,000,000.
    pub async fn order(&self, order: RunOrder) -> Result<OrderedRun> {
        let reply = self
            .reply_to(Command::Run(order), self.plc().command_meta().command_id)
            .await?;
        Ok(OrderedRun {
            of: self.clone(),
            id: reply.run_id.unwrap_or_default(),
        })
    }

    /// Returns the run of the loaded program in progress, or the last one that ended; `None` if there was none.
    ///
    /// # Errors
    /// The machine cannot be reached.
    pub async fn newest_run(&self) -> Result<Option<Run>> {
        let topic = Topic::cs(self.number(), CsTopic::Run);
        let message = self.plc().port().read(&topic).await;
        Ok(match message.as_deref().map(|message| &message.payload) {
            Some(Payload::Run(state)) => state.run.clone(),
            _ => None,
        })
    }

    /// Runs of this coordinate system that have ended, the newest first, but for the `from` newest of them, and its production
    /// counters. Over REST and in process.
    ///
    /// # Errors
    /// The machine cannot be reached, or not over this transport.
    pub async fn runs(&self, from: u32, count: u32) -> Result<Runs> {
        let cs = Some(self.number());
        self.plc()
            .request(typed::Runs(RunQuery { cs, from, count }))
            .await
    }
}

impl OrderedRun {
    /// Names the run, over all starts of the runtime.
    pub fn id(&self) -> &str {
        &self.id
    }

    /// Its coordinate system.
    pub fn coordinate_system(&self) -> CoordinateSystemNumber {
        self.of.number()
    }

    /// Waits until it has ended, and returns how. A restart of the runtime ends it, too.
    ///
    /// # Errors
    /// The machine has ended the connection, or a later run has taken its place before this one was heard to end and the
    /// machine cannot be asked for it over this transport.
    pub async fn ended(&self) -> Result<Run> {
        let topic = Topic::cs(self.of.number(), CsTopic::Run);
        let mut runs = self.of.plc().port().subscribe(Filter::Topics(vec![topic]));
        while let Some(message) = runs.next().await {
            let Payload::Run(state) = &message.payload else {
                continue;
            };
            match &state.run {
                Some(run) if run.id == self.id && run.end.is_some() => return Ok(run.clone()),
                Some(run) if self.is_before(run, &message.boot_id) => {
                    let asked = typed::Run {
                        id: self.id.clone(),
                        wait_s: 0,
                    };
                    return self.of.plc().request(asked).await;
                }
                _ => {}
            }
        }
        Err(Error::Closed)
    }

    /// True when a run that is told of in a boot is a later one.
    fn is_before(&self, other: &Run, told_in: &BootId) -> bool {
        let parts = |id: &str| {
            let (place, n) = id.rsplit_once('-')?;
            Some((place.to_owned(), n.parse::<u64>().ok()?))
        };
        match (parts(&self.id), parts(&other.id)) {
            (Some((place, n)), Some((of_place, of))) if place == of_place => n < of,
            _ => !self.id.starts_with(&told_in.0),
        }
    }
}
