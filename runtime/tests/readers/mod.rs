//! Reads a data folder with arbitrary bytes in its files; fuzzers and the robustness test share this module.

#![allow(
    clippy::expect_used,
    clippy::panic,
    reason = "in a test and in a fuzzer a panic is a finding"
)]

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use plc_api::Plc;
use plc_protocol::types::data::{ToolChange, ToolData, VariableArea};
use plc_protocol::types::request::typed;
use serde_json::{Map, Value};
use tandem_runtime::data_folder::DataFolder;
use tandem_runtime::{Config, Runtime};
use tempfile::TempDir;

/// A machine with one axis and a data folder next to its configuration.
const MACHINE: &str = "[machine]\nname = \"kept-1\"\n[[motor]]\nnumber = 1\nkind = \"linear\"\nmax_velocity = 100.0\n\
                       max_acceleration = 1000.0\n[[coordinate_system]]\nnumber = 1\naxes = { X = 1 }\nmax_feedrate = 6000.0\n";

/// An intact data folder.
struct Kept {
    _folder: TempDir,
    data: PathBuf,
    files: Vec<PathBuf>,
    values: Map<String, Value>,
}

/// Creates a temporary folder, in memory if possible, because the results do not depend on the disk.
fn scratch() -> TempDir {
    tempfile::tempdir_in("/dev/shm").unwrap_or_else(|_| tempfile::tempdir().expect("a folder"))
}

fn config(folder: &Path) -> Config {
    Config::from_toml(MACHINE, folder).expect("a configuration")
}

fn open(folder: &Path) -> DataFolder {
    let machine = config(folder).resolve().expect("a machine");
    DataFolder::open(machine.stored()).expect("whatever is in it")
}

/// Returns the values that are read; lost values are null.
fn values(folder: &DataFolder) -> Map<String, Value> {
    let mut document: Value = serde_json::from_str(&folder.export()).expect("a document");
    match document["values"].take() {
        Value::Object(values) => values,
        other => panic!("{other}"),
    }
}

fn files(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).expect("a folder") {
        let path = entry.expect("an entry").path();
        if path.is_dir() {
            files(&path, found);
        } else if path.file_name().is_some_and(|name| name != "lock") {
            found.push(path);
        }
    }
}

async fn fill(folder: &Path) {
    let runtime = Runtime::start(config(folder)).await.expect("a start");
    let plc = Plc::in_process(runtime.port());
    let written = typed::WriteVariables {
        area: VariableArea::Global,
        from: 3,
        values: vec![1.5, f64::NAN, -0.0],
        meta: None,
    };
    plc.port().ask(written).await.expect("written");
    let tools = (1..4).map(|id| ToolData {
        id,
        radius: f64::from(id),
        length: 20.5,
    });
    let change = ToolChange {
        tools: tools.collect(),
        remove: Vec::new(),
    };
    plc.port().ask(typed::WriteTools(change)).await.expect("written");
    let program = typed::WriteProgram(7, "G00 X1\nM30\n".to_owned());
    plc.port().ask(program).await.expect("written");
    plc.coordinate_system(1).load(7).await.expect("loaded");
    runtime.shutdown().await;
}

fn kept() -> &'static Kept {
    static KEPT: OnceLock<Kept> = OnceLock::new();
    KEPT.get_or_init(|| {
        let folder = scratch();
        let tokio = tokio::runtime::Runtime::new().expect("an executor");
        // the second start writes the last good generation
        tokio.block_on(fill(folder.path()));
        tokio.block_on(fill(folder.path()));
        let data = folder.path().join("tandem-data");
        let mut all = Vec::new();
        files(&data, &mut all);
        all.sort();
        assert!(all.len() >= 7, "{all:?}");
        let values = values(&open(folder.path()));
        Kept {
            _folder: folder,
            data,
            files: all,
            values,
        }
    })
}

/// Damages a file at a place in one of four ways, with these bytes.
fn damage(file: &Path, how: u8, place: usize, bytes: &[u8]) {
    let mut content = fs::read(file).expect("a file");
    let place = place % (content.len() + 1);
    match how % 4 {
        0 => content = bytes.to_vec(),
        1 => {
            let end = content.len().min(place + bytes.len());
            content.splice(place..end, bytes.iter().copied());
        }
        2 => content.truncate(place),
        _ => {
            content.splice(place..place, bytes.iter().copied());
        }
    }
    fs::write(file, content).expect("written");
}

/// Checks that each value read is null or the stored value.
fn check(folder: &DataFolder, kept: &Map<String, Value>) {
    let findings = folder.verify();
    for (name, value) in values(folder) {
        let was = kept.get(&name).unwrap_or(&Value::Null);
        let is_right = |value: &Value, was: &Value| value.is_null() || value == was;
        let is_whole = match (&value, was) {
            (Value::Array(values), Value::Array(were)) => {
                values.len() == were.len() && values.iter().zip(were).all(|(value, was)| is_right(value, was))
            }
            (value, was) => is_right(value, was),
        };
        assert!(is_whole, "{name} is {value} and was {was}: {findings:?}");
    }
}

/// Damages one file of a data folder, and checks that opening, verifying and repairing return only stored
/// values. The first bytes of `data` select the file, the place and the kind of damage.
pub fn data_folder(data: &[u8]) {
    let [which, how, low, middle, high, bytes @ ..] = data else {
        return;
    };
    let kept = kept();
    let folder = scratch();
    let copy = folder.path().join("tandem-data");
    let target = |file: &PathBuf| copy.join(file.strip_prefix(&kept.data).expect("within"));
    for file in &kept.files {
        let to = target(file);
        fs::create_dir_all(to.parent().expect("a folder")).expect("made");
        fs::copy(file, to).expect("copied");
    }
    let file = &kept.files[usize::from(*which) % kept.files.len()];
    let place = u32::from_le_bytes([*low, *middle, *high, 0]);
    damage(
        &target(file),
        *how,
        usize::try_from(place).expect("3 bytes"),
        bytes,
    );
    let mut opened = open(folder.path());
    check(&opened, &kept.values);
    // an impossible repair is refused
    let _ = opened.repair();
    drop(opened);
    let again = open(folder.path());
    for (name, value) in values(&again) {
        assert!(
            value.is_null() || kept.values.contains_key(&name),
            "{name} is {value}"
        );
    }
}
