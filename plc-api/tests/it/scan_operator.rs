//! Alarms, questions and the cycle-time watch of scans.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use plc_api::fake::FakePort;
use plc_api::fake::OutputOutcome;
use plc_api::scan::{Image, ScanProgram};
use plc_api::{Alarm, CancelReason, Execution, Params, Plc, SequenceProgram};
use plc_protocol::hub::{Filter, Subscription};
use plc_protocol::port::{BoxFuture, Port};
use plc_protocol::types::BootId;
use plc_protocol::types::message::Message;
use plc_protocol::types::refusal::Refusal;
use plc_protocol::types::request::{Answer, Request};
use plc_protocol::types::topic::Topic;

use crate::{ms, serve};

/// Runs a scan every 10 ms that raises alarm 20 of the whole machine while the returned level is on.
async fn with_air(fake: &FakePort) -> Arc<Mutex<bool>> {
    let low = Arc::new(Mutex::new(false));
    let level = Arc::clone(&low);
    let program = SequenceProgram::new().scan([], ms(10), move |image: &mut Image| {
        image.set_alarm(None, *level.lock().unwrap(), Alarm::user(20, "low"));
    });
    serve(fake, program).await;
    low
}

#[tokio::test]
async fn scan_alarm_is_raised_once_and_reset_holds_only_without_its_level() {
    let fake = FakePort::new([1, 2]);
    let low = with_air(&fake).await;
    let (plc, mill) = (fake.plc(), fake.plc().coordinate_system(1));
    fake.advance(ms(100)).await;
    assert_eq!(plc.alarms().await.unwrap(), []);
    *low.lock().unwrap() = true;
    fake.advance(ms(3000)).await;
    let ids = async || {
        let alarms = plc.alarms().await.unwrap();
        alarms.iter().map(|alarm| alarm.id).collect::<Vec<_>>()
    };
    assert_eq!(ids().await, [1]);
    mill.reset().await.unwrap();
    fake.advance(ms(20)).await;
    assert_eq!(ids().await, [2], "the air is still low");
    *low.lock().unwrap() = false;
    fake.advance(ms(50)).await;
    assert_eq!(ids().await, [2], "the alarm stays until a reset");
    mill.reset().await.unwrap();
    fake.advance(ms(3000)).await;
    assert_eq!(ids().await, [] as [u64; 0]);
}

#[tokio::test]
async fn an_alarm_that_is_no_users_is_refused_and_the_next_scan_sees_it() {
    let fake = FakePort::new([1]);
    let refused = Arc::new(Mutex::new(String::new()));
    let noted = Arc::clone(&refused);
    let program = SequenceProgram::new().scan([], ms(10), move |image: &mut Image| {
        let own = Alarm {
            number: 300,
            text: "mine".to_owned(),
        };
        image.set_alarm(1, true, own);
        if let Some(first) = image.refusals().first() {
            *noted.lock().unwrap() = first.to_string();
        }
    });
    serve(&fake, program).await;
    fake.advance(ms(30)).await;
    let refused = refused.lock().unwrap();
    assert!(refused.contains("make it by Alarm::user"), "{refused}");
}

/// Runs a scan every 10 ms that asks about M80 while the first value is true. The second value is the answer.
async fn asking(fake: &FakePort) -> (Arc<Mutex<bool>>, Arc<Mutex<Option<String>>>) {
    let (asks, heard) = (Arc::new(Mutex::new(true)), Arc::new(Mutex::new(None)));
    let (is_asking, noted) = (Arc::clone(&asks), Arc::clone(&heard));
    let program = SequenceProgram::new().scan(80, ms(10), move |image: &mut Image| {
        if *is_asking.lock().unwrap() {
            *noted.lock().unwrap() = image.ask(1, 80, "Clean?", ["yes", "no"]);
        }
    });
    serve(fake, program).await;
    (asks, heard)
}

#[tokio::test]
async fn scan_question_is_asked_once_and_its_answer_stays_while_written() {
    let fake = FakePort::new([1]);
    let (_asks, heard) = asking(&fake).await;
    fake.issue_output(1, 80, Params::default());
    fake.advance(ms(100)).await;
    let mill = fake.plc().coordinate_system(1);
    let asked = mill.question().await.unwrap();
    fake.advance(ms(100)).await;
    assert_eq!(mill.question().await.unwrap(), asked, "it is the same question");
    assert_eq!(*heard.lock().unwrap(), None);
    mill.answer(&asked, "no").await.unwrap();
    fake.advance(ms(100)).await;
    assert_eq!(heard.lock().unwrap().as_deref(), Some("no"));
    assert_eq!(mill.questions().await.unwrap(), [], "it is not asked again");
}

#[tokio::test]
async fn a_question_that_a_scan_no_longer_writes_is_taken_back_and_asked_anew() {
    let fake = FakePort::new([1]);
    let (asks, heard) = asking(&fake).await;
    fake.issue_output(1, 80, Params::default());
    fake.advance(ms(30)).await;
    let mill = fake.plc().coordinate_system(1);
    let first = mill.question().await.unwrap();
    *asks.lock().unwrap() = false;
    fake.advance(ms(30)).await;
    assert_eq!(mill.questions().await.unwrap(), []);
    *asks.lock().unwrap() = true;
    fake.advance(ms(30)).await;
    let second = mill.question().await.unwrap();
    assert_ne!(second.question.id, first.question.id);
    mill.answer(&second, "yes").await.unwrap();
    fake.advance(ms(30)).await;
    assert_eq!(heard.lock().unwrap().as_deref(), Some("yes"));
}

