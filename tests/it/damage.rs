//! Campaigns over all files of a data folder left by a kill: damage, exchanges with other files, older copies and files
//! of another machine. Each value read is the stored one, or a message names the fault. Pending outputs are
//! reported, and the machine starts in every case.

mod exchange;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use plc_api::Plc;
use plc_protocol::types::data::{JournalFilter, ToolChange, ToolData, VariableArea, WorkOffsetTable};
use plc_protocol::types::io::IoPoint;
use plc_protocol::types::message::Payload;
use plc_protocol::types::program::ProgramFolder;
use plc_protocol::types::request::typed;
use plc_protocol::types::topic::{CsTopic, Topic};
use serde_json::Value;
use tandem_runtime::{Config, Runtime};

use crate::support::machine::Machine;
use crate::support::wait::until;

/// Rounds of each run; with `TANDEM_LONG`, 1000.
const ROUNDS: u64 = 60;

/// The machine: M100 stays pending, and an output starts with its last value.
const MACHINE: &str =
    "[m_code.100]\nunhandled = \"wait\"\n[io.out.clamp]\non_loss = \"keep\"\nat_start = \"last\"\n";

/// Number of variables that are read together: those of one page.
const PAGE: u32 = 128;

/// Random numbers from a seed (`SplitMix64`).
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn below(&mut self, end: usize) -> usize {
        usize::try_from(self.next() % end.max(1) as u64).unwrap()
    }
}

/// The name of the output that begins with its last value.
const CLAMP: &str = "the output clamp";

/// All values that a client can read, by name. Refused or unknown values are missing.
type Values = BTreeMap<String, String>;

async fn read(plc: &Plc) -> Values {
    let mut values = Values::new();
    for (area, letter, end) in [
        (VariableArea::Global, "P", 2048),
        (VariableArea::CoordinateSystem(1), "Q", 512),
    ] {
        for from in (0..end).step_by(PAGE as usize) {
            let (count, meta) = (PAGE, None);
            let asked = typed::ReadVariables {
                area,
                from,
                count,
                meta,
            };
            if let Ok(read) = plc.port().ask(asked).await {
                let bits: Vec<u64> = read.iter().map(|value| value.to_bits()).collect();
                values.insert(format!("{letter}{from}"), format!("{bits:x?}"));
            }
        }
    }
    for tool in plc.port().ask(typed::Tools).await.unwrap().tools {
        values.insert(format!("tool {}", tool.id), format!("{tool:?}"));
    }
    let offsets = plc.port().ask(typed::WorkOffsets(1)).await.unwrap();
    for (name, axes) in offsets.work_offsets {
        for (axis, value) in axes {
            values.insert(format!("{name} {axis}"), value.to_string());
        }
    }
    if let Some(message) = plc.port().read(&Topic::cs(1, CsTopic::Tool)).await
        && let Payload::Tool(tool) = &message.payload
    {
        values.insert("the tool in the spindle".to_owned(), tool.id.to_string());
    }
    if let Some(message) = plc.port().read(&Topic::Io(IoPoint::output("clamp"))).await
        && let Payload::Io(state) = &message.payload
        && !state.unknown
    {
        values.insert(CLAMP.to_owned(), state.value.to_string());
    }
    for program in plc.port().ask(typed::Programs).await.unwrap() {
        // a lost folder is reported by a message, and the program is in no folder
        if !program.folder.is_empty() {
            values.insert(format!("folder of program {}", program.number), program.folder);
        }
    }
    for number in 1..6 {
        if let Ok(text) = plc.port().ask(typed::ReadProgram(number)).await {
            values.insert(format!("program {number}"), text);
        }
    }
    if let Some(run) = plc.port().ask(typed::LastRun(1)).await.unwrap() {
        // if it is lost, the journal has the same data
        let open = run
            .outputs
            .iter()
            .map(|open| (open.output.seq, open.output.m, &open.output.params));
        let open: Vec<_> = open.collect();
        let told = (&run.boot_id, &run.run_id, run.program, run.execution, open);
        values.insert("the last run".to_owned(), format!("{told:?}"));
    }
    values
}

