//! Inputs and outputs of the plant, from the point of view of a sequence program.

use crate::error::{Error, Result};
use crate::hub::{Filter, Subscription};
use crate::io_points::{judge_declared, judge_owner};
use crate::plc::Plc;
use crate::types::io::{IoForce, IoPoint, IoState, IoValue, refused};
use crate::types::message::Payload;
use crate::types::refusal::RefusalCode;
use crate::types::request::typed::ForceIo;
use crate::types::topic::Topic;

/// An input or output of the plant: [`Plc::io_in`] and [`Plc::io_out`].
///
/// ```
/// # use plc_api::types::io::{IoDeclaration, IoPoint};
/// use plc_api::{Alarm, AuxOutput, Plc, SequenceProgram};
/// use std::time::Duration;
///
/// /// Opens the valve, and waits until the flow switch tells that coolant flows.
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
/// # let seq = fake.put_out(1, 8, plc_api::Params::default());
/// # fake.settle().await;
/// # assert!(fake.plc().io_out("coolant_valve").value().await?.is_on());
/// # assert_eq!(fake.closed(1, seq), None);
/// # fake.plc().io_in("coolant_flows").set(true).await?;
/// # fake.settle().await;
/// # assert_eq!(fake.closed(1, seq), Some(plc_api::handshake::Closed::Reset));
/// # Ok(()) }
/// ```
#[derive(Debug, Clone)]
pub struct Io {
    plc: Plc,
    point: IoPoint,
}

impl Plc {
    /// An input of the plant, by its name in the configuration (`[io.in.NAME]`).
    pub fn io_in(&self, name: impl Into<String>) -> Io {
        self.io(IoPoint::input(name))
    }

    /// An output of the plant, by its name in the configuration (`[io.out.NAME]`).
    pub fn io_out(&self, name: impl Into<String>) -> Io {
        self.io(IoPoint::output(name))
    }

    /// An input or output of the plant.
    pub fn io(&self, point: IoPoint) -> Io {
        Io {
            plc: self.clone(),
            point,
        }
    }
}

impl Io {
    /// Which it is.
    pub fn point(&self) -> &IoPoint {
        &self.point
    }

    /// Returns the current value: the forced value, otherwise the value that its owner has written, otherwise its safe
    /// value.
    ///
    /// # Errors
    /// Fails if the configuration does not declare it, or the machine has not published it yet.
    pub async fn value(&self) -> Result<IoValue> {
        Ok(self.state().await?.value)
    }

    /// Returns the current state: the value with its owner, and whether it is forced.
    ///
    /// # Errors
    /// As [`value`](Self::value).
    pub async fn state(&self) -> Result<IoState> {
        let said = self.plc.port().read(&self.topic()).await;
        if let Some(Payload::Io(state)) = said.as_deref().map(|message| &message.payload) {
            return Ok(state.clone());
        }
        self.judge(None).await?;
        let why = "the machine has not told of it yet";
        Err(refused(RefusalCode::NotFound, &self.point, why).into())
    }

    /// Its value now, and then each other one. If it changes faster than it is read, only the latest value is.
    pub fn changes(&self) -> IoChanges {
        IoChanges {
            messages: self.plc.port().subscribe(Filter::Topics(vec![self.topic()])),
            last: None,
        }
    }

    /// Waits for a value for which `is_it` is true, and returns it. One that has it now is not waited for. To wait no longer than a
    /// time: [`Plc::timeout`].
    ///
    /// # Errors
    /// The configuration does not declare it, or the machine has ended the connection.
    pub async fn wait_until(&self, is_it: impl Fn(IoValue) -> bool) -> Result<IoValue> {
        self.judge(None).await?;
        let mut changes = self.changes();
        while let Some(value) = changes.next().await {
            if is_it(value) {
                return Ok(value);
            }
        }
        Err(Error::Closed)
    }

    /// Writes a value. While a sequence program runs, the output then belongs to that program: it is written again on
    /// every connection and after every start of the machine, no other sender writes it while the program is online,
    /// and it takes its safe value after the program has ended. A client without handlers owns nothing: it may write
    /// outputs that no handler owns.
    ///
    /// # Errors
    /// The configuration does not declare it, the value is not of its kind or out of its range, or it is another handler's. While
    /// a sequence program serves the machine, one that cannot be reached is waited for.
    pub async fn set(&self, value: impl Into<IoValue>) -> Result<()> {
        let value = value.into();
        self.judge(Some(value)).await?;
        // a program that the machine does not know yet waits until it does
        let levels = self.plc.levels();
        let owner = levels.owner();
        if (owner.is_some() || !levels.has_owner())
            && self.plc.is_online().await
            && let Ok(state) = self.state().await
        {
            judge_owner(&self.point, &state, owner.as_ref().map(|by| &*by.handler_id))?;
        }
        self.plc.set_io(self.point.clone(), value).await
    }

    /// Validates a write against `birth` before it is sent, because a broker returns no answer to a refused write.
    async fn judge(&self, value: Option<IoValue>) -> Result<()> {
        let birth = self.plc.port().read(&Topic::Birth).await;
        match birth.as_deref().map(|message| &message.payload) {
            Some(Payload::Birth(birth)) => Ok(judge_declared(&birth.io, &self.point, value)?),
            _ => Ok(()),
        }
    }

    /// Forces a value that replaces the written one, as an operator does: readers receive it until
    /// [`release`](Self::release), regardless of the owner's writes. State and journal name the user who forced it. A
    /// restart of the machine ends the forcing.
    ///
    /// # Errors
    /// The configuration does not declare it, the value is not of its kind or out of its range, or the user may not do it.
    pub async fn force(&self, value: impl Into<IoValue>) -> Result<()> {
        self.put_in_place(Some(value.into())).await
    }

    /// Takes a forced value back: what its owner has written counts again. No effect if it is not forced.
    ///
    /// # Errors
    /// The configuration does not declare it, or the user may not do it.
    pub async fn release(&self) -> Result<()> {
        self.put_in_place(None).await
    }

    async fn put_in_place(&self, value: Option<IoValue>) -> Result<()> {
        self.judge(value).await?;
        let by = Some(self.plc.name().to_owned());
        let force = IoForce { value, by };
        self.plc.request(ForceIo(self.point.clone(), force)).await
    }

    fn topic(&self) -> Topic {
        Topic::Io(self.point.clone())
    }
}

/// Values of an input or output of the plant: [`Io::changes`].
#[derive(Debug)]
pub struct IoChanges {
    messages: Subscription,
    last: Option<IoValue>,
}

impl IoChanges {
    /// The next value; `None` when the machine has ended the connection. Cancellation safe.
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
