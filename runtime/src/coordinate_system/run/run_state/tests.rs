//! Tests of each state with each command against the table of the interface, and of random events.

use plc_protocol::execution::{Situation, wire_name};
use plc_protocol::types::command::Verb;
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

use super::super::causes::JogStop;
use super::*;

/// State of a run without data; a number stands for the data of a run that was ended early.
type RunState = super::RunState<(), u8>;
type RunEvent = super::RunEvent<(), u8>;
type RunAction = super::RunAction<(), u8>;

const EPOCH: u32 = 7;

fn after(state: RunState, events: impl IntoIterator<Item = RunEvent>) -> RunState {
    events.into_iter().fold(state, |state, event| state.on(event).0)
}

fn end(why: EarlyEndCause) -> RunEvent {
    RunEvent::End {
        why,
        epoch: EPOCH,
        remainder: 1,
    }
}

fn started() -> RunEvent {
    RunEvent::Started {
        phase: Phase::Interpret,
        run: (),
    }
}

fn stop_at(optional: bool) -> Phase {
    Phase::Paused(ProgramStop {
        optional,
        origin: Origin::default(),
    })
}

fn awaited(is_lost: bool) -> RunEvent {
    RunEvent::Awaited(Some(AwaitedOutput { seq: 3, is_lost }))
}

/// Returns the state after the machine has come to rest, if a transition is in progress.
fn at_rest(state: RunState) -> RunState {
    let events = match state.transition() {
        Some(Transition::Holding) => Some(RunEvent::ServoHeld { behind_block: false }),
        Some(_) => Some(RunEvent::AtRest { epoch: EPOCH }),
        None => None,
    };
    after(state, events)
}

/// Formats a state word such as `FEED_HOLD BUS_LOST`.
fn words((execution, reason): StateWord) -> String {
    let reason = reason.map(|reason| format!(" {}", wire_name(&reason)));
    format!("{}{}", wire_name(&execution), reason.unwrap_or_default())
}

/// Returns the run state with this state word and reason.
fn state(words: &str) -> RunState {
    let idle = RunState::Idle((Execution::Ready, None));
    let under_way = || after(idle.clone(), [started()]);
    let held = |cause| at_rest(after(under_way(), [RunEvent::Hold(cause)]));
    let ended = |why| at_rest(after(under_way(), [end(why)]));
    let back = || after(held(Cause::Operator), [RunEvent::BackTrace { to: 9 }]);
    match words {
        "READY" => idle,
        "ACTIVE" => under_way(),
        "ACTIVE BACK_TRACE" => back(),
        "WAIT" => after(
            under_way(),
            [RunEvent::Phase(Phase::Reset { seq: 3 }), awaited(false)],
        ),
        "WAIT HANDLER_LOST" => after(under_way(), [RunEvent::Phase(Phase::LastOutputs), awaited(true)]),
        "FEED_HOLD" => held(Cause::Operator),
        "FEED_HOLD BUS_LOST" => held(Cause::BusLoss),
        "FEED_HOLD BACK_TRACE" => at_rest(after(back(), [RunEvent::Hold(Cause::Operator)])),
        "FEED_HOLD BACK_TRACE_END" => at_rest(after(back(), [RunEvent::Passed { segment: 9 }])),
        "PROGRAM_STOPPED" => after(under_way(), [RunEvent::Phase(stop_at(false))]),
        "OPTIONAL_STOP" => after(under_way(), [RunEvent::Phase(stop_at(true))]),
        "INTERRUPTED SINGLE_BLOCK" => after(under_way(), [RunEvent::BlockEnded]),
        "INTERRUPTED INTERLOCK" => held(Cause::Interlock),
        "STOPPED ALARM" => ended(EarlyEndCause::Alarm),
        "STOPPED STOP" => ended(EarlyEndCause::Stop),
        "STOPPED ABORTED" => ended(EarlyEndCause::Abort),
        "STOPPED NO_PROGRAM" => ended(EarlyEndCause::Reset { has_program: false }),
        "STOPPED RESTARTED" => RunState::Idle((Execution::Stopped, Some(Reason::Restarted))),
        "PROGRAM_COMPLETED" => after(under_way(), [RunEvent::Completed(Execution::ProgramCompleted)]),
        _ => panic!("{words} is no state"),
    }
}

