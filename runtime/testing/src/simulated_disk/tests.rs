//! Tests of the simulated disk.

use std::io::{Read as _, Write as _};
use std::time::{Duration, SystemTime};

use tandem_store::disk::{OpenMode, open_regular, sync_folder};

use super::{ROOT, SimulatedDisk};

#[test]
fn a_power_cut_keeps_what_was_synced_and_a_kill_keeps_everything() {
    let disk = SimulatedDisk::new(1, SystemTime::UNIX_EPOCH + Duration::from_secs(1));
    let root = disk.mount().at(ROOT);
    let path = root.join("a");
    let mut file = open_regular(&path, OpenMode::ReadAppend).unwrap();
    file.write_all(b"kept").unwrap();
    file.sync_all().unwrap();
    sync_folder(&root).unwrap();
    file.write_all(&[7; 10 * 512]).unwrap();
    disk.lock().kill();
    assert!(file.write_all(b"more").is_err() && disk.is_dead());
    let path = disk.mount().at(ROOT).join("a");
    assert!(file.write_all(b"more").is_err(), "of another process");
    assert_eq!(path.metadata().unwrap().length, 4 + 10 * 512);
    disk.lock().cut_power();
    let path = disk.mount().at(ROOT).join("a");
    let mut bytes = Vec::new();
    let mut file = open_regular(&path, OpenMode::Read).unwrap();
    file.read_to_end(&mut bytes).unwrap();
    assert!(bytes.starts_with(b"kept"));
}