async fn journal(plc: &Plc) -> BTreeMap<u64, Value> {
    let (from, count, filter) = (0, 1000, JournalFilter::default());
    let lines = plc
        .port()
        .ask(typed::Journal { from, count, filter })
        .await
        .unwrap();
    let numbered = lines.into_iter().map(|mut line| {
        // from earlier lines, which may be lost
        line.as_object_mut().unwrap().remove("hash");
        (line["n"].as_u64().unwrap_or(0), line)
    });
    numbered.collect()
}

async fn is_waiting(plc: &Plc) -> bool {
    let pending = plc.port().read(&Topic::cs(1, CsTopic::Pending)).await;
    pending.is_some_and(
        |pending| matches!(&pending.payload, Payload::Pending(pending) if !pending.outputs.is_empty()),
    )
}

/// Numbers of the active alarms.
async fn alarms(plc: &Plc) -> Vec<u16> {
    let message = plc.port().read(&Topic::AlarmActive).await.unwrap();
    let Payload::AlarmActive(active) = &message.payload else {
        panic!("{message:?}");
    };
    active.alarms.iter().map(|alarm| alarm.number).collect()
}

async fn start(machine: &Machine) -> Runtime {
    let config = Config::read(&machine.config()).unwrap();
    let started = Runtime::start(config).await;
    started.unwrap_or_else(|error| panic!("a refusal to start: {error}"))
}

/// Runs a machine that stores a value of each kind, and kills it while an M code is pending; returns the
/// stored values. `good` is then the data folder after the kill.
async fn fill(machine: &Machine, good: &Path) -> (Values, BTreeMap<u64, Value>) {
    let runtime = start(machine).await;
    let plc = Plc::in_process(runtime.port());
    store(&plc, 0.0).await;
    run_until_waiting(&plc).await;
    copy(&machine.path("tandem-data"), good);
    runtime.shutdown().await;
    copy(good, &machine.path("tandem-data"));
    // messages of a start with this folder
    let runtime = start(machine).await;
    let plc = Plc::in_process(runtime.port());
    let kept = (read(&plc).await, journal(&plc).await);
    runtime.shutdown().await;
    kept
}

/// Stores a value of each kind; a different `shift` gives different values.
async fn store(plc: &Plc, shift: f64) {
    let write = async |area, from, values| {
        let meta = None;
        let request = typed::WriteVariables {
            area,
            from,
            values,
            meta,
        };
        plc.port().ask(request).await.unwrap();
    };
    for from in (0..2048).step_by(PAGE as usize) {
        let values = (from..from + PAGE)
            .map(|n| f64::from(n) * 1.25 + 0.1 + shift)
            .collect();
        write(VariableArea::Global, from, values).await;
    }
    write(VariableArea::CoordinateSystem(1), 0, vec![shift - 7.5; 512]).await;
    for round in 0..3 {
        let tool = |id| ToolData {
            id,
            radius: f64::from(id) + f64::from(round) + shift,
            length: f64::from(id) * 2.5 + f64::from(round),
        };
        let change = ToolChange {
            tools: (1..40).map(tool).collect(),
            remove: Vec::new(),
        };
        plc.port().ask(typed::WriteTools(change)).await.unwrap();
        let axes = ["X", "Y", "Z"].map(|axis| (axis.to_owned(), f64::from(round) + 0.5 + shift));
        let offsets = ["G54", "G57"].map(|name| (name.to_owned(), axes.clone().into()));
        let change = WorkOffsetTable {
            work_offsets: offsets.into(),
        };
        plc.port().ask(typed::WriteWorkOffsets(1, change)).await.unwrap();
    }
    let tool = if shift == 0.0 { 17 } else { 18 };
    plc.coordinate_system(1).select_tool(tool).await.unwrap();
    plc.io_out("clamp").set(shift == 0.0).await.unwrap();
    for number in 1..6_u16 {
        let text = format!("// program {number}, {shift}\nM100 VA3\n")
            + &format!("G00 X{number}\n").repeat(100)
            + "M30\n";
        plc.port().ask(typed::WriteProgram(number, text)).await.unwrap();
        let folder = ProgramFolder {
            folder: format!("series {shift}"),
        };
        plc.port().ask(typed::PutInFolder(number, folder)).await.unwrap();
    }
}

