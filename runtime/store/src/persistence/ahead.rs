//! Starts of runs and outputs, written to a file before any client can receive them.
//!
//! The journal collects lines before it writes them, so a kill loses the collected lines, while a handler may
//! already work on the output. Therefore the thread that issues an output first writes its line into a file
//! of fixed size, a ring of slots. The line is then in the page cache of the operating system, which survives
//! a kill of the process; no thread waits for the disk. At the next start, lines missing from the journal are
//! recovered from the ring.
//!
//! Resets are not written ahead, because each would need a write. Instead, the line of an output lists the
//! earlier outputs that are still pending.
//!
//! After the ring, each coordinate system has a slot. This slot contains the rest positions of the axes, or
//! the note that they move.

use std::collections::BTreeMap;
use std::io::{self, Cursor, Write};
use std::time::SystemTime;

use parking_lot::Mutex;
use plc_protocol::types::{BootId, CoordinateSystemNumber, Timestamp};
use serde::Deserialize;
use serde_json::Value;

use super::positions::MotorPositions;
use crate::disk::{
    DiskFile, DiskPath, Generations, OpenMode, Seal, SealedFileKind, number, open_regular, read_regular,
    read_sealed, seal_in_place,
};
use crate::journal::{Event, Line, WriteAhead};

/// Name of the ring's file in the journal's folder.
const AHEAD_FILE: &str = "ahead";

/// Size of a slot, in bytes. Reason: a line for an output with eight parameters of maximum length takes about
/// 600 bytes.
const SLOT_BYTES: usize = 1024;

/// Number of slots. Reason: the busiest machine fills all slots in about 0.3 s, while the journal lags by at
/// most 20 ms.
const SLOTS: u64 = 512;

/// Maximum number of pending outputs listed in a line. Reason: the line must fit into a slot. If more outputs
/// are pending, the line lists none.
const NAMED_MAX: usize = 16;

/// Field in the line of an output: sequence numbers of the earlier pending outputs. Only lines in the ring
/// have this field.
pub(super) const OPEN: &str = "open";

/// The ring, opened by one start of the runtime.
#[derive(Debug)]
pub struct Ahead {
    file: Box<dyn DiskFile>,
    boot_id: BootId,
    /// Seal of the lines as text; all lines of one start of the runtime have the same seal.
    seal: String,
    /// Pending outputs of each coordinate system.
    open: Mutex<BTreeMap<CoordinateSystemNumber, Vec<u64>>>,
}

impl Ahead {
    /// Creates an empty ring in a folder.
    ///
    /// # Errors
    /// Returns an error if the disk operation fails.
    pub fn create(folder: &DiskPath, boot_id: BootId, generations: &Generations) -> io::Result<Self> {
        let path = folder.join(AHEAD_FILE);
        let file = open_regular(&path, OpenMode::ReadWrite)?;
        // Only the ring is cleared. The slots after it keep the rest positions of an earlier start until the axes
        // move or rest in this start; each slot names the start of the runtime that wrote it.
        file.write_all_at(&vec![b'\n'; SLOT_BYTES * usize::try_from(SLOTS).unwrap_or(0)], 0)?;
        let open = Mutex::default();
        let seal = serde_json::to_string(&generations.plain_seal(SealedFileKind::Ahead))?;
        Ok(Self {
            file,
            boot_id,
            seal,
            open,
        })
    }

    /// Writes the list of earlier pending outputs, then adds this output to that list. The start of a run
    /// clears the list.
    fn write_open(&self, line: &Line, cursor: &mut impl Write) -> io::Result<()> {
        let mut all = self.open.lock();
        let open = all.entry(line.cs).or_default();
        let Event::Output(output) = &line.event else {
            open.clear();
            return Ok(());
        };
        if open.len() <= NAMED_MAX {
            write!(cursor, ",\"{OPEN}\":{open:?}")?;
        }
        open.push(output.seq);
        Ok(())
    }
}

impl WriteAhead for Ahead {
    /// Writes line number `n` into its slot.
    fn write(&self, n: u64, line: &Line, time: SystemTime) -> io::Result<()> {
        let mut text = [0; SLOT_BYTES];
        let mut cursor = Cursor::new(&mut text[..]);
        let (boot, ts) = (&self.boot_id.0, Timestamp::from_system_time(time).0);
        let (t_s, cs, seal) = (line.t_s, line.cs, &self.seal);
        write!(
            cursor,
            "{{\"n\":{n},\"boot_id\":\"{boot}\",\"seal\":{seal},\"ts\":\"{ts}\",\"t_s\":{t_s:?},\"cs\":{cs}"
        )?;
        self.write_open(line, &mut cursor)?;
        let joint = cursor.position();
        serde_json::to_writer(&mut cursor, &line.event)?;
        let end = usize::try_from(cursor.position()).unwrap_or(usize::MAX);
        // The event is serialized as a separate JSON object; this merges its fields into the object of the
        // line.
        text[usize::try_from(joint).unwrap_or(0)] = b',';
        let end = seal_in_place(&mut text, end).ok_or(io::ErrorKind::WriteZero)?;
        self.file
            .write_all_at(&text[..end], n % SLOTS * SLOT_BYTES as u64)
    }

