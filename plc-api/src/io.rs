//! Inputs and outputs of the plant, from the point of view of a sequence program.

use plc_protocol::error::{Error, Result};
use plc_protocol::hub::{Filter, Subscription};
use plc_protocol::io_points::{check_io_declared, check_io_owner};
use plc_protocol::types::io::{IoForce, IoPoint, IoState, IoValue, refused};
use plc_protocol::types::message::Payload;
use plc_protocol::types::refusal::RefusalCode;
use plc_protocol::types::request::typed::ForceIo;
use plc_protocol::types::topic::Topic;

use crate::plc::Plc;

/// An input or output of the plant, created by [`Plc::io_in`] or [`Plc::io_out`].
///
/// ```
/// # use plc_api::types::io::{IoDeclaration, IoPoint};
/// use plc_api::{Alarm, AuxOutput, Plc, SequenceProgram};
/// use std::time::Duration;
///
/// /// Opens the valve, and waits until the flow switch reports a flow of coolant.
/// async fn coolant_on(_output: AuxOutput, plc: Plc) -> Result<(), Alarm> {
///     plc.io_out("coolant_valve").set(true).await?;
///     let flow = plc.io_in("coolant_flows");
///     let flows = flow.wait_until(|value| value.is_on());
///     plc.timeout(Duration::from_secs(2), flows).await?;
///     Ok(())
/// }
///
/// # #[tokio::main(flavor = "current_thread")] async fn main() -> plc_api::Result<()> {
/// # let fake = plc_api::fake::FakePort::new([1]);
/// # let plc = fake.plc();
/// # fake.declare_io(IoPoint::output("coolant_valve"), IoDeclaration::new(false));
/// # fake.declare_io(IoPoint::input("coolant_flows"), IoDeclaration::new(false));
/// let program = SequenceProgram::new().on(8, coolant_on);
/// # tokio::spawn(async move { program.run(&plc).await });
/// # fake.settle().await;
/// # let seq = fake.issue_output(1, 8, plc_api::Params::default());
/// # fake.settle().await;
/// # assert!(fake.plc().io_out("coolant_valve").value().await?.is_on());
/// # assert_eq!(fake.closed(1, seq), None);
/// # fake.plc().io_in("coolant_flows").set(true).await?;
/// # fake.settle().await;
/// # assert_eq!(fake.closed(1, seq), Some(plc_api::fake::OutputOutcome::Reset));
/// # Ok(()) }
/// ```
#[derive(Debug, Clone)]
pub struct Io {
    plc: Plc,
    point: IoPoint,
}

impl Plc {
    /// Returns a handle to an input of the plant, by its name in the configuration (`[io.in.NAME]`).
    pub fn io_in(&self, name: impl Into<String>) -> Io {
        self.io(IoPoint::input(name))
    }

    /// Returns a handle to an output of the plant, by its name in the configuration (`[io.out.NAME]`).
    pub fn io_out(&self, name: impl Into<String>) -> Io {
        self.io(IoPoint::output(name))
    }

    /// Returns a handle to an input or output of the plant.
    pub fn io(&self, point: IoPoint) -> Io {
        Io {
            plc: self.clone(),
            point,
        }
    }
}

impl Io {
    /// Returns the side and the name of this input or output.
    pub fn point(&self) -> &IoPoint {
        &self.point
    }

    /// Returns the current value. This is the forced value if an operator has forced a value, otherwise the
    /// value that the owner has written, otherwise the safe value.
    ///
    /// # Errors
    /// Fails if the configuration does not declare the input or output, or the machine has not published its
    /// state yet.
    pub async fn value(&self) -> Result<IoValue> {
        Ok(self.state().await?.value)
    }

    /// Returns the current state: the value, the owner, and whether the value is forced.
    ///
    /// # Errors
    /// Fails as [`value`](Self::value).
    pub async fn state(&self) -> Result<IoState> {
        let said = self.plc.port().read(&self.topic()).await;
        if let Some(Payload::Io(state)) = said.as_deref().map(|message| &message.payload) {
            return Ok(state.clone());
        }
        self.check_declared(None).await?;
        let why = "the machine has not published its state yet";
        Err(refused(RefusalCode::NotFound, &self.point, why).into())
    }