const COMMANDS: [Verb; 9] = [
    Verb::Load,
    Verb::Start,
    Verb::Hold,
    Verb::Resume,
    Verb::BackTrace,
    Verb::Stop,
    Verb::Abort,
    Verb::Reset,
    Verb::Mdi,
];

/// State after each of [`COMMANDS`] and the rest of the machine: `-` is a refusal, `=` is no change.
#[rustfmt::skip]
const TABLE: [(&str, [&str; 9]); 19] = [
    ("READY", ["READY", "ACTIVE", "=", "-", "-", "=", "=", "READY", "ACTIVE"]),
    ("ACTIVE", ["-", "-", "FEED_HOLD", "-", "-", "STOPPED STOP", "STOPPED ABORTED", "-", "-"]),
    ("ACTIVE BACK_TRACE", ["-", "-", "FEED_HOLD BACK_TRACE", "-", "-", "STOPPED STOP", "STOPPED ABORTED", "-", "-"]),
    ("WAIT", ["-", "-", "FEED_HOLD", "-", "-", "STOPPED STOP", "STOPPED ABORTED", "READY", "-"]),
    ("WAIT HANDLER_LOST", ["-", "-", "FEED_HOLD", "-", "-", "STOPPED STOP", "STOPPED ABORTED", "READY", "-"]),
    ("FEED_HOLD", ["-", "-", "=", "ACTIVE", "ACTIVE BACK_TRACE", "STOPPED STOP", "STOPPED ABORTED", "READY", "-"]),
    ("FEED_HOLD BUS_LOST", ["-", "-", "=", "ACTIVE", "ACTIVE BACK_TRACE", "STOPPED STOP", "STOPPED ABORTED", "READY", "-"]),
    ("FEED_HOLD BACK_TRACE", ["-", "-", "=", "ACTIVE", "ACTIVE BACK_TRACE", "STOPPED STOP", "STOPPED ABORTED", "READY", "-"]),
    ("FEED_HOLD BACK_TRACE_END", ["-", "-", "=", "ACTIVE", "ACTIVE BACK_TRACE", "STOPPED STOP", "STOPPED ABORTED", "READY", "-"]),
    ("PROGRAM_STOPPED", ["-", "-", "=", "ACTIVE", "-", "STOPPED STOP", "STOPPED ABORTED", "READY", "-"]),
    ("OPTIONAL_STOP", ["-", "-", "=", "ACTIVE", "-", "STOPPED STOP", "STOPPED ABORTED", "READY", "-"]),
    ("INTERRUPTED SINGLE_BLOCK", ["-", "-", "=", "ACTIVE", "-", "STOPPED STOP", "STOPPED ABORTED", "READY", "-"]),
    ("INTERRUPTED INTERLOCK", ["-", "-", "=", "ACTIVE", "-", "STOPPED STOP", "STOPPED ABORTED", "READY", "-"]),
    ("STOPPED ALARM", ["-", "-", "=", "-", "-", "=", "=", "READY", "-"]),
    ("STOPPED STOP", ["READY", "-", "=", "-", "-", "=", "=", "READY", "ACTIVE"]),
    ("STOPPED ABORTED", ["READY", "-", "=", "-", "-", "=", "=", "READY", "ACTIVE"]),
    ("STOPPED NO_PROGRAM", ["READY", "-", "=", "-", "-", "=", "=", "STOPPED NO_PROGRAM", "ACTIVE"]),
    ("STOPPED RESTARTED", ["READY", "-", "=", "-", "-", "=", "=", "STOPPED NO_PROGRAM", "ACTIVE"]),
    ("PROGRAM_COMPLETED", ["READY", "ACTIVE", "=", "-", "-", "=", "=", "READY", "ACTIVE"]),
];

fn event_of(verb: Verb, has_program: bool) -> RunEvent {
    match verb {
        Verb::Load => RunEvent::Loaded,
        Verb::Start | Verb::Mdi => started(),
        Verb::Hold => RunEvent::Hold(Cause::Operator),
        Verb::Resume => RunEvent::Resume,
        Verb::BackTrace => RunEvent::BackTrace { to: 9 },
        Verb::Stop => end(EarlyEndCause::Stop),
        Verb::Abort => end(EarlyEndCause::Abort),
        Verb::Reset => end(EarlyEndCause::Reset { has_program }),
        _ => panic!("{verb:?} is in no column"),
    }
}