#[tokio::test]
async fn the_answer_of_one_output_is_none_of_the_next() {
    let fake = FakePort::new([1]);
    let (_asks, heard) = asking(&fake).await;
    fake.issue_output(1, 80, Params::default());
    fake.advance(ms(30)).await;
    let mill = fake.plc().coordinate_system(1);
    let asked = mill.question().await.unwrap();
    mill.answer(&asked, "yes").await.unwrap();
    fake.advance(ms(30)).await;
    fake.cancel(1, CancelReason::Stop);
    fake.issue_output(1, 80, Params::default());
    fake.advance(ms(50)).await;
    assert_eq!(*heard.lock().unwrap(), None);
    assert_eq!(mill.questions().await.unwrap().len(), 1);
}

#[tokio::test]
async fn question_without_choices_is_refused_and_its_m_code_can_still_be_reset() {
    let fake = FakePort::new([1]);
    let refused = Arc::new(Mutex::new(Vec::new()));
    let noted = Arc::clone(&refused);
    let program = SequenceProgram::new().scan(80, ms(10), move |image: &mut Image| {
        image.ask(1, 80, "Clean?", [] as [&str; 0]);
        noted
            .lock()
            .unwrap()
            .extend(image.refusals().iter().map(ToString::to_string));
        if !image.refusals().is_empty() {
            image.reset(1, 80);
        }
    });
    serve(&fake, program).await;
    let seq = fake.issue_output(1, 80, Params::default());
    fake.advance(ms(50)).await;
    assert_eq!(fake.closed(1, seq), Some(OutputOutcome::Reset));
    let refused = refused.lock().unwrap();
    assert!(refused[0].contains("a question needs a choice"), "{refused:?}");
}

/// A machine with a clock on which a scan can take time.
struct Slow {
    fake: FakePort,
    taken_ms: Arc<AtomicU64>,
}

impl Port for Slow {
    fn boot_id(&self) -> BootId {
        self.fake.boot_id()
    }

    fn read<'a>(&'a self, topic: &'a Topic) -> BoxFuture<'a, Option<Arc<Message>>> {
        self.fake.read(topic)
    }

    fn subscribe(&self, filter: Filter) -> Subscription {
        self.fake.subscribe(filter)
    }

    fn request(&self, request: Request) -> BoxFuture<'_, Result<Answer, Refusal>> {
        self.fake.request(request)
    }

    fn sleep(&self, duration: Duration) -> BoxFuture<'_, ()> {
        self.fake.sleep(duration)
    }

    fn now_s(&self) -> f64 {
        self.fake.now_s() + self.taken_ms.load(Ordering::Relaxed) as f64 / 1e3
    }
}

/// A scan program that takes 25 ms in its third scan. It records late scans, the last and the longest
/// duration.
struct SlowScan {
    taken_ms: Arc<AtomicU64>,
    limit: Option<Duration>,
    seen: Arc<Mutex<Vec<(u64, f64, f64)>>>,
}

impl ScanProgram for SlowScan {
    fn cycle_limit(&self) -> Option<Duration> {
        self.limit
    }

    fn scan(&mut self, image: &mut Image) {
        let ms = |time_s: f64| (time_s * 1e6).round() / 1e3;
        let seen = (
            image.late_scans(),
            ms(image.last_scan_s()),
            ms(image.longest_scan_s()),
        );
        self.seen.lock().unwrap().push(seen);
        if image.scans() == 2 {
            self.taken_ms.fetch_add(25, Ordering::Relaxed);
        }
        image.set_alarm(1, image.late_scans() > 0, Alarm::user(30, "a scan was late"));
    }
}

async fn watched(limit: Option<Duration>) -> (FakePort, Vec<(u64, f64, f64)>) {
    let fake = FakePort::new([1]);
    let (taken_ms, seen) = (Arc::default(), Arc::default());
    let program = SlowScan {
        taken_ms: Arc::clone(&taken_ms),
        limit,
        seen: Arc::clone(&seen),
    };
    let plc = Plc::in_process(Arc::new(Slow {
        fake: fake.clone(),
        taken_ms,
    }));
    let program = SequenceProgram::new().scan([], ms(10), program);
    tokio::spawn(async move { program.run(&plc).await });
    fake.advance(ms(45)).await;
    let seen = seen.lock().unwrap().clone();
    (fake, seen)
}

#[tokio::test]
async fn scan_overrun_is_counted_and_can_raise_an_alarm() {
    let (fake, seen) = watched(None).await;
    assert_eq!(seen[2], (0, 0.0, 0.0));
    assert_eq!(seen[3], (1, 25.0, 25.0));
    assert_eq!(seen[4], (1, 0.0, 25.0));
    let state = fake.plc().coordinate_system(1).state().await.unwrap();
    assert_eq!((state.execution, state.alarm_count), (Execution::Stopped, 1));
}

#[tokio::test]
async fn a_scan_within_its_limit_is_not_late() {
    let (_fake, seen) = watched(Some(ms(25))).await;
    assert_eq!(seen[3], (0, 25.0, 25.0));
}