    /// Returns a receiver of the current value, and then of each changed value. If the value changes faster
    /// than the program reads, the program receives only the latest value.
    pub fn changes(&self) -> IoChanges {
        IoChanges {
            messages: self.plc.port().subscribe(Filter::Topics(vec![self.topic()])),
            last: None,
        }
    }

    /// Waits until `is_it` returns true for the value, and returns that value. Returns at once if `is_it` is
    /// true for the current value. For a time limit see [`Plc::timeout`].
    ///
    /// # Errors
    /// Fails if the configuration does not declare the input or output, or the machine has ended the
    /// connection.
    pub async fn wait_until(&self, is_it: impl Fn(IoValue) -> bool) -> Result<IoValue> {
        self.check_declared(None).await?;
        let mut changes = self.changes();
        while let Some(value) = changes.next().await {
            if is_it(value) {
                return Ok(value);
            }
        }
        Err(Error::Closed)
    }

    /// Writes a value. If a sequence program writes the value, this program owns the input or output from
    /// then on. The program writes the value again on every connection and after every start of the machine.
    /// No other sender can write the value while the program is online. After the end of the program the
    /// output takes its safe value. A client without handlers owns nothing, and may write outputs that no
    /// handler owns.
    ///
    /// # Errors
    /// Fails if the configuration does not declare the input or output, the value is of the wrong kind or out
    /// of range, or another handler owns the input or output. In a sequence program the call waits while the
    /// machine cannot be reached.
    pub async fn set(&self, value: impl Into<IoValue>) -> Result<()> {
        let value = value.into();
        self.check_declared(Some(value)).await?;
        // before the machine has accepted this program, the program waits here
        let levels = self.plc.levels();
        let owner = levels.owner();
        if (owner.is_some() || !levels.has_owner())
            && self.plc.is_online().await
            && let Ok(state) = self.state().await
        {
            check_io_owner(&self.point, &state, owner.as_ref().map(|by| &*by.handler_id))?;
        }
        self.plc.set_io(self.point.clone(), value).await
    }

    /// Validates a write against `birth` before it is sent, because a broker returns no answer to a refused
    /// write.
    async fn check_declared(&self, value: Option<IoValue>) -> Result<()> {
        let birth = self.plc.port().read(&Topic::Birth).await;
        match birth.as_deref().map(|message| &message.payload) {
            Some(Payload::Birth(birth)) => Ok(check_io_declared(&birth.io, &self.point, value)?),
            _ => Ok(()),
        }
    }

    /// Forces a value that replaces the written value, as an operator does. Readers receive the forced value
    /// until [`release`](Self::release), regardless of the values that the owner writes. State and journal
    /// name the user who forced the value. A restart of the machine ends the forcing.
    ///
    /// # Errors
    /// Fails if the configuration does not declare the input or output, the value is of the wrong kind or out
    /// of range, or the user has no right to force values.
    pub async fn force(&self, value: impl Into<IoValue>) -> Result<()> {
        self.send_force(Some(value.into())).await
    }

    /// Ends the forcing: the value that the owner has written applies again. No effect if no value is forced.
    ///
    /// # Errors
    /// Fails if the configuration does not declare the input or output, or the user has no right to force
    /// values.
    pub async fn release(&self) -> Result<()> {
        self.send_force(None).await
    }

    async fn send_force(&self, value: Option<IoValue>) -> Result<()> {
        self.check_declared(value).await?;
        let by = Some(self.plc.name().to_owned());
        let force = IoForce { value, by };
        self.plc.request(ForceIo(self.point.clone(), force)).await
    }

    fn topic(&self) -> Topic {
        Topic::Io(self.point.clone())
    }
}

/// Receiver of the values of an input or output of the plant, returned by [`Io::changes`].
#[derive(Debug)]
pub struct IoChanges {
    messages: Subscription,
    last: Option<IoValue>,
}

impl IoChanges {
    /// Waits for the next value and returns it; returns `None` if the machine has ended the connection.
    /// Cancellation safe.
    pub async fn next(&mut self) -> Option<IoValue> {
        loop {
            let message = self.messages.next().await?;
            if let Payload::Io(state) = &message.payload
                && self.last.replace(state.value) != Some(state.value)
            {
                return Some(state.value);
            }
        }
    }
}
