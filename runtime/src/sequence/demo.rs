//! The sequence program of the demo machine: a tool magazine, clamps, coolant, and a meeting of mill and loader. A
//! machine builder replaces it by a program of his own, handler by handler.

use std::sync::Arc;
use std::time::Duration;

use parking_lot::Mutex;
use plc_api::{Alarm, AuxOutput, Plc, SequenceProgram};
use plc_protocol::hub::Filter;
use plc_protocol::types::message::Payload;
use plc_protocol::types::state::{Execution, Reason};
use plc_protocol::types::topic::Topic;
use tokio::sync::oneshot;

/// Number of pockets of the simulated magazine. The first pocket has the number 1.
const POCKETS: u16 = 8;

/// Time in which the magazine turns by one pocket.
const POCKET_TIME: Duration = Duration::from_millis(250);

/// Highest clamping pressure in bar.
const CLAMP_PRESSURE_MAX_BAR: f64 = 80.0;

/// Id of the demo's handlers.
const HANDLER_ID: &str = "demo";

/// Number of the program that is loaded into the mill first: the flange.
const FIRST_PROGRAM: u16 = 4;

/// Waits until the demo's handlers are online, because the check of a program needs them. Then loads the first program
/// into the mill, unless a run was interrupted, whose program stays.
///
/// # Errors
/// Returns an error if the program does not exist or has errors.
pub async fn open_demo(plc: &Plc) -> plc_api::Result<()> {
    let presence = Topic::HandlerPresence(HANDLER_ID.to_owned());
    let mut told = plc.port().subscribe(Filter::Topics(vec![presence]));
    loop {
        match told.next().await.as_deref().map(|message| &message.payload) {
            Some(Payload::HandlerPresence(presence)) if presence.online => break,
            Some(_) => {}
            None => return Ok(()),
        }
    }
    let mill = plc.coordinate_system(1);
    let state = mill.state().await?;
    let is_new = matches!(state.reason, Some(Reason::NoProgram | Reason::Restarted));
    let is_cut_short = mill.last_run().await?.is_some_and(|run| run.is_under_way());
    if state.execution == Execution::Stopped && is_new && !is_cut_short {
        mill.load(FIRST_PROGRAM).await?;
    }
    Ok(())
}

/// Returns the handlers of the demo machine: M08 M09 M10 M11 M70 M80 M100.
pub fn demo_sequence_program() -> SequenceProgram {
    let meeting = Arc::new(Meeting::default());
    let meet = move |output: AuxOutput| meet(output, Arc::clone(&meeting));
    SequenceProgram::new()
        .handler_id(HANDLER_ID)
        .on(8..=9, coolant)
        .on(10, clamp)
        .on(11, release)
        .on(70, meet)
        .on(80, inspect)
        .on(100, change_tool)
}

/// M100 VA: turns the magazine to the pocket of tool VA and changes the tool.
async fn change_tool(output: AuxOutput, plc: Plc) -> Result<(), Alarm> {
    let wanted = output
        .params()
        .a()
        .ok_or(Alarm::user(1, "the tool change (M100) needs VA: the tool number"))?;
    let pocket = (1..=POCKETS)
        .find(|pocket| (f64::from(*pocket) - wanted).abs() < 1e-9)
        .ok_or_else(|| {
            Alarm::user(
                2,
                format!("the magazine has no tool {wanted}; it has 1 to {POCKETS}"),
            )
        })?;
    let system = plc.coordinate_system(output.coordinate_system());
    let now = system.tool().await?.id;
    let away = now.abs_diff(pocket);
    let turns = away.min(POCKETS - away).max(1);
    for turn in 0..turns {
        let percent = f64::from(turn) / f64::from(turns + 1) * 100.0;
        output
            .progress(format!("the magazine turns to pocket {pocket}"), percent)
            .await?;
        plc.sleep(POCKET_TIME).await;
    }
    output
        .progress(format!("the arm swaps tool {now} for tool {pocket}"), 80.0)
        .await?;
    plc.sleep(Duration::from_millis(700)).await;
    system.select_tool(pocket).await?;
    Ok(())
}

/// M10 VA VB: closes clamp VA with a pressure of VB bar.
async fn clamp(output: AuxOutput, plc: Plc) -> Result<(), Alarm> {
    let clamp = output
        .params()
        .a()
        .ok_or(Alarm::user(10, "clamping (M10) needs VA: the clamp"))?;
    let pressure_bar = output.params().b().unwrap_or(30.0);
    if !(0.0..=CLAMP_PRESSURE_MAX_BAR).contains(&pressure_bar) {
        let text = format!("clamp {clamp}: {pressure_bar} bar is outside 0 to {CLAMP_PRESSURE_MAX_BAR} bar");
        return Err(Alarm::user(11, text));
    }
    output
        .progress(format!("clamp {clamp} closes with {pressure_bar} bar"), None)
        .await?;
    plc.sleep(Duration::from_millis(600)).await;
    Ok(())
}

/// M11 VA: opens clamp VA.
async fn release(output: AuxOutput, plc: Plc) -> Result<(), Alarm> {
    let clamp = output.params().a().unwrap_or(1.0);
    output.progress(format!("clamp {clamp} opens"), None).await?;
    plc.sleep(Duration::from_millis(400)).await;
    Ok(())
}

/// M08 switches the coolant on, M09 switches it off. The motion continues in the meantime.
async fn coolant(_output: AuxOutput, plc: Plc) -> Result<(), Alarm> {
    plc.sleep(Duration::from_millis(200)).await;
    Ok(())
}

/// Meeting point of two coordinate systems. The first handler to arrive leaves a sender for the second. If the first
/// handler is cancelled while it waits, its receiver is dropped, so the second handler then waits itself.
#[derive(Debug, Default)]
struct Meeting(Mutex<Option<oneshot::Sender<()>>>);

impl Meeting {
    async fn meet(&self) {
        loop {
            let first = self.0.lock().take();
            if first.is_some_and(|first| first.send(()).is_ok()) {
                return;
            }
            let (signal, other) = oneshot::channel();
            *self.0.lock() = Some(signal);
            if other.await.is_ok() {
                return;
            }
        }
    }
}

/// M70: mill and loader meet. Both programs continue when both have arrived.
async fn meet(output: AuxOutput, meeting: Arc<Meeting>) -> Result<(), Alarm> {
    let other = if output.coordinate_system() == 1 {
        "the loader"
    } else {
        "the mill"
    };
    output.progress(format!("waits for {other}"), None).await?;
    meeting.meet().await;
    Ok(())
}

/// M80: an operator inspects the part and answers the question.
async fn inspect(output: AuxOutput) -> Result<(), Alarm> {
    let (good, bad) = ("Good", "Not good: stop");
    let answer = output.ask("Are all eight holes good?", [good, bad]).await?;
    if answer == bad {
        return Err(Alarm::user(80, "the operator has found bad holes"));
    }
    Ok(())
}
