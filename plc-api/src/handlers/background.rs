//! Parts of a sequence program that serve no M code: alarms that follow a level, and tasks. These parts start
//! again at each boot of the machine.

use std::future::{Future, pending};
use std::panic::AssertUnwindSafe;
use std::sync::Arc;

use futures_util::FutureExt;
use plc_protocol::alarm::Alarm;
use plc_protocol::error::{Error, Result};
use plc_protocol::hub::{Filter, Subscription};
use plc_protocol::port::{BoxFuture, RETRY};
use plc_protocol::supervisor::panic_text;
use plc_protocol::types::message::{Message, Payload};
use plc_protocol::types::topic::Topic;
use plc_protocol::types::{BootId, CoordinateSystemNumber};
use tokio::sync::watch;

use super::SequenceProgram;
use crate::alarm_level::{AlarmLevel, SHOWN_WITHIN, is_active};
use crate::plc::Plc;

impl<Scope> SequenceProgram<Scope> {
    /// Raises an alarm when a level turns true. Within
    /// [`in_coordinate_system`](SequenceProgram::in_coordinate_system), this is an alarm of that coordinate
    /// system, otherwise of the whole machine. The alarm stays active until a reset, even if the level turns
    /// false. If the level is still true after a reset, or at a start of the machine, the alarm is raised
    /// again. The alarm is also raised if the sender of `level` is dropped.
    ///
    /// ```
    /// # use plc_api::{Alarm, SequenceProgram, fake::FakePort};
    /// # use tokio::sync::watch;
    /// # #[tokio::main(flavor = "current_thread")] async fn main() -> plc_api::Result<()> {
    /// # let fake = FakePort::new([1]);
    /// # let plc = fake.plc();
    /// let (air, is_low) = watch::channel(false);
    /// let program = SequenceProgram::new().alarm_while(is_low, Alarm::user(20, "the air pressure is low"));
    /// # tokio::spawn(async move { program.run(&plc).await });
    /// # fake.settle().await;
    /// air.send_replace(true);
    /// # fake.settle().await;
    /// # assert_eq!(fake.plc().alarms().await?[0].text, "the air pressure is low");
    /// # Ok(()) }
    /// ```
    ///
    /// [`SequenceProgram::run`] refuses an alarm that was not created by [`Alarm::user`], or has no text.
    #[must_use]
    pub fn alarm_while(mut self, level: watch::Receiver<bool>, alarm: Alarm) -> Self {
        if alarm.user_code().is_none() || alarm.text.is_empty() {
            self.add_mistake(format!(
                "alarm_while() got alarm {}: make it by Alarm::user, with a text",
                alarm.number
            ));
        }
        let followed = FollowedAlarm {
            cs: self.cs,
            level,
            alarm,
        };
        self.add_companion(move |plc| Box::pin(followed.clone().run(plc)))
    }
}

impl SequenceProgram {
    /// Adds a task that runs together with the handlers, such as a task that reads a sensor. The task starts
    /// when the machine has accepted this program. When the machine or the program ends, the task is dropped
    /// at its current await point. At the next start of the machine the task starts again.
    ///
    /// If the task returns `Ok`, it does not run again until the next start of the machine. A temporary error
    /// of the connection is logged, and the task starts again after one second. Any other error, or a panic,
    /// also ends the sequence program, so that the failure of a task is always noticed. To wait, use
    /// [`Plc::sleep`] or [`Plc::interval`].
    ///
    /// ```
    /// # use plc_api::{SequenceProgram, fake::FakePort};
    /// # use std::time::Duration;
    /// # fn coolant_level() -> f64 { 0.5 }
    /// # #[tokio::main(flavor = "current_thread")] async fn main() -> plc_api::Result<()> {
    /// # let fake = FakePort::new([1]);
    /// # let plc = fake.plc();
    /// let program = SequenceProgram::new().task(|plc| async move {
    ///     let mut second = plc.interval(Duration::from_secs(1));
    ///     loop {
    ///         second.tick().await;
    ///         plc.variables().set(200, coolant_level()).await?;
    ///     }
    /// });
    /// # tokio::spawn(async move { program.run(&plc).await });
    /// # fake.advance(Duration::from_millis(10)).await;
    /// # assert_eq!(fake.plc().variables().get(200).await?, 0.5);
    /// # Ok(()) }
    /// ```
    #[must_use]
    pub fn task<F, Work>(self, task: F) -> Self
    where
        F: Fn(Plc) -> Work + Send + Sync + 'static,
        Work: Future<Output = Result<()>> + Send + 'static,
    {
        let task = Task(Arc::new(move |plc| Box::pin(task(plc))));
        self.add_companion(move |plc| Box::pin(task.clone().run(plc)))
    }
}

/// An alarm that is raised while a level is true.
#[derive(Debug, Clone)]
struct FollowedAlarm {
    cs: Option<CoordinateSystemNumber>,
    level: watch::Receiver<bool>,
    alarm: Alarm,
}

/// The boot of the machine that is online, and its active alarms.
#[derive(Default)]
struct Alarms {
    online: Option<BootId>,
    active: Option<Arc<Message>>,
}