#[test]
fn each_command_leads_from_each_state_to_that_of_its_row_or_is_refused() {
    for (from, row) in TABLE {
        let has_program = !["STOPPED NO_PROGRAM", "STOPPED RESTARTED"].contains(&from);
        assert_eq!(words(state(from).state_word()), from);
        assert_eq!(state(from).transition(), None, "{from}");
        let situation = Situation {
            execution: state(from).state_word_at_rest().0,
            program_loaded: has_program,
            alarm_active: from == "STOPPED ALARM",
        };
        for (verb, to) in COMMANDS.into_iter().zip(row) {
            assert_eq!(situation.allows(verb), to != "-", "{verb:?} in {from}");
            if to == "-" {
                continue;
            }
            let (led, actions) = state(from).on(event_of(verb, has_program));
            if to == "=" {
                assert_eq!((led, actions), (state(from), Vec::new()), "{verb:?} in {from}");
            } else {
                assert_eq!(words(at_rest(led).state_word()), to, "{verb:?} in {from}");
            }
        }
    }
}

#[test]
fn a_hold_and_an_end_show_the_state_before_until_the_machine_rests() {
    for (event, transition) in [
        (RunEvent::Hold(Cause::Operator), Transition::Holding),
        (end(EarlyEndCause::Stop), Transition::Stopping),
        (end(EarlyEndCause::Alarm), Transition::Stopping),
        (
            end(EarlyEndCause::Reset { has_program: true }),
            Transition::Resetting,
        ),
    ] {
        let ending = after(state("WAIT"), [event]);
        assert_eq!(
            (words(ending.state_word()), ending.transition()),
            ("WAIT".to_owned(), Some(transition))
        );
    }
}

#[test]
fn reset_during_hold_is_latched_and_resume_continues_the_wait() {
    let held = at_rest(after(state("WAIT"), [RunEvent::Hold(Cause::Operator)]));
    let resumed = after(held.clone(), [RunEvent::Resume]);
    assert_eq!(resumed, state("WAIT"));
    let latched = after(held, [RunEvent::Awaited(None)]);
    assert_eq!(
        (words(latched.state_word()), latched.awaited()),
        ("FEED_HOLD".to_owned(), None)
    );
    assert_eq!(latched.phase(), Some(&Phase::Reset { seq: 3 }), "the block stays");
    assert_eq!(words(after(latched, [RunEvent::Resume]).state_word()), "ACTIVE");
}

#[test]
fn after_a_back_trace_the_motion_turns_before_it_goes_on() {
    let (state, actions) = state("FEED_HOLD BACK_TRACE_END").on(RunEvent::Resume);
    assert!(!state.retraces());
    assert_eq!(
        actions,
        [RunAction::GoForward, RunAction::ResumeServo, RunAction::GoOn]
    );
}

#[test]
fn stop_in_progress_is_not_restarted_except_by_abort_alarm_or_reset() {
    let stopping = after(state("ACTIVE"), [end(EarlyEndCause::Stop)]);
    for why in [EarlyEndCause::Stop, EarlyEndCause::JogEnded(JogStop::Commanded)] {
        let again = stopping.clone().on(RunEvent::End {
            why,
            epoch: EPOCH + 1,
            remainder: 2,
        });
        assert_eq!(again, (stopping.clone(), Vec::new()));
    }
    for why in [
        EarlyEndCause::Abort,
        EarlyEndCause::Alarm,
        EarlyEndCause::Reset { has_program: true },
    ] {
        let epoch = EPOCH + 1;
        let (state, actions) = stopping.clone().on(RunEvent::End {
            why,
            epoch,
            remainder: 2,
        });
        let run = None;
        assert_eq!(
            actions,
            [RunAction::End { why, epoch, run }],
            "the run has ended before"
        );
        assert_eq!(words(state.state_word()), "ACTIVE", "as before the first of them");
        let early = after(state.clone(), [RunEvent::AtRest { epoch: EPOCH }]);
        assert_eq!(early, state, "the rest of the stop is not its own");
        let remainder = 1;
        assert_eq!(
            state.on(RunEvent::AtRest { epoch }),
            (
                RunState::Idle(why.at_rest()),
                vec![RunAction::Ended { why, remainder }]
            )
        );
    }
}

