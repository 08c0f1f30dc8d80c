//! Internal faults: panics in the turn of a coordinate system, at rest and in motion.

use std::sync::atomic::{AtomicU32, Ordering::SeqCst};

use plc_protocol::types::command::CommandStatus;
use plc_protocol::types::lock::LockSet;
use plc_protocol::types::state::{Reason, State};
use plc_protocol::types::upload::ProgramCondition;
use tandem_model::alarm::{FAULT_LASTS, RUNTIME_FAULT};
use tandem_store::program_store::StoredProgram;

use super::*;

/// Number of journal lines that will still panic.
type PendingPanics = Arc<AtomicU32>;

/// Creates a coordinate system. As long as the returned number is above 0, each journal line panics and reduces it.
fn with_faults() -> (Arc<Mailbox>, Servo, PendingPanics) {
    let faults = PendingPanics::default();
    let left = Arc::clone(&faults);
    let sink = Arc::new(std::sync::Mutex::new(
        move |_line: &tandem_store::journal::Line| -> bool {
            let is_due = left
                .fetch_update(SeqCst, SeqCst, |left| left.checked_sub(1))
                .is_ok();
            assert!(!is_due, "an injected fault");
            true
        },
    ));
    let (mailbox, servo) = mailbox(Journal::to_sink(sink));
    (mailbox, servo, faults)
}

fn command(command: Command, id: &str) -> CoordinateSystemRequest {
    let meta = CommandMeta {
        command_id: id.into(),
        client_id: "test".into(),
        ..CommandMeta::default()
    };
    CoordinateSystemRequest::Command {
        command,
        meta,
        wait: true,
    }
}

/// Machine whose time advances by servo cycles.
struct SteppedMachine {
    mailbox: Arc<Mailbox>,
    servo: Servo,
    cycles: u64,
}

impl SteppedMachine {
    fn run(&mut self, cycles: u64) {
        for _ in 0..cycles {
            self.servo.cycle();
            self.cycles += 1;
            self.mailbox.shared.clock.set_ns(self.cycles * 1_000_000);
            self.mailbox.work_as_task();
        }
    }

    fn x(&self) -> f64 {
        self.servo.channel(0).setpoint().0[0]
    }

    fn speed(&mut self) -> f64 {
        let before = self.x();
        self.run(1);
        (self.x() - before).abs() * 1000.0
    }

    /// Sends a command and advances the time by this number of cycles.
    fn ask(&mut self, verb: Command, id: &str, cycles: u64) -> Result<Answer, Refusal> {
        let mailbox = Arc::clone(&self.mailbox);
        let urgent = verb.is_urgent();
        let mut asked = Box::pin(mailbox.ask(command(verb, id), urgent));
        for _ in 0..cycles {
            if let Some(answer) = (&mut asked).now_or_never() {
                return answer;
            }
            self.run(1);
        }
        panic!("{id} is not answered within {cycles} cycles");
    }

    fn state(&self) -> State {
        let message = self
            .mailbox
            .shared
            .hub
            .read(&Topic::cs(1, CsTopic::State))
            .unwrap();
        match &message.payload {
            Payload::State(state) => state.clone(),
            other => panic!("{other:?}"),
        }
    }

    fn word(&self) -> (Execution, Option<Reason>) {
        let state = self.state();
        (state.execution, state.reason)
    }

    fn active(&self) -> Vec<u16> {
        match &self.mailbox.shared.hub.read(&Topic::AlarmActive).unwrap().payload {
            Payload::AlarmActive(active) => active.alarms.iter().map(|alarm| alarm.number).collect(),
            other => panic!("{other:?}"),
        }
    }
}

fn machine() -> (SteppedMachine, PendingPanics) {
    let (mailbox, servo, faults) = with_faults();
    let mut machine = SteppedMachine {
        mailbox,
        servo,
        cycles: 0,
    };
    machine.run(1);
    (machine, faults)
}

/// Number of cycles within which the servo must stop X after a command that raises the fault.
const BRAKING_CYCLES: u64 = 250;