    fn close(&self, line: &Line) {
        let mut all = self.open.lock();
        let Some(open) = all.get_mut(&line.cs) else { return };
        match &line.event {
            Event::Reset { seq, .. } => open.retain(|of| of != seq),
            _ => open.clear(),
        }
    }

    fn rest(
        &self,
        cs: CoordinateSystemNumber,
        after: u64,
        positions: Option<&MotorPositions>,
    ) -> io::Result<()> {
        let mut text = [0; SLOT_BYTES];
        let mut cursor = Cursor::new(&mut text[..]);
        let (boot, seal) = (&self.boot_id.0, &self.seal);
        write!(
            cursor,
            "{{\"cs\":{cs},\"boot_id\":\"{boot}\",\"seal\":{seal},\"after\":{after},\"positions\":"
        )?;
        serde_json::to_writer(&mut cursor, &positions)?;
        cursor.write_all(b"}")?;
        let end = usize::try_from(cursor.position()).unwrap_or(usize::MAX);
        let end = seal_in_place(&mut text, end).ok_or(io::ErrorKind::WriteZero)?;
        self.file
            .write_all_at(&text[..end], (SLOTS + u64::from(cs)) * SLOT_BYTES as u64)
    }
}

/// Rest positions of the axes of a coordinate system.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub(super) struct Rest {
    pub cs: CoordinateSystemNumber,
    /// The start of the runtime that wrote the slot.
    pub boot_id: BootId,
    /// Number of the newest line of the journal when the slot was written.
    pub after: u64,
    /// Rest positions; `None` while the axes move.
    pub positions: Option<MotorPositions>,
}

/// Reads the rest positions of this machine's coordinate systems from the slots after the ring.
pub(super) fn recover_rests(folder: &DiskPath, machine: &str) -> Vec<Rest> {
    let slots = slots(folder)
        .into_iter()
        .filter(|(_, seal)| seal.machine == machine);
    slots
        .filter_map(|(line, _)| Rest::deserialize(line).ok())
        .collect()
}

/// Returns all sealed lines of the ring file, each with its seal.
fn slots(folder: &DiskPath) -> Vec<(Value, Seal)> {
    let most = (SLOTS + u64::from(CoordinateSystemNumber::MAX) + 1) * SLOT_BYTES as u64;
    let bytes = read_regular(&folder.join(AHEAD_FILE), most).unwrap_or_default();
    bytes
        .chunks(SLOT_BYTES)
        .filter_map(|slot| slot.split(|byte| *byte == b'\n').next())
        .filter_map(|line| read_sealed(SealedFileKind::Ahead, line).ok())
        .collect()
}

/// Returns the intact lines of this machine's ring, ascending by number; the list is empty if no ring exists.
pub fn recover(folder: &DiskPath, machine: &str) -> Vec<Value> {
    let mut lines: Vec<Value> = slots(folder)
        .into_iter()
        .filter(|(line, seal)| number(line) > 0 && seal.machine == machine)
        .map(|(line, _)| line)
        .collect();
    lines.sort_by_key(number);
    lines
}

#[cfg(test)]
mod tests {
    use std::time::UNIX_EPOCH;

    use serde_json::json;

    use super::*;
    use crate::journal::ResetOutcome;

    fn line(run: u64) -> Line {
        Line {
            t_s: 0.5,
            cs: 1,
            event: Event::Start {
                program: 60,
                run_id: format!("1-{run}"),
                program_hash: None,
                from_line: None,
                parts: None,
                order: None,
            },
        }
    }

