//! Odd, damaged and unwritable files in the data folder: none prevents a start, and each is reported.

use std::fs;
use std::os::unix::fs::{PermissionsExt as _, symlink};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use serde_json::{Value, json};

use crate::support::http::request;
use crate::support::machine::Machine;
use crate::support::served::{FREE_PORTS, Served};
use crate::support::wait::until;

pub(super) fn machine() -> Machine {
    Machine::new(&format!("[m_code.100]\nunhandled = \"wait\"\n{FREE_PORTS}"))
}

/// Returns a path in the data folder.
pub(super) fn place(machine: &Machine, name: &str) -> PathBuf {
    machine.path("tandem-data").join(name)
}

async fn delete(served: &Served, number: u16) -> u16 {
    let path = format!("/api/v1/programs/{number}");
    request(&served.http, "DELETE", &path, "", "").await.status
}

/// The active alarm of a number.
pub(super) async fn standing(served: &Served, number: u16) -> Option<Value> {
    let active = served.get("/alarms").await.expect(200).json();
    let alarms = active["alarms"].as_array().unwrap().clone();
    alarms.into_iter().find(|alarm| alarm["number"] == number)
}

pub(super) async fn text_of_standing(served: &Served, number: u16) -> String {
    let alarm = until(&format!("alarm {number}"), async || {
        standing(served, number).await
    })
    .await;
    alarm["text"].as_str().unwrap().to_owned()
}

pub(super) async fn until_gone(served: &Served, number: u16) {
    until(&format!("alarm {number} is gone"), async || {
        standing(served, number).await.is_none().then_some(())
    })
    .await;
}

/// The warnings of a number in the history.
async fn warned(served: &Served, number: u16) -> Vec<String> {
    let history = served.get("/alarms/history").await.expect(200).json();
    let alarms = history["alarms"].as_array().unwrap().iter();
    alarms
        .filter(|alarm| alarm["number"] == number)
        .map(|alarm| alarm["text"].as_str().unwrap().to_owned())
        .collect()
}

fn flip(path: &Path, place: usize) {
    let mut bytes = fs::read(path).unwrap();
    bytes[place] ^= 0x80;
    fs::write(path, bytes).unwrap();
}

/// Damages the file as a disk does: the file keeps its time.
pub(super) fn rot(path: &Path, place: usize) {
    let time = fs::metadata(path).unwrap().modified().unwrap();
    flip(path, place);
    fs::File::options()
        .write(true)
        .open(path)
        .unwrap()
        .set_modified(time)
        .unwrap();
}

#[tokio::test]
async fn a_damaged_journal_never_keeps_a_machine_from_starting_and_is_named() {
    let machine = machine();
    let served = Served::start(&machine);
    let journal = place(&machine, "journal/journal.jsonl");
    until("the journal has lines", async || {
        fs::metadata(&journal)
            .is_ok_and(|file| file.len() > 100)
            .then_some(())
    })
    .await;
    drop(served);
    // only the first line is left, so the chain of lines cannot continue when it is damaged
    let text = fs::read_to_string(&journal).unwrap();
    fs::write(&journal, text.split_inclusive('\n').next().unwrap()).unwrap();
    flip(&journal, 20);
    let served = Served::start(&machine);
    let warnings = warned(&served, 411).await;
    assert_eq!(warnings.len(), 2, "{warnings:?}");
    assert!(
        warnings
            .iter()
            .any(|text| text.contains("journal/journal.jsonl: 1 damaged lines")),
        "{warnings:?}"
    );
    assert!(
        warnings
            .iter()
            .any(|text| text.contains("a new chain of lines begins: the last line is damaged")),
        "{warnings:?}"
    );
    let lines = served.get("/journal").await.expect(200).json();
    assert!(!lines["lines"].as_array().unwrap().is_empty());
}

#[tokio::test]
async fn a_journal_that_cannot_be_opened_is_a_warning_that_stands_until_it_can() {
    let machine = machine();
    drop(Served::start(&machine));
    let folder = place(&machine, "journal");
    fs::remove_dir_all(&folder).unwrap();
    fs::write(&folder, "no folder").unwrap();
    let served = Served::start(&machine);
    let text = text_of_standing(&served, 403).await;
    assert!(text.contains("tandem-data/journal"), "{text}");
    served.command(1, "reset").await;
    assert!(standing(&served, 403).await.is_some(), "no reset makes it right");
    fs::remove_file(&folder).unwrap();
    until_gone(&served, 403).await;
    assert!(folder.join("journal.jsonl").is_file());
}

