//! Converts durations into the lines of a table.

use std::time::Duration;

/// Durations of one kind.
#[derive(Debug, Default)]
pub struct Durations(Vec<Duration>);

impl Durations {
    pub fn push(&mut self, duration: Duration) {
        self.0.push(duration);
    }

    pub fn push_some(&mut self, duration: Option<Duration>) {
        self.0.extend(duration);
    }

    pub fn append(&mut self, mut other: Durations) {
        self.0.append(&mut other.0);
    }

    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Returns `median, p99, max`, in microseconds.
    pub fn line(&mut self) -> String {
        self.0.sort_unstable();
        let at = |per_mille: usize| {
            let place = (self.0.len() * per_mille / 1000).min(self.0.len().saturating_sub(1));
            self.0.get(place).copied().unwrap_or_default().as_micros()
        };
        format!(
            "median {:>6} µs   p99 {:>6} µs   max {:>6} µs",
            at(500),
            at(990),
            at(1000)
        )
    }
}

/// Prints a line of the bench's output.
#[allow(clippy::print_stdout, reason = "a bench tells its numbers on standard output")]
pub fn say(line: &str) {
    println!("{line}");
}
