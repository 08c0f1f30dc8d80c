//! Many clients that send requests at the same time, clients that stop waiting, and clients that send requests at the
//! end.

use std::collections::BTreeMap;
use std::time::Duration;

use plc_protocol::types::lease::{LeaseRequest, LeaseTake};
use plc_protocol::types::output::{Claim, HandshakeStatus};
use plc_protocol::types::request::OutputRequest;
use tokio::time::timeout;

use super::*;

/// Time limit of a request; a longer wait means that the mailbox has lost the request.
const FORGOTTEN: Duration = Duration::from_mins(1);

/// Creates a request that publishes its number each time it is executed.
fn numbered(asker: usize, number: u64) -> CoordinateSystemRequest {
    let claim = Claim {
        boot_id: BootId("test".into()),
        seq: number,
        handler_id: asker.to_string(),
        instance: None,
    };
    CoordinateSystemRequest::Output(Some(100), OutputRequest::Claim(claim))
}

fn results(mailbox: &Mailbox) -> plc_protocol::hub::Subscription {
    let topic = Topic::cs(1, CsTopic::Result(100));
    mailbox.shared.hub.subscribe(Filter::Topics(vec![topic]))
}

/// Returns the numbers of each client in the order of execution.
fn executed_requests(said: &mut plc_protocol::hub::Subscription) -> BTreeMap<usize, Vec<u64>> {
    let mut by_asker: BTreeMap<usize, Vec<u64>> = BTreeMap::new();
    while let Some(message) = said.try_next() {
        if let Payload::Result(result) = &message.payload {
            assert_eq!(result.status, HandshakeStatus::Unknown, "no such output");
            let asker = result.handler_id.parse().unwrap();
            by_asker.entry(asker).or_default().push(result.seq);
        }
    }
    by_asker
}

fn lease(command_id: &str) -> CoordinateSystemRequest {
    let meta = CommandMeta {
        command_id: command_id.into(),
        client_id: "test".into(),
        ..CommandMeta::default()
    };
    CoordinateSystemRequest::Lease {
        request: LeaseRequest::Take(LeaseTake {
            ttl_ms: Some(5000),
            ..LeaseTake::default()
        }),
        meta,
    }
}

fn command(command_id: &str, command: Command) -> CoordinateSystemRequest {
    let meta = CommandMeta {
        command_id: command_id.into(),
        client_id: "test".into(),
        ..CommandMeta::default()
    };
    CoordinateSystemRequest::Command {
        command,
        meta,
        wait: false,
    }
}