#[tokio::test]
async fn what_is_no_program_in_the_place_of_one_is_named_and_the_machine_starts() {
    let machine = machine();
    let programs = place(&machine, "programs");
    fs::create_dir_all(programs.join("71.nc")).unwrap();
    symlink("nowhere", programs.join("72.nc")).unwrap();
    let fifo = Command::new("mkfifo").arg(programs.join("73.nc")).status();
    assert!(fifo.unwrap().success());
    let _socket = std::os::unix::net::UnixListener::bind(programs.join("74.nc")).unwrap();
    fs::write(programs.join("75.nc"), "M30\n").unwrap();
    let served = Served::start(&machine);
    served.get("/programs/75").await.expect(200);
    let text = text_of_standing(&served, 409).await;
    for number in 71..75 {
        assert!(text.contains(&format!("programs/{number}.nc")), "{text}");
        served.get(&format!("/programs/{number}")).await.expect(404);
    }
}

#[tokio::test]
async fn a_program_has_one_name_and_a_deleted_one_stays_deleted() {
    let machine = machine();
    let programs = place(&machine, "programs");
    fs::create_dir_all(&programs).unwrap();
    fs::write(programs.join("O90.nc"), "// O90\nM30\n").unwrap();
    fs::write(programs.join("091.nc"), "// 091\nM30\n").unwrap();
    fs::write(programs.join("91.nc"), "// 91\nM30\n").unwrap();
    let served = Served::start(&machine);
    assert_eq!(served.get("/programs/90").await.expect(200).body, "// O90\nM30\n");
    assert_eq!(served.get("/programs/91").await.expect(200).body, "// 91\nM30\n");
    let text = text_of_standing(&served, 409).await;
    assert!(text.contains("091.nc: rename it to 91.nc"), "{text}");
    for number in [90, 91] {
        assert_eq!(delete(&served, number).await, 204);
    }
    drop(served);
    let served = Served::start(&machine);
    served.get("/programs/90").await.expect(404);
    served.get("/programs/91").await.expect(404);
}

#[tokio::test]
async fn a_folder_of_programs_that_is_gone_is_told() {
    let machine = machine();
    let served = Served::start(&machine);
    served.put_program(7, "M30\n").await.expect(201);
    drop(served);
    fs::remove_dir_all(place(&machine, "programs")).unwrap();
    let served = Served::start(&machine);
    let text = text_of_standing(&served, 410).await;
    assert!(text.contains("programs: the folder was missing"), "{text}");
}

#[tokio::test]
async fn half_an_upload_is_removed_and_no_upload_goes_through_a_link() {
    let machine = machine();
    let programs = place(&machine, "programs");
    fs::create_dir_all(&programs).unwrap();
    let (half, theirs) = (programs.join("300.nc.new"), machine.write("theirs", "theirs"));
    fs::write(&half, "G01 X").unwrap();
    let served = Served::start_with_failing_disk(&machine);
    assert!(!half.exists());
    symlink(&theirs, programs.join("96.nc.new")).unwrap();
    symlink(&theirs, programs.join("96.nc")).unwrap();
    served.put_program(96, "M30\n").await.expect(201);
    assert_eq!(fs::read_to_string(&theirs).unwrap(), "theirs");
    served.process.limit_file_bytes("65536:");
    served
        .put_program(300, &"// long\n".repeat(20_000))
        .await
        .expect(503);
    let names = fs::read_dir(&programs).unwrap();
    let names: Vec<String> = names
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    assert!(!names.iter().any(|name| name.starts_with("300")), "{names:?}");
    assert!(warned(&served, 404).await[0].contains("tandem-data/programs"));
    // smaller ones fit
    until_gone(&served, 404).await;
    served.put_program(301, "M30\n").await.expect(201);
}