/// Moves X by manual data input.
fn move_x(machine: &mut SteppedMachine, text: &str) {
    let request = CoordinateSystemRequest::Command {
        command: Command::Mdi {
            text: text.to_owned(),
            is_macro: false,
        },
        meta: CommandMeta {
            command_id: "mdi".into(),
            client_id: "test".into(),
            ..CommandMeta::default()
        },
        wait: false,
    };
    let mailbox = Arc::clone(&machine.mailbox);
    let mut asked = Box::pin(mailbox.ask(request, false));
    assert_eq!((&mut asked).now_or_never(), None);
    machine.run(500);
    assert!(matches!(asked.now_or_never(), Some(Ok(_))));
}

#[test]
fn p11_panic_in_motion_brakes_on_the_path_and_reset_recovers() {
    for text in ["G01 X200 Y100 F6000", "G00 X200", "G02 X200 Y0 I100 F6000"] {
        let (mut machine, faults) = machine();
        move_x(&mut machine, text);
        assert!(machine.speed() > 5.0, "{text}: it moves");
        let stood = machine.x();
        faults.store(1, SeqCst);
        // a hold writes a line of the journal, which panics; the mailbox then repeats the request
        let held = machine.ask(Command::Hold, "hold", BRAKING_CYCLES);
        assert!(matches!(held, Ok(Answer::Command(_))), "{text}: {held:?}");
        machine.run(BRAKING_CYCLES);
        let rests = machine.x();
        assert!(machine.speed().abs() < 1e-9, "{text}");
        assert!(rests - stood < 45.0, "{text}: {stood} {rests}");
        assert_eq!(
            machine.word(),
            (Execution::Stopped, Some(Reason::Alarm)),
            "{text}"
        );
        assert_eq!(machine.active(), [RUNTIME_FAULT.number], "{text}");
        machine.run(2000);
        assert!(
            (machine.x() - rests).abs() < 1e-9,
            "{text}: nothing moves any more"
        );
        for (verb, id) in [
            (Command::Stop, "stop"),
            (Command::Abort, "abort"),
            (Command::Hold, "h2"),
        ] {
            assert!(
                matches!(machine.ask(verb, id, 10), Ok(Answer::Command(_))),
                "{id}"
            );
        }
        let start = machine.ask(
            Command::Mdi {
                text: "G00 X0".into(),
                is_macro: false,
            },
            "too early",
            10,
        );
        assert_eq!(
            start.map_err(|refusal| refusal.code),
            Err(RefusalCode::NotAllowed)
        );
        machine.ask(Command::Reset, "reset", 50).unwrap();
        assert_eq!(machine.active(), [0; 0]);
        let moved = machine.ask(
            Command::Mdi {
                text: "G90 G00 X0 Y0".into(),
                is_macro: false,
            },
            "again",
            9000,
        );
        assert!(matches!(moved, Ok(Answer::Command(reply)) if reply.status == CommandStatus::Done));
        assert!(machine.x().abs() < 1e-9);
    }
}

fn mdi(text: &str) -> Command {
    Command::Mdi {
        text: text.into(),
        is_macro: false,
    }
}

/// Raises a second fault before a reset, while X moves. The faults persist until the returned number is 0.
fn given_up() -> (SteppedMachine, PendingPanics) {
    let (mut machine, faults) = machine();
    move_x(&mut machine, "G01 X200 F600");
    faults.store(u32::MAX, SeqCst);
    for (verb, id) in [
        (Command::Hold, "hold"),
        (Command::Stop, "stop"),
        (Command::Abort, "abort"),
    ] {
        let answer = machine.ask(verb, id, 10);
        assert!(matches!(answer, Ok(Answer::Command(_))), "{id}: {answer:?}");
    }
    machine.run(BRAKING_CYCLES);
    assert!(machine.speed().abs() < 1e-9);
    assert_eq!(machine.word(), (Execution::Stopped, Some(Reason::Alarm)));
    assert!(machine.active().contains(&FAULT_LASTS.number));
    (machine, faults)
}

