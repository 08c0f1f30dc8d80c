//! Runs that a program has ordered: their progress and their end.

use plc_protocol::error::{Error, Result};
use plc_protocol::hub::Filter;
use plc_protocol::types::command::Command;
use plc_protocol::types::message::Payload;
use plc_protocol::types::request::typed;
use plc_protocol::types::run::{Run, RunOrder, RunQuery, Runs};
use plc_protocol::types::topic::{CsTopic, Topic};
use plc_protocol::types::{BootId, CoordinateSystemNumber};

use crate::coordinate_system::CoordinateSystem;

/// A handle to an ordered run. Dropping the handle does not affect the run.
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
    /// Loads a program and runs it once, for one part.
    ///
    /// # Errors
    /// Fails if the command is not allowed now, the program has errors, or a start lock is on.
    pub async fn run(&self, program: u16) -> Result<OrderedRun> {
        self.order(RunOrder::program(program)).await
    }

    /// Loads a program, if the order names one, and runs it once for each part. A further part starts only
    /// after `PROGRAM_COMPLETED`, not after an alarm, a stop, a reset, a lost lease or a restart. While the
    /// interlock or the start lock is on, the start of a further part waits.
    ///
    /// # Errors
    /// Fails as [`CoordinateSystem::run`], and if `parts` is not 1 to 1,000,000.
    pub async fn order(&self, order: RunOrder) -> Result<OrderedRun> {
        let reply = self
            .reply_to(Command::Run(order), self.plc().command_meta().command_id)
            .await?;
        Ok(OrderedRun {
            of: self.clone(),
            id: reply.run_id.unwrap_or_default(),
        })
    }

    /// Returns the run of the loaded program that is in progress, otherwise the last run that has ended.
    /// Returns `None` if no run has started.
    ///
    /// # Errors
    /// Fails if the machine cannot be reached.
    pub async fn newest_run(&self) -> Result<Option<Run>> {
        let topic = Topic::cs(self.number(), CsTopic::Run);
        let message = self.plc().port().read(&topic).await;
        Ok(match message.as_deref().map(|message| &message.payload) {
            Some(Payload::Run(state)) => state.run.clone(),
            _ => None,
        })
    }

    /// Returns ended runs of this coordinate system, the newest first, and its production counters. Skips the
    /// `from` newest runs. Available over REST and in process.
    ///
    /// # Errors
    /// Fails if the machine cannot be reached, or the transport does not carry this request.
    pub async fn runs(&self, from: u32, count: u32) -> Result<Runs> {
        let cs = Some(self.number());
        self.plc()
            .request(typed::Runs(RunQuery { cs, from, count }))
            .await
    }
}

impl OrderedRun {
    /// Returns the identifier of the run, unique across all starts of the runtime.
    pub fn id(&self) -> &str {
        &self.id
    }

    /// Returns the coordinate system of the run.
    pub fn coordinate_system(&self) -> CoordinateSystemNumber {
        self.of.number()
    }

    /// Waits until the run has ended, and returns its result. A restart of the runtime also ends the run.
    ///
    /// # Errors
    /// Fails if the machine has ended the connection. Also fails if a later run has started before this
    /// program received the end of this run, and the transport does not carry the request for an earlier run.
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

    /// Returns true if `other` is a later run than this run. The boot `told_in` has published `other`.
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
