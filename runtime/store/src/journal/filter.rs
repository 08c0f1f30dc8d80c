//! Selects the lines of the journal that a request asks for.

use std::collections::BTreeMap;
use std::time::{Duration, SystemTime};

use plc_protocol::types::Timestamp;
use plc_protocol::types::data::JournalFilter;
use serde_json::Value;

/// Maximum number of pending outputs whose M number the filter remembers, in all coordinate systems together.
/// If more are pending, later lines about the oldest outputs are not found by M number. Reason: eight
/// coordinate systems with 64 pending outputs each need far fewer.
const OUTPUTS_MAX: usize = 4096;

/// A filter over the lines of a journal, applied in the order of writing. The filter remembers outputs and
/// runs, because the line of a claim contains no M number, and the line of an alarm contains no run.
#[derive(Debug, Default)]
pub struct LineFilter {
    since: Option<String>,
    until: Option<String>,
    wanted: JournalFilter,
    /// M numbers of the pending outputs, by coordinate system and sequence number.
    outputs: BTreeMap<(u64, u64), u64>,
    /// Boot identifier of the previous line.
    boot_id: String,
    /// The active run of each coordinate system.
    runs: BTreeMap<u64, String>,
}

impl LineFilter {
    /// Creates the filter for a request; ages such as `2h` are relative to `now`.
    ///
    /// # Errors
    /// Returns an error if a time cannot be parsed.
    pub fn new(wanted: &JournalFilter, now: SystemTime) -> Result<Self, String> {
        let time = |name: &str, text: &Option<String>| {
            let read = text.as_deref().map(|text| time(name, text, now));
            read.transpose()
        };
        Ok(Self {
            since: time("since", &wanted.since)?,
            until: time("until", &wanted.until)?,
            wanted: wanted.clone(),
            ..Self::default()
        })
    }

    /// Returns true if the line is one of those requested.
    pub fn takes(&mut self, line: &Value) -> bool {
        let cs = line["cs"].as_u64().unwrap_or(0);
        let seq = seq_of(line).map(|seq| (cs, seq));
        self.follow(line, cs, seq);
        let m = line["m"].as_u64().or_else(|| self.outputs.get(&seq?).copied());
        let takes = self.is_in_time(line)
            && self.wanted.cs.is_none_or(|wanted| cs == u64::from(wanted))
            && self.wanted.m.is_none_or(|wanted| m == Some(wanted.into()))
            && self.is_of_user(line)
            && self.is_of_run(cs);
        match line["event"].as_str() {
            Some("reset") => {
                seq.map(|seq| self.outputs.remove(&seq));
            }
            Some("end") => {
                self.runs.remove(&cs);
            }
            _ => {}
        }
        takes
    }

    /// Remembers the boot, run and M number of a line, because later lines do not repeat them.
    fn follow(&mut self, line: &Value, cs: u64, seq: Option<(u64, u64)>) {
        if line["boot_id"].as_str() != Some(&self.boot_id) {
            line["boot_id"]
                .as_str()
                .unwrap_or_default()
                .clone_into(&mut self.boot_id);
            self.outputs.clear();
            self.runs.clear();
        }
        if let Some(run) = line["run_id"].as_str() {
            self.runs.insert(cs, run.to_owned());
        }
        if let (Some("output"), Some(seq), Some(m)) = (line["event"].as_str(), seq, line["m"].as_u64()) {
            if self.outputs.len() >= OUTPUTS_MAX {
                self.outputs.pop_first();
            }
            self.outputs.insert(seq, m);
        }
    }

    fn is_in_time(&self, line: &Value) -> bool {
        // Both times are RFC 3339 in UTC with six decimals, so their alphabetical order is the order in time.
        let ts = line["ts"].as_str().unwrap_or_default();
        self.since.as_deref().is_none_or(|since| ts >= since)
            && self
                .until
                .as_deref()
                .is_none_or(|until| !ts.is_empty() && ts < until)
    }

