//! Changes of variables, tools and work offsets, as the machine publishes them.

use std::collections::BTreeMap;
use std::fmt;

use plc_protocol::error::{Error, Result};
use plc_protocol::hub::{Filter, Subscription};
use plc_protocol::types::data::{
    JsonNumber, PublishedVariables, ToolData, VARIABLES_AT_ONCE_MAX, VariableKind,
};
use plc_protocol::types::message::Payload;
use plc_protocol::types::refusal::{Refusal, RefusalCode};
use plc_protocol::types::topic::{CsTopic, Topic};

use crate::coordinate_system::CoordinateSystem;
use crate::plc::Plc;
use crate::variables::Variables;

/// Function that returns the value in a message, or `None` if the message does not contain the value.
type Read<T> = Box<dyn Fn(&Payload) -> Option<T> + Send + Sync>;

/// The current value of machine data, followed by each changed value. [`Variables::changes`], for example,
/// returns this type.
pub struct Changes<T> {
    messages: Subscription,
    read: Read<T>,
    is_same: fn(&T, &T) -> bool,
    last: Option<T>,
}

impl<T> fmt::Debug for Changes<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Changes").finish_non_exhaustive()
    }
}

impl<T: Clone> Changes<T> {
    fn new(
        plc: &Plc,
        topic: Topic,
        read: impl Fn(&Payload) -> Option<T> + Send + Sync + 'static,
        is_same: fn(&T, &T) -> bool,
    ) -> Self {
        Self {
            messages: plc.port().subscribe(Filter::Topics(vec![topic])),
            read: Box::new(read),
            is_same,
            last: None,
        }
    }

    /// Waits for the next value and returns it; returns `None` if the machine has ended the connection. If
    /// the values change faster than the program reads, the program receives only the latest value.
    /// Cancellation safe.
    pub async fn next(&mut self) -> Option<T> {
        loop {
            let message = self.messages.next().await?;
            let Some(value) = (self.read)(&message.payload) else {
                continue;
            };
            let is_known = self
                .last
                .as_ref()
                .is_some_and(|last| (self.is_same)(last, &value));
            if !is_known {
                self.last = Some(value.clone());
                return Some(value);
            }
        }
    }
}

impl Variables {
    /// Returns the values of `count` variables (1 to 1024) from number `from` on: first the current values,
    /// then all values again each time that any writer has changed one of them. A machine publishes the
    /// variables that `[[variables.published]]` of its configuration contains, at most 10 times a second. If
    /// the values change faster, only the latest values are published.
    ///
    /// An NC program writes a variable when the interpreter reaches the block, ahead of the motion (D16).
    ///
    /// ```
    /// # use plc_api::types::data::VariableArea;
    /// # #[tokio::main(flavor = "current_thread")] async fn main() -> plc_api::Result<()> {
    /// # let fake = plc_api::fake::FakePort::new([1]);
    /// # fake.publish_variables(VariableArea::Global, 200, 2);
    /// # let plc = fake.plc();
    /// let mut parts = plc.variables().changes(200, 2).await?;
    /// assert_eq!(parts.next().await, Some(vec![0.0, 0.0]));
    /// plc.variables().set(201, 5.0).await?;
    /// assert_eq!(parts.next().await, Some(vec![0.0, 5.0]));
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// Fails if the machine does not publish all these variables.
    pub async fn changes(&self, from: u32, count: u32) -> Result<Changes<Vec<f64>>> {
        let topic = self.topic();
        let said = self.plc().port().read(&topic).await;
        if let Some(Payload::Variables(published)) = said.as_deref().map(|message| &message.payload) {
            self.check_published(published, from, count)?;
        }
        let read = move |payload: &Payload| match payload {
            Payload::Variables(published) => published.values(from, count),
            _ => None,
        };
        let is_same: fn(&Vec<f64>, &Vec<f64>) -> bool = |one, other| {
            let numbers = |values: &[f64]| values.iter().copied().map(JsonNumber).collect::<Vec<_>>();
            numbers(one) == numbers(other)
        };
        Ok(Changes::new(self.plc(), topic, read, is_same))
    }

    /// Waits until `is_it` returns true for the value of a published variable, and returns that value.
    /// Returns at once if `is_it` is true for the current value. For a time limit see [`Plc::timeout`].
    ///
    /// # Errors
    /// Fails as [`changes`](Self::changes), and if the machine has ended the connection.
    pub async fn wait_until(&self, number: u32, is_it: impl Fn(f64) -> bool) -> Result<f64> {
        let mut changes = self.changes(number, 1).await?;
        while let Some(values) = changes.next().await {
            if let Some(value) = values.first().copied().filter(|value| is_it(*value)) {
                return Ok(value);
            }
        }
        Err(Error::Closed)
    }

    fn check_published(&self, published: &PublishedVariables, from: u32, count: u32) -> Result<()> {
        if count as usize <= VARIABLES_AT_ONCE_MAX && published.values(from, count).is_some() {
            return Ok(());
        }
        let letter = match self.area().kind() {
            VariableKind::P => "P",
            VariableKind::Q => "Q",
        };
        let which = match count {
            1 => format!("{letter}{from} is"),
            _ => format!("{count} variables from {letter}{from} on are"),
        };
        let text = format!(
            "{which} not published by this machine: name them in its configuration, such as [[variables.published]] from = \"{letter}{from}\", count = {count}"
        );
        Err(Refusal::new(RefusalCode::NotFound, text).into())
    }

    fn topic(&self) -> Topic {
        match self.area().coordinate_system() {
            None => Topic::Variables,
            Some(cs) => Topic::cs(cs, CsTopic::Variables),
        }
    }
}

impl Plc {
    /// Returns the tool table, ascending by number: the current table, and then each changed table.
    pub fn tool_changes(&self) -> Changes<Vec<ToolData>> {
        let read = |payload: &Payload| match payload {
            Payload::Tools(table) => Some(table.tools.clone()),
            _ => None,
        };
        Changes::new(self, Topic::Tools, read, |one, other| one == other)
    }
}

impl CoordinateSystem {
    /// Returns the work offsets `G54` to `G59`, each with its value by axis letter, mm or degrees: the
    /// current offsets, and then all offsets again each time that one of them has changed.
    pub fn work_offset_changes(&self) -> Changes<BTreeMap<String, BTreeMap<String, f64>>> {
        let read = |payload: &Payload| match payload {
            Payload::WorkOffsets(offsets) => Some(offsets.work_offsets.clone()),
            _ => None,
        };
        let topic = Topic::cs(self.number(), CsTopic::WorkOffsets);
        Changes::new(self.plc(), topic, read, |one, other| one == other)
    }
}