#[test]
fn a_command_that_waited_is_judged_by_the_state_that_an_alarm_leads_to() {
    let alarmed = after(state("READY"), [end(EarlyEndCause::Alarm)]);
    let judged = (words(alarmed.state_word()), words(alarmed.state_word_at_rest()));
    assert_eq!(judged, ("READY".to_owned(), "STOPPED ALARM".to_owned()));
}

#[test]
fn single_block_that_was_switched_off_while_the_servo_held_lets_it_go_on() {
    let (state, actions) = state("ACTIVE").on(RunEvent::ServoHeld { behind_block: false });
    assert_eq!(
        (words(state.state_word()), actions),
        ("ACTIVE".to_owned(), vec![RunAction::ResumeServo])
    );
    let (state, actions) = state.on(RunEvent::ServoHeld { behind_block: true });
    assert_eq!(words(state.state_word()), "INTERRUPTED SINGLE_BLOCK");
    assert_eq!(actions, []);
}

#[test]
fn what_follows_a_standstill_is_taken_once() {
    let mut standing = after(
        state("ACTIVE"),
        [RunEvent::Phase(Phase::Standstill(Then::BlockEnd))],
    );
    assert_eq!(standing.take_then(), Some(Then::BlockEnd));
    assert_eq!(
        (standing.take_then(), standing.phase()),
        (None, Some(&Phase::Interpret))
    );
}

/// Returns the texts of the unexpected events that a state reports after an event.
fn unexpected(state: &RunState, event: RunEvent) -> Vec<String> {
    let (after, actions) = state.clone().on(event);
    let texts = actions.into_iter().filter_map(|action| match action {
        RunAction::ReportUnexpected { text, .. } => Some(text),
        _ => None,
    });
    let texts: Vec<_> = texts.collect();
    assert!(
        texts.is_empty() || after == *state,
        "a reported event changes nothing"
    );
    texts
}

#[test]
fn event_that_no_state_expects_changes_nothing_and_is_reported() {
    let stopping = after(state("ACTIVE"), [end(EarlyEndCause::Stop)]);
    let holding = after(state("ACTIVE"), [RunEvent::Hold(Cause::Operator)]);
    let completed = || RunEvent::Completed(Execution::Ready);
    let passed = RunEvent::Passed { segment: 9 };
    for (state, event) in [
        (state("READY"), RunEvent::Resume),
        (state("READY"), RunEvent::BackTrace { to: 9 }),
        (state("READY"), RunEvent::Phase(Phase::Interpret)),
        (state("READY"), RunEvent::Awaited(None)),
        (state("READY"), passed),
        (state("READY"), RunEvent::BlockEnded),
        (state("READY"), RunEvent::AtRest { epoch: EPOCH }),
        (state("READY"), completed()),
        (state("ACTIVE"), RunEvent::Loaded),
        (state("ACTIVE"), started()),
        (state("ACTIVE"), RunEvent::BackTrace { to: 9 }),
        (state("ACTIVE"), RunEvent::AtRest { epoch: EPOCH }),
        (state("PROGRAM_STOPPED"), RunEvent::BlockEnded),
        (holding.clone(), RunEvent::Resume),
        (stopping.clone(), RunEvent::Loaded),
        (stopping.clone(), started()),
        (stopping.clone(), RunEvent::Resume),
        (stopping, completed()),
    ] {
        assert_eq!(unexpected(&state, event).len(), 1, "{state:?}");
    }
    assert_eq!(
        unexpected(&holding, RunEvent::Resume),
        ["the state ACTIVE HOLDING does not expect the event: resume the run"]
    );
}

#[test]
fn run_that_cannot_begin_is_returned_with_the_report() {
    let (_, actions) = state("ACTIVE").on(started());
    assert!(matches!(
        &actions[..],
        [RunAction::ReportUnexpected { run: Some(()), .. }]
    ));
}

