use std::sync::atomic::AtomicU32;

use futures_util::FutureExt;
use plc_protocol::hub::Filter;
use plc_protocol::types::BootId;
use plc_protocol::types::command::{Command, CommandMeta};
use plc_protocol::types::lease::{LeaseRequest, LeaseTake};
use plc_protocol::types::message::Payload;
use plc_protocol::types::request::Input;
use plc_protocol::types::state::{Execution, Switch};
use plc_protocol::types::topic::{CsTopic, Topic};
use tandem_servo::Servo;

mod faults;
mod many;

use tandem_config::Config;
use tandem_store::clock::Clock;
use tandem_store::journal::{Event, Journal, RunEnd};
use tandem_store::runs::RunBook;
use tandem_store::tables::Tables;

use super::*;

/// Returns the first coordinate system of the demo machine, and the servo at the other end of its rings.
fn mailbox(journal: Journal) -> (Arc<Mailbox>, Servo) {
    let machine = Config::demo().resolve().unwrap();
    let configured = machine.coordinate_systems[0].clone();
    let store = machine.new_store();
    let tables = Tables::new(machine.table_settings());
    let boot = BootId("test".into());
    let shared = Arc::new(SharedState::new(
        machine,
        boot,
        Clock::simulated(),
        store,
        journal,
        tables,
    ));
    let systems = [(&configured.settings, configured.pre_read_blocks)];
    let (servo, mut handles) = Servo::simulated(&systems, 0.001);
    let system = CoordinateSystem::new(
        Arc::clone(&shared),
        configured,
        handles.remove(0),
        (Execution::Ready, None),
        Some(0),
    );
    (Arc::new(Mailbox::new(shared, system)), servo)
}

#[test]
fn a_part_is_read_by_nobody_before_the_journal_has_its_end() {
    let (of_sink, runs) = std::sync::mpsc::channel::<Arc<parking_lot::Mutex<RunBook>>>();
    let read = Arc::new(AtomicU32::new(0));
    let count = Arc::clone(&read);
    let sink = move |_line: &tandem_store::journal::Line| -> bool {
        let runs = runs.try_recv().unwrap();
        let seen = runs.try_lock().and_then(|book| book.state(1).run);
        count.fetch_add(seen.map_or(0, |run| run.parts_done), Ordering::Relaxed);
        false
    };
    let (mailbox, _servo) = mailbox(Journal::to_sink(Arc::new(std::sync::Mutex::new(sink))));
    let shared = &mailbox.shared;
    let start = Event::Start {
        program: 60,
        run_id: "1-1".to_owned(),
        program_hash: None,
        from_line: None,
        parts: Some(2),
        order: None,
    };
    let outcome = Execution::ProgramCompleted;
    for event in [start, Event::End(RunEnd::Completed { outcome })] {
        of_sink.send(Arc::clone(&shared.runs)).unwrap();
        shared.record(1, event);
    }
    assert_eq!(read.load(Ordering::Relaxed), 0);
    assert_eq!(shared.runs.lock().state(1).run.unwrap().parts_done, 1);
}

fn optional_stop(on: bool) -> CoordinateSystemRequest {
    CoordinateSystemRequest::Input(Input::OptionalStop(on))
}

fn mdi() -> CoordinateSystemRequest {
    CoordinateSystemRequest::Command {
        command: Command::Mdi {
            text: "G04 P1".into(),
            is_macro: false,
        },
        meta: CommandMeta {
            command_id: "1".into(),
            client_id: "test".into(),
            ..CommandMeta::default()
        },
        wait: false,
    }
}

#[test]
fn who_asks_carries_its_request_out_itself() {
    let (mailbox, _servo) = mailbox(Journal::to_log());
    let answer = mailbox.ask(optional_stop(true), false).now_or_never();
    assert_eq!(answer, Some(Ok(Answer::Done)));
}

#[test]
fn a_command_and_what_comes_behind_it_are_left_to_the_task() {
    let (mailbox, _servo) = mailbox(Journal::to_log());
    let mut command = Box::pin(mailbox.ask(mdi(), false));
    let mut behind = Box::pin(mailbox.ask(optional_stop(true), false));
    assert_eq!((&mut command).now_or_never(), None);
    assert_eq!((&mut behind).now_or_never(), None);
    assert!(mailbox.work_as_task().busy, "one more request waits");
    mailbox.work_as_task();
    assert!(matches!(command.now_or_never(), Some(Ok(Answer::Command(_)))));
    assert_eq!(behind.now_or_never(), Some(Ok(Answer::Done)));
}

#[test]
fn requests_during_work_are_queued_in_order_and_urgent_ones_pass_them() {
    let (mailbox, _servo) = mailbox(Journal::to_log());
    let topics = [CsTopic::OptionalStop, CsTopic::DryRun].map(|topic| Topic::cs(1, topic));
    let mut said = mailbox.shared.hub.subscribe(Filter::Topics(topics.to_vec()));
    while said.try_next().is_some() {}
    let mut first = Box::pin(mailbox.ask(optional_stop(true), false));
    let mut second = Box::pin(mailbox.ask(optional_stop(false), false));
    let mut urgent = Box::pin(mailbox.ask(CoordinateSystemRequest::Input(Input::DryRun(true)), true));
    let at_work = mailbox.work.lock();
    for request in [&mut first, &mut second, &mut urgent] {
        assert_eq!(request.now_or_never(), None);
    }
    drop(at_work);
    assert!(
        mailbox.wake.notified().now_or_never().is_some(),
        "the task is woken"
    );
    let mut values = Vec::new();
    loop {
        let left = mailbox.work_as_task();
        while let Some(message) = said.try_next() {
            if let Payload::Switch(Switch { value }) = &message.payload {
                values.push((message.topic.clone(), *value));
            }
        }
        if !left.busy {
            break;
        }
    }
    let of = |topic, value| (Topic::cs(1, topic), value);
    assert_eq!(
        values,
        [
            of(CsTopic::DryRun, true),
            of(CsTopic::OptionalStop, true),
            of(CsTopic::OptionalStop, false)
        ]
    );
    for request in [first, second, urgent] {
        assert_eq!(request.now_or_never(), Some(Ok(Answer::Done)));
    }
}

#[test]
fn a_turn_of_simulated_time_is_alone_unless_it_tells_others_something() {
    let (mailbox, _servo) = mailbox(Journal::to_log());
    let lease = CoordinateSystemRequest::Lease {
        request: LeaseRequest::Take(LeaseTake {
            ttl_ms: Some(5000),
            ..LeaseTake::default()
        }),
        meta: CommandMeta {
            command_id: "1".into(),
            client_id: "test".into(),
            ..CommandMeta::default()
        },
    };
    assert!(matches!(mailbox.ask(lease, false).now_or_never(), Some(Ok(_))));
    assert!(
        !mailbox.turn_alone(),
        "the task does not know yet when the lease ends"
    );
    mailbox.work_as_task();
    mailbox.shared.clock.set_ns(4_000_000_000);
    assert!(mailbox.turn_alone());
    mailbox.shared.clock.set_ns(6_000_000_000);
    assert!(!mailbox.turn_alone(), "the lease has ended");
    assert!(mailbox.turn_alone());
}