    fn is_of_user(&self, line: &Value) -> bool {
        let is = |wanted: &String| {
            let named = ["user", "client_id", "handler_id"].map(|name| line[name].as_str());
            named.contains(&Some(wanted))
        };
        self.wanted.user.as_ref().is_none_or(is)
    }

    fn is_of_run(&self, cs: u64) -> bool {
        let is = |wanted: &String| {
            let (boot_id, run) = wanted.split_once('/').unwrap_or((&self.boot_id, wanted));
            // The name matches as a whole, or without the boot identifier at its beginning.
            let is_it = |now: &String| {
                let of_boot = now.strip_prefix(boot_id).and_then(|now| now.strip_prefix('-'));
                now == run || of_boot == Some(run)
            };
            boot_id == self.boot_id && self.runs.get(&cs).is_some_and(is_it)
        };
        self.wanted.run.as_ref().is_none_or(is)
    }
}

/// Returns the sequence number of the output that a line concerns; the line of a request contains the number
/// in the route.
fn seq_of(line: &Value) -> Option<u64> {
    let of_route = || {
        let (_, seq) = line["request"].as_str()?.split_once("/m_codes/")?;
        seq.split('/').next()?.parse().ok()
    };
    line["seq"].as_u64().or_else(of_route)
}

/// Seconds from 1970 to the first year with five digits.
const YEAR_10_000_S: u64 = 253_402_300_800;