fn is_task_woken(mailbox: &Mailbox) -> bool {
    mailbox.wake.notified().now_or_never().is_some()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn concurrent_requests_are_executed_once_and_in_order_per_sender() {
    const ASKERS: usize = 8;
    const EACH: u64 = 500;
    let (mailbox, _servo) = mailbox(Journal::to_log());
    let mut said = results(&mailbox);
    let of_task = Arc::clone(&mailbox);
    let task = tokio::spawn(async move { of_task.run().await });
    let askers: Vec<_> = (0..ASKERS)
        .map(|asker| {
            let mailbox = Arc::clone(&mailbox);
            tokio::spawn(async move {
                for number in 1..=EACH {
                    let mut asked = Box::pin(mailbox.ask(numbered(asker, number), false));
                    // some clients do not wait for the answer; their requests are sent regardless
                    let answer = (&mut asked).now_or_never();
                    if answer.is_none() && number % 3 != 0 {
                        asked.await.unwrap();
                    }
                }
                // sent after all requests of this client
                mailbox.ask(optional_stop(true), false).await.unwrap();
            })
        })
        .collect();
    for asker in askers {
        timeout(FORGOTTEN, asker)
            .await
            .expect("a request was forgotten")
            .unwrap();
    }
    let by_asker = executed_requests(&mut said);
    assert_eq!(said.dropped_events(), 0);
    let all: Vec<u64> = (1..=EACH).collect();
    for asker in 0..ASKERS {
        assert_eq!(by_asker[&asker], all, "asker {asker}");
    }
    mailbox.shared.closing.cancel();
    timeout(FORGOTTEN, task).await.expect("the task ends").unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn who_asks_while_it_ends_is_answered_or_told_that_it_stops() {
    for _ in 0..100 {
        let (mailbox, _servo) = mailbox(Journal::to_log());
        let of_task = Arc::clone(&mailbox);
        let task = tokio::spawn(async move { of_task.run().await });
        let askers: Vec<_> = (0..4)
            .map(|asker| {
                let mailbox = Arc::clone(&mailbox);
                tokio::spawn(async move {
                    let mut number = 1;
                    while mailbox.ask(numbered(asker, number), false).await.is_ok() {
                        number += 1;
                    }
                })
            })
            .collect();
        tokio::task::yield_now().await;
        mailbox.shared.closing.cancel();
        for asker in askers {
            timeout(FORGOTTEN, asker)
                .await
                .expect("who asked is told")
                .unwrap();
        }
        timeout(FORGOTTEN, task).await.expect("the task ends").unwrap();
    }
}

#[test]
fn who_works_on_anothers_request_leaves_its_own_to_the_task_and_wakes_it() {
    let (mailbox, _servo) = mailbox(Journal::to_log());
    let mut first = Box::pin(mailbox.ask(numbered(1, 1), false));
    let at_work = mailbox.work.lock();
    assert_eq!((&mut first).now_or_never(), None);
    drop(at_work);
    assert!(is_task_woken(&mailbox));
    let mut second = Box::pin(mailbox.ask(numbered(2, 1), false));
    assert_eq!((&mut second).now_or_never(), None);
    assert!(first.now_or_never().is_some(), "in the order in which they came");
    assert!(
        is_task_woken(&mailbox),
        "one request waits, and nobody is at work"
    );
    assert!(!mailbox.work_as_task().busy);
    assert!(second.now_or_never().is_some());
}

#[test]
fn queued_request_is_executed_even_if_its_future_is_dropped() {
    let (mailbox, _servo) = mailbox(Journal::to_log());
    let mut said = results(&mailbox);
    let mut asked = Box::pin(mailbox.ask(numbered(1, 1), false));
    let at_work = mailbox.work.lock();
    assert_eq!((&mut asked).now_or_never(), None);
    drop(at_work);
    drop(asked);
    mailbox.work_as_task();
    assert_eq!(executed_requests(&mut said), BTreeMap::from([(1, vec![1])]));
}

#[test]
fn requests_without_queue_room_wait_in_order_and_dropping_cancels_them() {
    let (mailbox, _servo) = mailbox(Journal::to_log());
    let mut said = results(&mailbox);
    let last = REQUESTS_MAX as u64;
    let at_work = mailbox.work.lock();
    let mut asked: Vec<_> = (1..=last + 3)
        .map(|number| Box::pin(mailbox.ask(numbered(1, number), false).fuse()))
        .collect();
    for request in &mut asked {
        assert_eq!(request.now_or_never(), None);
    }
    drop(at_work);
    // drops the first of the three requests that wait for a free slot
    drop(asked.remove(usize::try_from(last).unwrap()));
    for _ in 0..last + 2 {
        mailbox.work_as_task();
        for request in asked.iter_mut().skip(REQUESTS_MAX) {
            let _put_there_once_there_is_room = request.now_or_never();
        }
    }
    let mut expected: Vec<u64> = (1..=last).collect();
    expected.extend([last + 2, last + 3]);
    assert_eq!(executed_requests(&mut said)[&1], expected);
}

#[test]
fn request_deadline_wakes_the_task_unless_it_wakes_earlier_anyway() {
    let (mailbox, _servo) = mailbox(Journal::to_log());
    mailbox.work_as_task();
    let taken = mailbox.ask(lease("1"), false).now_or_never();
    assert!(matches!(taken, Some(Ok(_))), "{taken:?}");
    assert!(is_task_woken(&mailbox), "the lease ends in 5 s");
    mailbox.work_as_task();
    mailbox
        .ask(optional_stop(true), false)
        .now_or_never()
        .unwrap()
        .unwrap();
    assert!(!is_task_woken(&mailbox));
}

#[test]
fn sender_never_executes_a_command_even_after_a_transition_wait() {
    let (mailbox, mut servo) = mailbox(Journal::to_log());
    let mut reset = Box::pin(mailbox.ask(command("reset", Command::Reset), false));
    let mut waits = Box::pin(mailbox.ask(mdi(), false));
    for request in [&mut reset, &mut waits] {
        assert_eq!(request.now_or_never(), None);
        mailbox.work_as_task();
    }
    assert!(matches!((&mut reset).now_or_never(), Some(Ok(_))));
    while is_task_woken(&mailbox) {}
    servo.cycle();
    mailbox
        .ask(optional_stop(true), false)
        .now_or_never()
        .unwrap()
        .unwrap();
    assert_eq!(
        (&mut waits).now_or_never(),
        None,
        "the machine rests, and the task is asked"
    );
    assert!(is_task_woken(&mailbox));
    mailbox.work_as_task();
    assert!(matches!(waits.now_or_never(), Some(Ok(Answer::Command(_)))));
}

#[test]
fn who_asks_never_takes_a_command_that_came_between() {
    let (mailbox, _servo) = mailbox(Journal::to_log());
    for urgent in [false, true] {
        let id = urgent.to_string();
        let mut asked = Box::pin(mailbox.ask(command(&id, Command::Stop), urgent));
        let mut at_work = mailbox.work.lock();
        assert_eq!((&mut asked).now_or_never(), None);
        let left = mailbox.work(&mut at_work, TurnLimits::OF_CALLER);
        assert!(left.busy);
        drop(at_work);
        assert_eq!((&mut asked).now_or_never(), None);
        mailbox.work_as_task();
        assert!(matches!(asked.now_or_never(), Some(Ok(Answer::Command(_)))));
    }
}

#[test]
fn a_stop_that_is_left_to_the_task_is_not_overtaken_by_who_asks() {
    let (mailbox, _servo) = mailbox(Journal::to_log());
    let mut stop = Box::pin(mailbox.ask(command("stop", Command::Stop), true));
    let mut asked = Box::pin(mailbox.ask(optional_stop(true), false));
    assert_eq!((&mut stop).now_or_never(), None);
    assert_eq!((&mut asked).now_or_never(), None);
    mailbox.work_as_task();
    assert!(stop.now_or_never().is_some());
    mailbox.work_as_task();
    assert_eq!(asked.now_or_never(), Some(Ok(Answer::Done)));
}
