//! Interlocks and start locks that belong to a sequence program.

use plc_api::fake::FakePort;
use plc_api::{Plc, SequenceProgram};
use plc_protocol::types::state::Lock;
use tokio::sync::watch;

use super::{ms, serve};

async fn interlock(fake: &FakePort) -> Lock {
    fake.plc().coordinate_system(1).interlock().await.unwrap()
}

#[tokio::test]
async fn a_level_of_a_program_is_written_again_after_a_restart_of_the_machine() {
    let fake = FakePort::new([1]);
    let (door, open) = watch::channel(true);
    let program = SequenceProgram::new()
        .handler_id("cell")
        .interlock(1, "door", open, "the door is open");
    let _task = serve(&fake, program).await;
    let lock = interlock(&fake).await;
    assert_eq!((lock.value, lock.text.as_str()), (true, "the door is open"));
    assert_eq!(lock.sources[0].handler_id.as_deref(), Some("cell"));
    fake.restart();
    fake.settle().await;
    assert!(interlock(&fake).await.value, "the door is still open");
    door.send_replace(false);
    fake.settle().await;
    assert!(!interlock(&fake).await.value);
    fake.restart();
    fake.settle().await;
    assert!(!interlock(&fake).await.value);
}

#[tokio::test]
async fn a_level_that_nobody_sends_any_more_is_on() {
    let fake = FakePort::new([1]);
    let (door, open) = watch::channel(false);
    let program = SequenceProgram::new().start_lock(1, "door", open, "the door is open");
    let task = serve(&fake, program).await;
    drop(door);
    fake.settle().await;
    let lock = fake.plc().coordinate_system(1).start_lock().await.unwrap();
    assert!(lock.value && lock.text.contains("no longer reports"), "{lock:?}");
    assert!(!task.is_finished());
}

/// Writes the interlock after each change of a level, as programs for version 0.1 do.
async fn follow(plc: Plc, mut open: watch::Receiver<bool>) -> plc_api::Result<()> {
    loop {
        let is_open = *open.borrow_and_update();
        plc.coordinate_system(1)
            .set_interlock(is_open, "the door is open")
            .await?;
        if open.changed().await.is_err() {
            return Ok(());
        }
    }
}

#[tokio::test]
async fn what_a_guard_beside_a_program_sets_is_that_programs() {
    let fake = FakePort::new([1]);
    let plc = fake.plc();
    let (door, open) = watch::channel(true);
    let guard = tokio::spawn(follow(plc.clone(), open));
    fake.settle().await;
    let program = SequenceProgram::new().handler_id("cell");
    let served = tokio::spawn(async move { program.run(&plc).await });
    fake.settle().await;
    assert_eq!(
        interlock(&fake).await.sources[0].handler_id.as_deref(),
        Some("cell")
    );
    fake.restart();
    fake.settle().await;
    assert!(interlock(&fake).await.value, "nobody had to set it again");
    let other = fake.plc().coordinate_system(1).set_interlock(false, "").await;
    assert!(other.is_err(), "it is cleared by its owner alone");
    door.send_replace(false);
    fake.settle().await;
    assert!(!interlock(&fake).await.value && !guard.is_finished());
    served.abort();
    fake.advance(ms(1)).await;
    assert!(
        !interlock(&fake).await.value,
        "without on_loss the source keeps its value"
    );
}

#[tokio::test]
async fn two_programs_with_the_same_source_clear_only_what_they_have_set() {
    let fake = FakePort::new([1]);
    let (one, of_one) = watch::channel(true);
    let (two, of_two) = watch::channel(true);
    for level in [of_one, of_two] {
        let _task = serve(
            &fake,
            SequenceProgram::new().interlock(1, "door", level, "a door is open"),
        )
        .await;
    }
    one.send_replace(false);
    fake.settle().await;
    assert!(interlock(&fake).await.value);
    two.send_replace(false);
    fake.settle().await;
    assert!(!interlock(&fake).await.value);
}