#[tokio::test]
async fn nobody_else_may_read_what_is_kept() {
    fn check(folder: &Path, found: &mut usize) {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let metadata = fs::metadata(&path).unwrap();
            let expected = if metadata.is_dir() { 0o700 } else { 0o600 };
            assert_eq!(
                metadata.permissions().mode() & 0o777,
                expected,
                "{}",
                path.display()
            );
            *found += 1;
            if metadata.is_dir() {
                check(&path, found);
            }
        }
    }
    let machine = machine();
    let programs = place(&machine, "programs");
    fs::create_dir_all(&programs).unwrap();
    fs::write(programs.join("75.nc"), "M30\n").unwrap();
    let served = Served::start(&machine);
    served.put_program(8, "M30\n").await.expect(201);
    served
        .put("/tools", &json!({"tools": [{"id": 1}]}))
        .await
        .expect(204);
    let mut found = 0;
    check(&place(&machine, ""), &mut found);
    assert!(found >= 8, "{found}");
}

#[tokio::test]
async fn removed_data_folder_raises_alarms_and_refuses_persistent_changes() {
    let machine = machine();
    let served = Served::start(&machine);
    served
        .put("/tools", &json!({"tools": [{"id": 1, "length": 5}]}))
        .await
        .expect(204);
    let (folder, away) = (machine.path("tandem-data"), machine.path("away"));
    fs::rename(&folder, &away).unwrap();
    served
        .put("/tools", &json!({"tools": [{"id": 2}]}))
        .await
        .expect(503);
    served.put_program(8, "M30\n").await.expect(503);
    let text = text_of_standing(&served, 405).await;
    assert!(text.contains("tandem-data: the folder does not exist"), "{text}");
    text_of_standing(&served, 402).await;
    text_of_standing(&served, 403).await;
    fs::rename(&away, &folder).unwrap();
    for number in [402, 403, 404, 405] {
        until_gone(&served, number).await;
    }
    served
        .put("/tools", &json!({"tools": [{"id": 2}]}))
        .await
        .expect(204);
    // a folder that was lost completely is written again, because the machine still has all its data
    fs::remove_dir_all(&folder).unwrap();
    text_of_standing(&served, 402).await;
    fs::create_dir(&folder).unwrap();
    until_gone(&served, 402).await;
    drop(served);
    let served = Served::start(&machine);
    let tools = served.get("/tools").await.expect(200).json();
    assert_eq!(tools["tools"][0]["length"], 5.0);
}

#[tokio::test]
async fn full_disk_alarms_store_journal_and_programs_and_clears_by_itself() {
    let machine = machine();
    let served = Served::start_with_failing_disk(&machine);
    served.process.limit_file_bytes("1:");
    served
        .put("/tools", &json!({"tools": [{"id": 1}]}))
        .await
        .expect(503);
    served.put_program(8, "M30\n").await.expect(503);
    served.command(1, "reset").await;
    for number in [402, 403, 404] {
        text_of_standing(&served, number).await;
    }
    served.process.limit_file_bytes("unlimited:");
    for number in [402, 403, 404] {
        until_gone(&served, number).await;
    }
    served
        .put("/tools", &json!({"tools": [{"id": 1}]}))
        .await
        .expect(204);
    let lost = until("the journal says what it lacks", async || {
        let journal = served.get("/journal").await.expect(200).json();
        let lines = journal["lines"].as_array().unwrap().clone();
        lines.into_iter().find(|line| line["event"] == "lost")
    });
    assert!(lost.await["lines"].as_u64().unwrap() > 0);
}

#[tokio::test]
async fn a_program_that_is_changed_outside_is_told_and_must_be_loaded_again() {
    let machine = machine();
    let served = Served::start(&machine);
    served.load(1, 50, "M98 P1051\nM30\n").await;
    served.put_program(1051, "G00 X1\nM99\n").await.expect(201);
    served.command(1, "start").await;
    served.execution(1, "PROGRAM_COMPLETED").await;
    fs::write(place(&machine, "programs/1051.nc"), "G00 X2\nM99\n").unwrap();
    until("it is told", async || {
        let warnings = warned(&served, 408).await;
        warnings
            .iter()
            .any(|text| text.contains("program 1051") && text.contains("load the program again"))
            .then_some(())
    })
    .await;
    until("the journal tells it", async || {
        let journal = served.get("/journal").await.expect(200).body;
        (journal.contains("\"warning\"") && journal.contains("program 1051")).then_some(())
    })
    .await;
    assert_eq!(
        served.get("/programs/1051").await.expect(200).body,
        "G00 X2\nM99\n"
    );
    let refused = served
        .post("/cs/1/start?wait=1", &Value::Null)
        .await
        .expect(409)
        .json();
    assert!(
        refused["detail"].as_str().unwrap().contains("load it again"),
        "{refused}"
    );
    served
        .post("/cs/1/load?wait=1", &json!({"program": 50}))
        .await
        .expect(200);
    served.command(1, "start").await;
    served.execution(1, "PROGRAM_COMPLETED").await;
    assert_eq!(
        served.get("/cs/1/position").await.expect(200).json()["machine"]["X"],
        2.0
    );
}