#[test]
fn p11_second_panic_keeps_it_stopped_until_a_reset_and_stop_answers() {
    let (mut machine, faults) = given_up();
    for (verb, id) in [(Command::Start, "start"), (mdi("G00 X0"), "m")] {
        let refusal = machine.ask(verb, id, 10).unwrap_err();
        assert_eq!(refusal.code, RefusalCode::Unavailable, "{id}");
        assert!(refusal.text.contains("then reset it"), "{}", refusal.text);
    }
    machine.run(1000);
    assert!(machine.active().contains(&FAULT_LASTS.number));
    let reported = machine.mailbox.shared.supervisor.faults();
    assert_eq!(reported.len(), 1);
    assert_eq!(reported[0].task, "coordinate system 1");
    assert!(!reported[0].consequence.needs_restart());

    faults.store(0, SeqCst);
    let reset = machine.ask(Command::Reset, "reset", 50);
    assert!(matches!(reset, Ok(Answer::Command(_))), "{reset:?}");
    assert_eq!(machine.active(), [0; 0]);
    let moved = machine.ask(mdi("G90 G00 X0 Y0"), "again", 9000);
    assert!(matches!(moved, Ok(Answer::Command(reply)) if reply.status == CommandStatus::Done));
    assert!(machine.x().abs() < 1e-9);
}

#[test]
fn p11_reset_that_fails_keeps_the_alarm_and_a_later_reset_recovers() {
    let (mut machine, faults) = given_up();
    let refusal = machine.ask(Command::Reset, "reset", 50).unwrap_err();
    assert_eq!(refusal.code, RefusalCode::Unavailable);
    assert!(refusal.text.contains("413"), "{}", refusal.text);
    assert!(machine.active().contains(&FAULT_LASTS.number));
    let needs_restart = |machine: &SteppedMachine| {
        let faults = machine.mailbox.shared.supervisor.faults();
        faults[0].consequence.needs_restart()
    };
    assert!(needs_restart(&machine));
    assert!(matches!(
        machine.ask(Command::Stop, "s2", 10),
        Ok(Answer::Command(_))
    ));

    faults.store(0, SeqCst);
    machine.ask(Command::Reset, "r2", 50).unwrap();
    assert_eq!(machine.active(), [0; 0]);
    assert!(!needs_restart(&machine));
    machine.ask(mdi("G90 G00 X0 Y0"), "again", 9000).unwrap();
    assert!(machine.x().abs() < 1e-9);
}

#[test]
fn p11_interlock_set_after_a_second_panic_holds_after_the_reset() {
    let (mut machine, faults) = given_up();
    faults.store(0, SeqCst);
    let set = LockSet {
        value: true,
        text: "the door is open".into(),
        source: Some("door".into()),
        handler_id: None,
        instance: None,
        force: None,
    };
    let mailbox = Arc::clone(&machine.mailbox);
    let interlock = CoordinateSystemRequest::Input(Input::Interlock(set));
    assert_eq!(
        mailbox.ask(interlock, false).now_or_never(),
        Some(Ok(Answer::Done))
    );
    machine.ask(Command::Reset, "reset", 50).unwrap();
    let refused = machine.ask(mdi("G00 X1"), "m", 50).unwrap_err();
    assert_eq!(refused.code, RefusalCode::StartLocked, "{}", refused.text);
}

#[test]
fn p11_panic_cancels_outputs_and_answers_all_callers() {
    let (mut machine, faults) = machine();
    let mailbox = Arc::clone(&machine.mailbox);
    let mut waits = Box::pin(mailbox.ask(
        command(
            Command::Mdi {
                text: "M90".into(),
                is_macro: false,
            },
            "m90",
        ),
        false,
    ));
    assert_eq!((&mut waits).now_or_never(), None);
    machine.run(20);
    let pending = |machine: &SteppedMachine| match &machine
        .mailbox
        .shared
        .hub
        .read(&Topic::cs(1, CsTopic::Pending))
        .unwrap()
        .payload
    {
        Payload::Pending(pending) => pending.outputs.len(),
        other => panic!("{other:?}"),
    };
    let open = pending(&machine);
    faults.store(1, SeqCst);
    let load = machine.ask(
        Command::Mdi {
            text: "G04 P1".into(),
            is_macro: false,
        },
        "raises",
        50,
    );
    machine.run(50);
    assert_eq!(pending(&machine), 0, "{open} was open");
    assert!(waits.now_or_never().is_some(), "the caller has an answer");
    drop(load);
    assert_eq!(machine.word().0, Execution::Stopped);
}