impl Alarms {
    fn are_active(&self, cs: Option<CoordinateSystemNumber>, number: u16) -> bool {
        let said = self.active.as_deref();
        let of_boot = said.filter(|message| self.online.as_ref() == Some(&message.boot_id));
        let alarms = match of_boot.map(|message| &message.payload) {
            Some(Payload::AlarmActive(active)) => &*active.alarms,
            _ => &[],
        };
        is_active(alarms, cs, number)
    }
}

impl FollowedAlarm {
    /// Raises the alarm whenever the level requires it; does not return except with an error.
    ///
    /// # Errors
    /// Fails if the machine refuses the alarm.
    async fn run(mut self, plc: Plc) -> Result<()> {
        let topics = vec![Topic::Presence, Topic::AlarmActive];
        let mut messages = plc.port().subscribe(Filter::Topics(topics));
        let (mut alarms, mut state, mut is_sent) = (Alarms::default(), AlarmLevel::default(), true);
        loop {
            let level = !is_sent || *self.level.borrow_and_update();
            let active = alarms.are_active(self.cs, self.alarm.number);
            if alarms.online.is_some() && state.must_raise(level, active, plc.now_s()) {
                self.raise(&plc, is_sent).await?;
                state.raised(plc.now_s());
            }
            tokio::select! {
                biased;
                message = messages.next() => {
                    // no message means that the machine has ended the connection, and the handlers will end
                    // as well
                    let Some(message) = message else { return pending().await };
                    if let Payload::Presence(presence) = &message.payload {
                        let online = presence.online.then(|| message.boot_id.clone());
                        if std::mem::replace(&mut alarms.online, online) != alarms.online {
                            state = AlarmLevel::default();
                        }
                    } else {
                        alarms.active = Some(message);
                    }
                }
                changed = self.level.changed(), if is_sent => is_sent = changed.is_ok(),
                () = plc.sleep(SHOWN_WITHIN), if matches!(state, AlarmLevel::Raised { .. }) => {}
            }
        }
    }

    /// Raises the alarm. If the sender of the level has ended (`is_sent` is false), the text states that the level is
    /// unknown.
    ///
    /// # Errors
    /// Fails if the machine refuses the alarm.
    async fn raise(&self, plc: &Plc, is_sent: bool) -> Result<()> {
        let mut alarm = self.alarm.clone();
        if !is_sent {
            alarm.text = format!("{}, or unknown (the program no longer reports it)", alarm.text);
        }
        match plc.raise(self.cs, alarm).await {
            Err(error) if may_pass(&error) => {
                tracing::warn!(%error, number = self.alarm.number, "an alarm is not raised yet");
                Ok(())
            }
            raised => raised,
        }
    }
}

/// A task that runs together with the handlers.
#[derive(Clone)]
struct Task(Arc<dyn Fn(Plc) -> BoxFuture<'static, Result<()>> + Send + Sync>);

impl Task {
    /// Runs the task once in each boot of the machine.
    ///
    /// # Errors
    /// Fails if the task returns an error that is not temporary, or panics.
    async fn run(self, plc: Plc) -> Result<()> {
        let mut presence = plc.port().subscribe(Filter::Topics(vec![Topic::Presence]));
        let mut boot: Option<BootId> = None;
        loop {
            while boot.is_none() {
                boot = wait_for_other_boot(&mut presence, None).await;
            }
            let Some(of) = boot.clone() else { continue };
            tokio::select! {
                biased;
                now = wait_for_other_boot(&mut presence, Some(&of)) => boot = now,
                ended = self.run_until_done(&plc, &of) => {
                    ended?;
                    boot = wait_for_other_boot(&mut presence, Some(&of)).await;
                }
            }
        }
    }

    /// Runs the task until it returns `Ok`; after a temporary error the task starts again.
    ///
    /// # Errors
    /// Fails if the task returns an error that is not temporary, or panics.
    async fn run_until_done(&self, plc: &Plc, boot: &BootId) -> Result<()> {
        loop {
            plc.levels().wait_until_announced(boot).await;
            let work = AssertUnwindSafe(async { (self.0)(plc.clone()).await });
            match work.catch_unwind().await {
                Ok(Err(error)) if may_pass(&error) => {
                    tracing::warn!(%error, "a task of a sequence program is started again");
                    plc.sleep(RETRY).await;
                }
                Ok(Err(error)) => {
                    return Err(Error::SequenceProgram(format!("a task has failed: {error}")));
                }
                Ok(Ok(())) => return Ok(()),
                Err(panicked) => {
                    let text = format!("a task panicked: {}", panic_text(&*panicked));
                    return Err(Error::SequenceProgram(text));
                }
            }
        }
    }
}

/// Waits until a boot other than `than`, or no boot, is online. Returns the boot that is online then.
async fn wait_for_other_boot(presence: &mut Subscription, than: Option<&BootId>) -> Option<BootId> {
    while let Some(message) = presence.next().await {
        if let Payload::Presence(said) = &message.payload {
            let online = said.online.then(|| message.boot_id.clone());
            if online.as_ref() != than {
                return online;
            }
        }
    }
    // the machine has ended the connection, and the handlers will end as well
    pending().await
}

/// Returns true for a temporary error of the connection, after which a retry may succeed.
fn may_pass(error: &Error) -> bool {
    match error {
        Error::Refused(refusal) => refusal.code.may_pass(),
        Error::NoAnswer { .. } => true,
        _ => false,
    }
}