/// Starts a run and waits until it is stored.
async fn run_until_waiting(plc: &Plc) {
    let cs = plc.coordinate_system(1);
    cs.load(1).await.unwrap();
    cs.start().await.unwrap();
    until("an open M code", async || is_waiting(plc).await.then_some(())).await;
    // until it is stored, and the anchor of the journal includes it
    tokio::time::sleep(Duration::from_millis(1500)).await;
}

fn files(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(files(&path));
        } else if path.file_name().unwrap() != "lock" {
            found.push(path);
        }
    }
    found.sort();
    found
}

/// Copies a folder, with the times of its files.
fn copy(from: &Path, to: &Path) {
    if to.exists() {
        fs::remove_dir_all(to).unwrap();
    }
    for path in files(from) {
        let copy = to.join(path.strip_prefix(from).unwrap());
        fs::create_dir_all(copy.parent().unwrap()).unwrap();
        fs::copy(&path, &copy).unwrap();
        keep_time(&copy, &path);
    }
}

fn keep_time(path: &Path, of: &Path) {
    let time = fs::metadata(of).unwrap().modified().unwrap();
    let file = fs::File::options().write(true).open(path).unwrap();
    file.set_modified(time).unwrap();
}

/// Damages a file as a disk does, without changing its time; returns a description.
fn damage(path: &Path, of: &Path, random: &mut Random) -> String {
    let mut bytes = fs::read(path).unwrap();
    let (at, end) = (random.below(bytes.len()), bytes.len());
    let how = match random.below(5) {
        _ if bytes.is_empty() => "nothing",
        0 | 1 => {
            bytes[at] ^= 1 << random.below(8);
            "a bit is flipped"
        }
        2 => {
            for _ in 0..8 {
                let at = random.below(end);
                bytes[at] ^= 1 << random.below(8);
            }
            "eight bits are flipped"
        }
        3 => {
            let until = end.min(at + 1 + random.below(4096));
            bytes.drain(at..until);
            "a part is cut out"
        }
        _ => {
            bytes.truncate(at);
            "the end is cut off"
        }
    };
    fs::write(path, bytes).unwrap();
    keep_time(path, of);
    format!("{} at {at} of {end}: {how}", path.display())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn damage_in_the_data_folder_gives_no_wrong_value_and_the_start_works() {
    let is_long = std::env::var_os("TANDEM_LONG").is_some();
    let rounds = if is_long { 1000 } else { ROUNDS };
    let machine = Machine::new(MACHINE);
    let (data, good) = (machine.path("tandem-data"), machine.path("good"));
    let (kept, lines) = fill(&machine, &good).await;
    assert!(kept["the last run"].contains("100"), "{kept:?}");
    assert_eq!(kept[CLAMP], "true");
    let all = files(&good);
    assert!(all.len() >= 11, "{all:?}");
    let mut lost = BTreeMap::<String, usize>::new();
    for seed in 0..rounds {
        copy(&good, &data);
        let mut random = Random(seed);
        let original = &all[random.below(all.len())];
        let path = data.join(original.strip_prefix(&good).unwrap());
        let how = format!("seed {seed}: {}", damage(&path, original, &mut random));
        let runtime = start(&machine).await;
        let plc = Plc::in_process(runtime.port());
        let found = read(&plc).await;
        for (name, value) in &found {
            assert_eq!(Some(value), kept.get(name), "{name} is wrong; {how}");
        }
        let boot = plc.port().boot_id().0;
        for (n, line) in journal(&plc).await {
            // a line written by this start may have the number of a line that was cut off
            let known = lines.get(&n).filter(|_| line["boot_id"] != boot.as_str());
            assert!(
                known.is_none_or(|known| *known == line),
                "line {n} is wrong: {line}; {how}"
            );
        }
        let missing: Vec<&String> = kept.keys().filter(|name| !found.contains_key(*name)).collect();
        if !missing.is_empty() {
            let told = async || {
                let active = alarms(&plc).await;
                active
                    .iter()
                    .any(|number| (406..=410).contains(number))
                    .then_some(())
            };
            until(&format!("an alarm that {missing:?} are lost; {how}"), told).await;
        }
        let file = original.strip_prefix(&good).unwrap().display().to_string();
        *lost.entry(file).or_default() += missing.len();
        runtime.shutdown().await;
    }
    eprintln!(
        "{rounds} rounds, {} values in each; lost by file: {lost:#?}",
        kept.len()
    );
}