/// Returns the reasons that the interface lists for a state word; `None` in the list means that the reason may be
/// empty.
fn reasons(execution: Execution) -> &'static [Option<Reason>] {
    use Reason::{
        Aborted, Alarm, BackTrace, BackTraceEnd, BusLost, HandlerLost, Interlock, NoProgram, Restarted,
        SingleBlock, Stop,
    };
    match execution {
        Execution::Ready
        | Execution::ProgramCompleted
        | Execution::ProgramStopped
        | Execution::OptionalStop => &[None],
        Execution::Active => &[None, Some(BackTrace)],
        Execution::Wait => &[None, Some(HandlerLost)],
        Execution::FeedHold => &[None, Some(BusLost), Some(BackTrace), Some(BackTraceEnd)],
        Execution::Interrupted => &[Some(SingleBlock), Some(Interlock)],
        Execution::Stopped => &[
            Some(Alarm),
            Some(Stop),
            Some(Aborted),
            Some(NoProgram),
            Some(Restarted),
        ],
    }
}

/// Random event of the model.
#[derive(Debug, Clone, Copy)]
enum Happening {
    Command(Verb),
    Alarm,
    Interlock,
    BusLoss,
    /// The servo has executed its last control, or holds after a block.
    Servo {
        behind_block: bool,
    },
    StaleRest,
    Prepared(u8),
    Outputs(Option<bool>),
    Passed,
}

fn happening() -> impl Strategy<Value = Happening> {
    prop_oneof![
        4 => prop::sample::select(COMMANDS.to_vec()).prop_map(Happening::Command),
        1 => prop::sample::select(vec![
            Happening::Alarm, Happening::Interlock, Happening::BusLoss, Happening::StaleRest, Happening::Passed,
        ]),
        3 => any::<bool>().prop_map(|behind_block| Happening::Servo { behind_block }),
        3 => (0..8_u8).prop_map(Happening::Prepared),
        2 => prop::option::of(any::<bool>()).prop_map(Happening::Outputs),
    ]
}

/// Model of a coordinate system around the run state: it validates commands and counts runs and epochs.
struct Model {
    state: RunState,
    has_run: bool,
    has_program: bool,
    has_alarm: bool,
    epoch: u32,
}

impl Model {
    fn on(&mut self, event: RunEvent) {
        self.has_run |= matches!(
            (&self.state, &event),
            (RunState::Idle(_), RunEvent::Started { .. })
        );
        let had_run = self.has_run;
        self.has_run &= !matches!(event, RunEvent::Completed(_));
        let (state, actions) = self.state.clone().on(event);
        self.state = state;
        for action in actions {
            match action {
                RunAction::End { epoch, run, .. } => {
                    assert_eq!((epoch, run.is_some()), (self.epoch + 1, self.has_run));
                    (self.epoch, self.has_run) = (epoch, false);
                }
                RunAction::ReportUnexpected { text, .. } => panic!("{text}"),
                RunAction::Ended { why, .. } => {
                    assert!(!self.has_run);
                    self.has_alarm &= !matches!(why, EarlyEndCause::Reset { .. });
                }
                RunAction::HoldServo { .. } => assert_eq!(self.state.transition(), Some(Transition::Holding)),
                _ => assert!(had_run, "an ended run never moves: {action:?}"),
            }
        }
    }

    fn command(&mut self, verb: Verb) {
        let situation = Situation {
            execution: self.state.state_word_at_rest().0,
            program_loaded: self.has_program,
            alarm_active: self.has_alarm,
        };
        let is_deferred = !verb.is_urgent() && self.state.transition().is_some();
        if is_deferred || !situation.allowed().contains(&verb) {
            return;
        }
        let event = match event_of(verb, self.has_program) {
            RunEvent::End { why, remainder, .. } => RunEvent::End {
                why,
                epoch: self.epoch + 1,
                remainder,
            },
            event => event,
        };
        self.has_program |= verb == Verb::Load;
        self.on(event);
        let (execution, transition) = (self.state.state_word().0, self.state.transition());
        match verb {
            Verb::Load => assert_eq!(execution, Execution::Ready),
            Verb::Start | Verb::Mdi => assert_eq!(execution, Execution::Active),
            Verb::Resume | Verb::BackTrace => {
                assert!(
                    [Execution::Active, Execution::Wait].contains(&execution),
                    "{execution:?}"
                );
            }
            Verb::Reset => assert_eq!(transition, Some(Transition::Resetting)),
            Verb::Stop | Verb::Abort => {
                assert_eq!(
                    self.state.is_idle(),
                    transition.is_none(),
                    "it stops, or there is no run"
                );
                let rest = after(self.state.clone(), [RunEvent::AtRest { epoch: self.epoch }]);
                assert!(rest.is_idle(), "an accepted stop reaches rest");
            }
            _ => {}
        }
    }