#[tokio::test]
async fn damaged_program_is_an_alarm_and_unusable_until_stored_again() {
    let machine = machine();
    let served = Served::start(&machine);
    served.put_program(50, "M98 P1051\nM30\n").await.expect(201);
    served.put_program(1051, "G00 X1\nM99\n").await.expect(201);
    drop(served);
    rot(&place(&machine, "programs/1051.nc"), 5);
    for _ in 0..2 {
        let served = Served::start(&machine);
        let text = text_of_standing(&served, 407).await;
        assert!(text.contains("program 1051"), "{text}");
        let refused = served.get("/programs/1051").await.expect(503).json();
        assert!(
            refused["detail"].as_str().unwrap().contains("damaged"),
            "{refused}"
        );
        // a program that calls it is refused, too
        let load = served.post("/cs/1/load?wait=1", &json!({"program": 50})).await;
        assert!(
            load.expect(503).json()["detail"]
                .as_str()
                .unwrap()
                .contains("program 1051 is damaged")
        );
    }
    let served = Served::start(&machine);
    served.put_program(1051, "G00 X1\nM99\n").await.expect(201);
    until_gone(&served, 407).await;
    served
        .post("/cs/1/load?wait=1", &json!({"program": 50}))
        .await
        .expect(200);
    drop(served);
    let served = Served::start(&machine);
    assert!(standing(&served, 407).await.is_none());
    assert_eq!(delete(&served, 1051).await, 204);
}

#[tokio::test]
async fn output_published_before_a_kill_is_reported_as_pending_after_it() {
    let machine = machine();
    let mut served = Served::start(&machine);
    served.load(1, 50, "M100 VA3\nM100 VA4\nM30\n").await;
    for round in 0..15_u64 {
        let watch = served.watch(&["cs/1/m_code/pending"]).await;
        served.post("/cs/1/start", &Value::Null).await.expect(202);
        let heard = |force: f64| {
            let messages = watch.history.on("cs/1/m_code/pending");
            let mut open = messages.iter().map(|message| &message["outputs"][0]);
            open.find(|open| open["params"]["A"] == force).cloned()
        };
        let first = loop {
            match heard(3.0) {
                Some(first) => break first,
                None => tokio::task::yield_now().await,
            }
        };
        // every second time the first output is reset, and the second one is pending
        let is_reset = round % 2 == 1;
        if is_reset {
            let boot_id = watch.history.on("cs/1/m_code/pending")[0]["boot_id"].clone();
            let reset = json!({"boot_id": boot_id, "handler_id": "panel", "result": "ok", "force": true});
            let path = format!("/cs/1/m_codes/{}/reset", first["seq"]);
            served.post(&path, &reset).await.expect(200);
            while heard(4.0).is_none() {
                tokio::task::yield_now().await;
            }
        }
        tokio::time::sleep(Duration::from_micros(300 * round)).await;
        drop(served);
        served = Served::start(&machine);
        let last_run = served.get("/cs/1/last_run").await.expect(200).json()["last_run"].clone();
        assert_eq!(last_run["execution"], "WAIT", "round {round}: {last_run}");
        let open = last_run["outputs"].as_array().unwrap().iter();
        let open: Vec<_> = open.map(|output| output["params"]["A"].as_f64()).collect();
        let expected = if is_reset { 4.0 } else { 3.0 };
        assert_eq!(open, [Some(expected)], "round {round}: {last_run}");
        served.command(1, "reset").await;
        served
            .post("/cs/1/load?wait=1", &json!({"program": 50}))
            .await
            .expect(200);
    }
}
