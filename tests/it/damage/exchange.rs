//! Files that are exchanged, removed, from an older copy or from another machine; the question about them,
//! and its answers.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use plc_api::Plc;
use plc_protocol::types::data::ToolData;
use plc_protocol::types::message::Payload;
use plc_protocol::types::request::typed;
use plc_protocol::types::stored_data::{
    StoredDataAnswer, StoredDataDecision, StoredDataFault, StoredDataPart, StoredDataQuestion,
};
use plc_protocol::types::topic::Topic;

use super::{
    CLAMP, MACHINE, Random, Values, alarms, copy, damage, files, journal, keep_time, read, run_until_waiting,
    start, store,
};
use crate::support::machine::Machine;
use crate::support::wait::until;

/// Rounds of each run of the campaign of exchanged and older files; with `TANDEM_LONG`, 1000.
const EXCHANGES: u64 = 40;

/// Data folders from which files are taken.
struct Sources {
    /// The folder after the kill.
    good: PathBuf,
    /// Older copies: from an earlier start, and from an earlier moment of the same start.
    older: Vec<PathBuf>,
    /// Folder of a machine of another name, with other values.
    other: PathBuf,
}

/// Replaces, removes or damages a file; returns a description.
fn exchange(sources: &Sources, path: &Path, original: &Path, random: &mut Random) -> String {
    let name = original.strip_prefix(&sources.good).unwrap();
    let from = match random.below(8) {
        0 => return damage(path, original, random),
        1 => {
            let _ = fs::remove_file(path);
            return format!("{} is removed", name.display());
        }
        2 => sources.other.join(name),
        3 | 4 => {
            let all = files(&sources.good);
            all[random.below(all.len())].clone()
        }
        _ => sources.older[random.below(sources.older.len())].join(name),
    };
    if !from.exists() {
        let _ = fs::remove_file(path);
        return format!("{} is removed, as in {}", name.display(), from.display());
    }
    fs::copy(&from, path).unwrap();
    keep_time(path, &from);
    format!("{} is replaced by {}", name.display(), from.display())
}

/// Returns the sources, and the messages of a start with the good folder.
async fn sources(machine: &Machine) -> (Sources, Values) {
    let data = machine.path("tandem-data");
    let sources = Sources {
        good: machine.path("good"),
        older: vec![machine.path("older"), machine.path("middle")],
        other: machine.path("other"),
    };
    let runtime = start(machine).await;
    store(&Plc::in_process(runtime.port()), 100.0).await;
    runtime.shutdown().await;
    copy(&data, &sources.older[0]);
    let runtime = start(machine).await;
    let plc = Plc::in_process(runtime.port());
    store(&plc, 200.0).await;
    tokio::time::sleep(Duration::from_millis(1500)).await;
    copy(&data, &sources.older[1]);
    store(&plc, 0.0).await;
    run_until_waiting(&plc).await;
    copy(&data, &sources.good);
    runtime.shutdown().await;
    fs::remove_dir_all(&data).unwrap();
    let config = fs::read_to_string(machine.config()).unwrap();
    machine.write("tandem.toml", &config.replace("test-1", "test-2"));
    let runtime = start(machine).await;
    store(&Plc::in_process(runtime.port()), 300.0).await;
    runtime.shutdown().await;
    copy(&data, &sources.other);
    machine.write("tandem.toml", &config);
    copy(&sources.good, &data);
    let runtime = start(machine).await;
    let plc = Plc::in_process(runtime.port());
    let kept = read(&plc).await;
    assert_eq!(question(&plc).await, None, "a kill alone asks nothing");
    runtime.shutdown().await;
    (sources, kept)
}

async fn question(plc: &Plc) -> Option<StoredDataQuestion> {
    let message = plc.port().read(&Topic::StoredData).await.unwrap();
    let Payload::StoredData(stored) = &message.payload else {
        panic!("{message:?}");
    };
    stored.question.clone()
}

/// Returns the value of the clamp, and whether the state of the output is unknown.
async fn clamp(plc: &Plc) -> (bool, bool) {
    let state = plc.io_out("clamp").state().await.unwrap();
    (state.value.is_on(), state.unknown)
}

/// The clamp after a start that did not find its last value.
const UNKNOWN_OPEN: (bool, bool) = (false, true);