#[test]
fn p11_levels_that_were_set_still_count_after_a_panic() {
    let (mut machine, faults) = machine();
    let set = LockSet {
        value: true,
        text: "the door is open".into(),
        source: Some("door".into()),
        handler_id: None,
        instance: None,
        force: None,
    };
    let mailbox = Arc::clone(&machine.mailbox);
    let interlock = CoordinateSystemRequest::Input(Input::Interlock(set));
    assert_eq!(
        mailbox.ask(interlock, false).now_or_never(),
        Some(Ok(Answer::Done))
    );
    faults.store(1, SeqCst);
    machine.ask(Command::Hold, "hold", 50).unwrap();
    machine.run(10);
    machine.ask(Command::Reset, "reset", 50).unwrap();
    let refused = machine
        .ask(
            Command::Mdi {
                text: "G00 X1".into(),
                is_macro: false,
            },
            "m",
            50,
        )
        .unwrap_err();
    assert_eq!(refused.code, RefusalCode::StartLocked, "{}", refused.text);
}

#[test]
fn p11_failed_task_stops_the_motion_on_its_path_and_cancels_outputs() {
    let (mut machine, faults) = machine();
    move_x(&mut machine, "M90 G01 X200 Y100 F6000");
    assert!(machine.speed() > 5.0, "it moves");
    drop(faults);
    // the task fails outside the work that `work` contains
    let mailbox = Arc::clone(&machine.mailbox);
    let failed = catch_unwind(AssertUnwindSafe(move || {
        let _ended = MailboxCloser(&mailbox);
        panic!("an injected fault");
    }));
    assert!(failed.is_err());
    let stood = machine.servo.channel(0).setpoint();
    machine.run(BRAKING_CYCLES);
    assert!(machine.speed().abs() < 1e-9, "it rests");
    let rests = machine.servo.channel(0).setpoint();
    let [x, y] = [0, 1].map(|axis| rests.0[axis] - stood.0[axis]);
    assert!(x > 0.1 && x < 45.0, "{x}");
    assert!((y - x / 2.0).abs() < 1e-6, "on the path: {x} {y}");
    let pending = machine.mailbox.shared.hub.read(&Topic::cs(1, CsTopic::Pending));
    match &pending.unwrap().payload {
        Payload::Pending(pending) => assert!(pending.outputs.is_empty(), "{pending:?}"),
        other => panic!("{other:?}"),
    }
}

#[test]
fn p11_program_can_be_stored_after_a_second_panic_has_ended_its_run() {
    let (mut machine, faults) = machine();
    let shared = Arc::clone(&machine.mailbox.shared);
    let write = |text: &str| {
        let program = StoredProgram::new(50, text, shared.machine.text_rules());
        let stored = shared.store.store(program, &ProgramCondition::default());
        stored.unwrap().map(|_| ()).map_err(|refusal| refusal.code)
    };
    assert_eq!(write("G01 X200 F600\nM30\n"), Ok(()));
    machine.ask(Command::Load { program: 50 }, "load", 50).unwrap();
    machine.ask(Command::Start, "start", 50).unwrap();
    machine.run(500);
    assert_eq!(write("M30\n"), Err(RefusalCode::ProgramRuns));
    faults.store(u32::MAX, SeqCst);
    machine.ask(Command::Hold, "hold", 10).unwrap();
    machine.run(BRAKING_CYCLES);
    assert!(machine.active().contains(&FAULT_LASTS.number));
    assert_eq!(write("M30\n"), Ok(()));
}
