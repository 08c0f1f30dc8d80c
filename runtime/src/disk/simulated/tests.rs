//! Tests of the disk in memory.

use std::io::{Read as _, Write as _};
use std::time::Duration;

use std::path::Path;
use std::sync::Arc;
use std::time::SystemTime;

use parking_lot::Mutex;

use super::memory::{Disk, Mount};
use super::*;

#[test]
fn a_power_cut_keeps_what_was_synced_and_a_kill_keeps_everything() {
    let disk = Arc::new(Mutex::new(Disk::new(
        1,
        SystemTime::UNIX_EPOCH + Duration::from_secs(1),
    )));
    Mount::mount(&disk);
    let path = Path::new(ROOT).join("a");
    let mut file = OpenOptions::new().append(true).create(true).open(&path).unwrap();
    file.write_all(b"kept").unwrap();
    file.sync_all().unwrap();
    super::File::open(ROOT).unwrap().sync_all().unwrap();
    file.write_all(&[7; 10 * 512]).unwrap();
    disk.lock().kill();
    assert!(file.write_all(b"more").is_err() && Mount::is_dead());
    Mount::mount(&disk);
    assert!(file.write_all(b"more").is_err(), "of another process");
    assert_eq!(super::metadata(&path).unwrap().len(), 4 + 10 * 512);
    disk.lock().cut_power();
    Mount::mount(&disk);
    let mut bytes = Vec::new();
    super::File::open(&path).unwrap().read_to_end(&mut bytes).unwrap();
    assert!(bytes.starts_with(b"kept"));
    Mount::unmount();
}