/// Numbers of all messages since the start.
async fn messages(plc: &Plc) -> Vec<u16> {
    let history = plc.port().ask(typed::AlarmHistory).await.unwrap();
    history.iter().map(|alarm| alarm.number).collect()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn exchanged_and_older_files_give_no_wrong_value_without_a_message() {
    let is_long = std::env::var_os("TANDEM_LONG").is_some();
    let rounds = if is_long { 1000 } else { EXCHANGES };
    let machine = Machine::new(MACHINE);
    let data = machine.path("tandem-data");
    let (sources, kept) = sources(&machine).await;
    let all = files(&sources.good);
    let mut figures = BTreeMap::<&str, u64>::new();
    for seed in 0..rounds {
        copy(&sources.good, &data);
        let mut random = Random(seed ^ 0xface);
        let mut how = format!("seed {seed}");
        for _ in 0..=random.below(2) {
            let original = &all[random.below(all.len())];
            let path = data.join(original.strip_prefix(&sources.good).unwrap());
            how.push_str("; ");
            how.push_str(&exchange(&sources, &path, original, &mut random));
        }
        let runtime = start(&machine).await;
        let plc = Plc::in_process(runtime.port());
        let found = read(&plc).await;
        let differs = |name: &&String| found.get(*name) != kept.get(*name);
        let wrong: Vec<&String> = found.keys().filter(differs).collect();
        for name in &wrong {
            // a foreign file in the folder is treated as a program, with a message; all other values stay right
            let may_change = ["program ", "folder of program ", "the last run"];
            let is_free = may_change.iter().any(|may| name.starts_with(may));
            assert!(is_free, "{name} is {:?}; {how}", found[*name]);
        }
        let missing = kept.keys().filter(|name| !found.contains_key(*name)).count();
        if !wrong.is_empty() || missing > 0 {
            let told = async || {
                let numbers = messages(&plc).await;
                let is_told = numbers.iter().any(|number| (406..=416).contains(number));
                is_told.then_some(())
            };
            until(&format!("a message that {wrong:?} or others differ; {how}"), told).await;
        }
        let asks = question(&plc).await.is_some();
        for (figure, counts) in [
            ("as they were", wrong.is_empty() && missing == 0),
            ("with values that are missing", missing > 0),
            ("with programs or folders that differ", !wrong.is_empty()),
            ("with a question", asks),
        ] {
            *figures.entry(figure).or_default() += u64::from(counts);
        }
        if asks {
            let load = plc.coordinate_system(2).mdi("G00 X1").await;
            assert!(load.is_err(), "nothing starts while a question is open; {how}");
        }
        runtime.shutdown().await;
    }
    eprintln!("{rounds} rounds, {} values in each: {figures:?}", kept.len());
}

/// Creates a folder into which half of a backup was restored.
async fn half_a_backup(machine: &Machine) -> Values {
    let (sources, kept) = sources(machine).await;
    let data = machine.path("tandem-data");
    copy(&sources.good, &data);
    for name in ["state.redb", "state.sums"] {
        fs::copy(sources.older[0].join(name), data.join(name)).unwrap();
    }
    kept
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_older_store_is_used_after_a_person_accepts_it_and_not_before() {
    let machine = Machine::new(MACHINE);
    let kept = half_a_backup(&machine).await;
    for _ in 0..2 {
        // a restart does not answer the question
        let runtime = start(&machine).await;
        let plc = Plc::in_process(runtime.port());
        let found = read(&plc).await;
        assert!(
            !found.contains_key("tool 5") && !found.contains_key("P0"),
            "{found:?}"
        );
        assert_eq!(clamp(&plc).await, UNKNOWN_OPEN);
        assert_eq!(found["program 1"], kept["program 1"]);
        let open = question(&plc).await.unwrap();
        assert_eq!(open.findings.len(), 1, "{open:?}");
        assert_eq!(open.findings[0].part, StoredDataPart::Store);
        assert_eq!(open.findings[0].fault, StoredDataFault::Older);
        assert!(open.newest_journal_entry.is_some());
        until("the alarm of the question", async || {
            alarms(&plc).await.contains(&416).then_some(())
        })
        .await;
        let refused = plc.coordinate_system(2).mdi("G00 X1").await.unwrap_err();
        assert!(refused.to_string().contains("older copy"), "{refused}");
        runtime.shutdown().await;
    }
    let runtime = start(&machine).await;
    let plc = Plc::in_process(runtime.port());
    let accept = StoredDataAnswer {
        decision: StoredDataDecision::Accept,
    };
    plc.port().ask(typed::AnswerStoredData(accept)).await.unwrap();
    assert_eq!(question(&plc).await, None);
    assert_eq!(clamp(&plc).await, UNKNOWN_OPEN, "an answer moves no output");
    let again = plc.port().ask(typed::AnswerStoredData(accept)).await;
    assert!(again.is_err(), "it is answered once");
    plc.coordinate_system(2).reset().await.unwrap();
    until("a line of the journal", async || {
        let mut lines = journal(&plc).await.into_values();
        lines
            .any(|line| line["event"] == "stored_data" && line["decision"] == "accept")
            .then_some(())
    })
    .await;
    runtime.shutdown().await;
    let runtime = start(&machine).await;
    let plc = Plc::in_process(runtime.port());
    let found = read(&plc).await;
    assert_eq!(question(&plc).await, None, "what was accepted is not asked again");
    let tool = ToolData {
        id: 5,
        radius: 5.0 + 2.0 + 100.0,
        length: 5.0 * 2.5 + 2.0,
    };
    assert_eq!(found["tool 5"], format!("{tool:?}"), "of the older copy");
    assert_eq!(found["the tool in the spindle"], "18");
    assert_eq!(clamp(&plc).await, UNKNOWN_OPEN, "until it is written");
    plc.io_out("clamp").set(true).await.unwrap();
    runtime.shutdown().await;
    let runtime = start(&machine).await;
    let plc = Plc::in_process(runtime.port());
    assert_eq!(clamp(&plc).await, (true, false));
    runtime.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_older_store_that_a_person_refuses_stays_lost_and_the_machine_works() {
    let machine = Machine::new(MACHINE);
    half_a_backup(&machine).await;
    for is_first in [true, false] {
        let runtime = start(&machine).await;
        let plc = Plc::in_process(runtime.port());
        assert_eq!(question(&plc).await.is_some(), is_first);
        if is_first {
            let refuse = StoredDataAnswer {
                decision: StoredDataDecision::Refuse,
            };
            plc.port().ask(typed::AnswerStoredData(refuse)).await.unwrap();
        }
        let found = read(&plc).await;
        assert!(
            !found.contains_key("tool 5") && !found.contains_key("P0"),
            "{found:?}"
        );
        assert_eq!(clamp(&plc).await, UNKNOWN_OPEN);
        until("the alarm of lost values", async || {
            alarms(&plc).await.contains(&406).then_some(())
        })
        .await;
        runtime.shutdown().await;
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_whole_backup_and_a_copy_for_another_machine_are_restored() {
    let machine = Machine::new(MACHINE);
    let (sources, _) = sources(&machine).await;
    let data = machine.path("tandem-data");
    copy(&sources.older[0], &data);
    let runtime = start(&machine).await;
    let plc = Plc::in_process(runtime.port());
    let older = read(&plc).await;
    assert_eq!(question(&plc).await, None, "a whole backup asks nothing");
    assert!(older["program 1"].contains("program 1, 100"));
    runtime.shutdown().await;
    // likewise for a machine of another name: a person confirms it once
    copy(&sources.older[0], &data);
    let config = fs::read_to_string(machine.config()).unwrap();
    machine.write("tandem.toml", &config.replace("test-1", "test-9"));
    let runtime = start(&machine).await;
    let plc = Plc::in_process(runtime.port());
    let open = question(&plc).await.unwrap();
    let faults: Vec<_> = open.findings.iter().map(|finding| finding.fault).collect();
    assert!(
        faults.iter().all(|fault| *fault == StoredDataFault::OtherMachine),
        "{open:?}"
    );
    assert_eq!(faults.len(), 4, "{open:?}");
    assert!(read(&plc).await.keys().all(|name| !name.starts_with("program ")));
    let accept = StoredDataAnswer {
        decision: StoredDataDecision::Accept,
    };
    plc.port().ask(typed::AnswerStoredData(accept)).await.unwrap();
    let mut found = read(&plc).await;
    let mut expected = older;
    // the end of the last run is not taken over
    found.remove("the last run");
    expected.remove("the last run");
    // an answer moves no output: it is unknown until it is written
    assert_eq!(found.remove(CLAMP), None);
    expected.remove(CLAMP);
    assert_eq!(found, expected);
    runtime.shutdown().await;
    let runtime = start(&machine).await;
    let plc = Plc::in_process(runtime.port());
    assert_eq!(question(&plc).await, None, "once");
    runtime.shutdown().await;
}