    #[test]
    fn lines_written_ahead_recovered_by_number_and_new_start_clears_them() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(recover(&folder.path().into(), ""), Vec::<Value>::new());
        let ahead = Ahead::create(
            &folder.path().into(),
            BootId("b1".to_owned()),
            &Generations::default(),
        )
        .unwrap();
        let numbers = [SLOTS - 1, SLOTS, SLOTS + 1, 2 * SLOTS];
        for n in numbers {
            ahead.write(n, &line(n), UNIX_EPOCH).unwrap();
        }
        let found = recover(&folder.path().into(), "");
        assert_eq!(found.iter().map(number).collect::<Vec<_>>(), [511, 513, 1024]);
        assert_eq!(Line::from_json(&found[2]), Some(line(1024)));
        assert_eq!(found[2]["boot_id"], "b1");
        assert_eq!(found[2]["ts"], "1970-01-01T00:00:00.000000Z");
        Ahead::create(
            &folder.path().into(),
            BootId("b2".to_owned()),
            &Generations::default(),
        )
        .unwrap();
        assert_eq!(recover(&folder.path().into(), ""), Vec::<Value>::new());
    }

    fn output(seq: u64) -> Line {
        let output = json!({
            "event": "output", "seq": seq, "run_id": "1-1", "m": 100, "params": {}, "timing": "after_motion", "program": 60,
            "line": 7, "attempt": 1, "redelivered": false, "t_s": 0.5, "cs": 1,
        });
        Line::from_json(&output).unwrap()
    }

    #[test]
    fn the_line_of_an_output_says_which_outputs_before_it_are_open() {
        let folder = tempfile::tempdir().unwrap();
        let ahead = Ahead::create(
            &folder.path().into(),
            BootId("b1".to_owned()),
            &Generations::default(),
        )
        .unwrap();
        let reset = |seq| Line {
            event: Event::Reset {
                seq,
                m: Some(100),
                handler_id: "h".to_owned(),
                outcome: ResetOutcome::Ok,
                force: false,
            },
            ..line(1)
        };
        for seq in 1..4 {
            ahead.write(seq, &output(seq), UNIX_EPOCH).unwrap();
        }
        ahead.close(&reset(2));
        ahead.write(4, &output(4), UNIX_EPOCH).unwrap();
        ahead.write(5, &line(2), UNIX_EPOCH).unwrap();
        for seq in 6..24 {
            ahead.write(seq, &output(seq), UNIX_EPOCH).unwrap();
        }
        let open: Vec<Value> = recover(&folder.path().into(), "")
            .iter()
            .map(|line| line[OPEN].clone())
            .collect();
        let none = Value::Null;
        assert_eq!(open[..4], [json!([]), json!([1]), json!([1, 2]), json!([1, 3])]);
        assert_eq!(open[4..6], [none.clone(), json!([])], "a run begins");
        assert_eq!(
            open[21..],
            [json!((6..22).collect::<Vec<u64>>()), none],
            "17 are too many"
        );
    }

    #[test]
    fn where_axes_rest_is_found_until_they_move_also_by_the_next_start() {
        let folder = tempfile::tempdir().unwrap();
        let begin = |boot: &str| {
            let boot = BootId(boot.to_owned());
            Ahead::create(&folder.path().into(), boot, &Generations::new("mill")).unwrap()
        };
        let ahead = begin("b1");
        let at = MotorPositions::from([(7, 0.1 + 0.2), (1024, -123.456_789)]);
        ahead.rest(1, 5, Some(&at)).unwrap();
        ahead.rest(8, 6, Some(&at)).unwrap();
        ahead.rest(8, 7, None).unwrap();
        ahead.write(511, &line(511), UNIX_EPOCH).unwrap();
        let rest = |cs, after, positions| Rest {
            cs,
            boot_id: BootId("b1".to_owned()),
            after,
            positions,
        };
        let both = vec![rest(1, 5, Some(at)), rest(8, 7, None)];
        assert_eq!(recover_rests(&folder.path().into(), "mill"), both);
        assert_eq!(recover_rests(&folder.path().into(), "lathe"), []);
        begin("b2");
        assert_eq!(recover_rests(&folder.path().into(), "mill"), both);
        assert_eq!(recover(&folder.path().into(), "mill"), Vec::<Value>::new());
    }

    #[test]
    fn a_line_that_has_no_room_is_refused_and_a_damaged_slot_is_none() {
        let folder = tempfile::tempdir().unwrap();
        let ahead = Ahead::create(
            &folder.path().into(),
            BootId("b1".to_owned()),
            &Generations::default(),
        )
        .unwrap();
        let long = Line {
            event: Event::Start {
                program: 1,
                run_id: "x".repeat(SLOT_BYTES),
                program_hash: None,
                from_line: None,
                parts: None,
                order: None,
            },
            ..line(1)
        };
        assert!(ahead.write(1, &long, UNIX_EPOCH).is_err());
        ahead.write(2, &line(2), UNIX_EPOCH).unwrap();
        ahead.file.write_all_at(b"9", 2 * SLOT_BYTES as u64 + 5).unwrap();
        assert_eq!(recover(&folder.path().into(), ""), Vec::<Value>::new());
    }
}