/// Converts a time in UTC into the form of times in lines. Accepts an age such as `2h`, a date such as
/// `2026-11-25`, or `2026-11-25T10:00` with or without seconds.
fn time(name: &str, text: &str, now: SystemTime) -> Result<String, String> {
    let ago = |ago: Duration| now.checked_sub(ago);
    let whole = match text.trim_end_matches('Z') {
        day if day.len() == 10 => format!("{day}T00:00:00"),
        minute if minute.len() == 16 => format!("{minute}:00"),
        time => time.to_owned(),
    };
    let of_day = || humantime::parse_rfc3339_weak(&whole).ok();
    let time = match humantime::parse_duration(text) {
        Ok(duration) => ago(duration),
        Err(_) => of_day(),
    };
    // Times that the written form cannot express are rejected, too.
    let is_said = |time: &SystemTime| {
        let seconds = time.duration_since(SystemTime::UNIX_EPOCH);
        seconds.is_ok_and(|since| since.as_secs() < YEAR_10_000_S)
    };
    match time.filter(is_said) {
        Some(time) => Ok(Timestamp::from_system_time(time).0),
        None => Err(format!(
            "{name} {text:?}: write an age, such as 2h or 30m, or a time in UTC, such as 2026-11-25 or \
             2026-11-25T10:00"
        )),
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    const NOW: &str = "2026-11-25T10:00:00.500000Z";

    fn now() -> SystemTime {
        Timestamp(NOW.to_owned()).to_system_time().unwrap()
    }

    fn taken(wanted: &JournalFilter, lines: &[Value]) -> Vec<usize> {
        let mut filter = LineFilter::new(wanted, now()).unwrap();
        let taken = |(at, line): (usize, &Value)| filter.takes(line).then_some(at);
        lines.iter().enumerate().filter_map(taken).collect()
    }

    #[test]
    fn a_time_is_how_long_ago_or_a_day_or_a_time_of_it() {
        for (text, expected) in [
            ("2h", "2026-11-25T08:00:00.500000Z"),
            ("30m", "2026-11-25T09:30:00.500000Z"),
            ("1d", "2026-11-24T10:00:00.500000Z"),
            ("2026-11-25", "2026-11-25T00:00:00.000000Z"),
            ("2026-11-25T10:00", "2026-11-25T10:00:00.000000Z"),
            ("2026-11-25T10:00:01", "2026-11-25T10:00:01.000000Z"),
            ("2026-11-25T10:00:01.25Z", "2026-11-25T10:00:01.250000Z"),
            (NOW, NOW),
        ] {
            assert_eq!(time("since", text, now()).as_deref(), Ok(expected), "{text}");
        }
        for text in [
            "",
            "yesterday",
            "2026-13-01",
            "2026-11-25T25:00",
            "99999999999y",
            "-1h",
            "é",
            "9999-99-99",
        ] {
            let refused = time("until", text, now()).unwrap_err();
            assert!(
                refused.starts_with("until") && refused.contains("2h"),
                "{refused}"
            );
        }
    }

    /// A run with an output, and the lines before and after it.
    fn run_with_an_output() -> [Value; 9] {
        let line = |second: u32, cs: u32, mut fields: Value| {
            fields["ts"] = json!(format!("2026-11-25T09:00:{second:02}.000000Z"));
            fields["cs"] = json!(cs);
            fields["boot_id"] = json!("b1");
            fields
        };
        [
            line(
                0,
                0,
                json!({"event": "request", "user": "anna", "request": "POST /cs/1/start"}),
            ),
            line(1, 1, json!({"event": "start", "program": 60, "run_id": "b1-1-1"})),
            line(
                2,
                1,
                json!({"event": "output", "m": 100, "seq": 1, "run_id": "b1-1-1"}),
            ),
            line(
                3,
                2,
                json!({"event": "output", "m": 200, "seq": 1, "run_id": "2-1"}),
            ),
            line(4, 1, json!({"event": "claim", "seq": 1, "handler_id": "door"})),
            line(
                5,
                1,
                json!({"event": "request", "user": "bert", "request": "POST /cs/1/m_codes/1/reset"}),
            ),
            line(
                5,
                1,
                json!({"event": "reset", "seq": 1, "m": null, "handler_id": "door", "result": "ok"}),
            ),
            line(6, 1, json!({"event": "end", "outcome": "PROGRAM_COMPLETED"})),
            line(7, 1, json!({"event": "alarm", "number": 7})),
        ]
    }

    #[test]
    fn lines_found_by_time_user_m_code_and_run_without_naming_them() {
        let lines = run_with_an_output();
        let wanted = JournalFilter::default;
        assert_eq!(taken(&wanted(), &lines), (0..9).collect::<Vec<_>>());
        let since = Some("2026-11-25T09:00:06".to_owned());
        assert_eq!(taken(&JournalFilter { since, ..wanted() }, &lines), [7, 8]);
        let until = Some("2026-11-25T09:00:01".to_owned());
        assert_eq!(taken(&JournalFilter { until, ..wanted() }, &lines), [0]);
        assert_eq!(
            taken(
                &JournalFilter {
                    cs: Some(2),
                    ..wanted()
                },
                &lines
            ),
            [3]
        );
        assert_eq!(
            taken(
                &JournalFilter {
                    m: Some(100),
                    ..wanted()
                },
                &lines
            ),
            [2, 4, 5, 6]
        );
        let user = |name: &str| JournalFilter {
            user: Some(name.to_owned()),
            ..wanted()
        };
        assert_eq!(taken(&user("anna"), &lines), [0]);
        assert_eq!(taken(&user("door"), &lines), [4, 6]);
        let run = |run: &str| JournalFilter {
            run: Some(run.to_owned()),
            ..wanted()
        };
        assert_eq!(taken(&run("1-1"), &lines), [1, 2, 4, 5, 6, 7]);
        assert_eq!(taken(&run("b1/1-1"), &lines), [1, 2, 4, 5, 6, 7]);
        assert_eq!(taken(&run("b1-1-1"), &lines), [1, 2, 4, 5, 6, 7]);
        assert_eq!(taken(&run("2-1"), &lines), [3], "named by an older runtime");
        for other in ["b2/1-1", "b2-1-1", "1-11", "1"] {
            assert_eq!(taken(&run(other), &lines), Vec::<usize>::new(), "{other}");
        }
    }
}