    /// Continues the preparation to a phase, if no hold prevents it.
    fn prepared(&mut self, phase: u8) {
        let may_go_on = self.state.is_running() && self.state.awaited().is_none();
        let Some(before) = self.state.phase().filter(|_| may_go_on) else {
            return;
        };
        if matches!(before, Phase::Paused(_)) {
            return;
        }
        let event = match phase {
            0 => RunEvent::BlockEnded,
            1 if *before == Phase::LastOutputs => RunEvent::Completed(Execution::ProgramCompleted),
            2 => RunEvent::Phase(Phase::LastOutputs),
            3 => RunEvent::Phase(Phase::Reset { seq: 3 }),
            4 => RunEvent::Phase(Phase::Standstill(Then::Interpret)),
            5 | 6 => RunEvent::Phase(stop_at(phase == 5)),
            _ => RunEvent::Phase(Phase::Interpret),
        };
        self.on(event);
    }

    fn happens(&mut self, happening: Happening) {
        match happening {
            Happening::Command(verb) => self.command(verb),
            Happening::Alarm => {
                self.has_alarm = true;
                let epoch = self.epoch + 1;
                self.on(RunEvent::End {
                    why: EarlyEndCause::Alarm,
                    epoch,
                    remainder: 1,
                });
            }
            Happening::Interlock => self.on(RunEvent::Hold(Cause::Interlock)),
            Happening::BusLoss => self.on(RunEvent::Hold(Cause::BusLoss)),
            Happening::Servo { behind_block } => match self.state.transition() {
                Some(Transition::Stopping | Transition::Resetting) => {
                    self.on(RunEvent::AtRest { epoch: self.epoch });
                }
                _ => self.on(RunEvent::ServoHeld { behind_block }),
            },
            Happening::StaleRest if self.state.is_ending() => self.on(RunEvent::AtRest {
                epoch: self.epoch.wrapping_sub(1),
            }),
            Happening::Prepared(phase) => self.prepared(phase),
            Happening::Outputs(lost) if self.state.has_run() => {
                let waits = matches!(self.state.phase(), Some(Phase::Reset { .. } | Phase::LastOutputs));
                let lost = lost.filter(|_| waits);
                self.on(RunEvent::Awaited(
                    lost.map(|is_lost| AwaitedOutput { seq: 3, is_lost }),
                ));
            }
            Happening::Passed if !self.state.is_idle() => self.on(RunEvent::Passed { segment: 9 }),
            Happening::StaleRest | Happening::Outputs(_) | Happening::Passed => {}
        }
    }

    fn check(&self) {
        let (execution, reason) = self.state.state_word();
        assert!(reasons(execution).contains(&reason), "{execution:?} {reason:?}");
        assert_eq!(self.state.phase().is_some(), self.has_run, "{:?}", self.state);
        let is_of_run = !matches!(
            execution,
            Execution::Ready | Execution::Stopped | Execution::ProgramCompleted
        );
        if !self.state.is_ending() {
            assert_eq!(is_of_run, self.has_run, "{:?}", self.state);
        }
        assert_eq!(self.state.is_idle() || self.state.is_ending(), !self.has_run);
        assert!(self.has_run || self.state.awaited().is_none() && !self.state.retraces());
    }
}

proptest! {
    #![proptest_config(ProptestConfig { rng_seed: RngSeed::Fixed(20), ..ProptestConfig::with_cases(2000) })]

    #[test]
    fn any_event_leads_to_an_interface_state_and_an_ended_run_never_moves(
        happenings in prop::collection::vec(happening(), 1..80),
    ) {
        let mut model = Model {
            state: RunState::default(),
            has_run: false,
            has_program: false,
            has_alarm: false,
            epoch: 0,
        };
        for happening in happenings {
            model.happens(happening);
            model.check();
        }
    }
}
