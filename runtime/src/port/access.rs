//! Journal lines about logins and refused requests. Their number is limited, because any client can cause such lines.

use parking_lot::Mutex;
use plc_protocol::server::{AccessKind, AccessNote};
use tandem_store::journal::Event;

use crate::shared::SharedState;

/// Number of refusals recorded at once, and time in s for each further refusal. Reason: 1500 lines per day are 0.4 MB
/// of the 32 MB of the journal.
const REFUSED_BURST: f64 = 20.0;
const REFUSED_SECONDS: f64 = 60.0;

/// Number of logins recorded at once, and time in s for each further login. A login needs a PIN.
const LOGIN_BURST: f64 = 100.0;
const LOGIN_SECONDS: f64 = 10.0;

/// Maximum length in characters of texts that a client sent.
const SAID_MAX: usize = 100;

/// Limits of the number of journal lines about logins and refusals.
#[derive(Debug, Default)]
pub(crate) struct AccessLines {
    logins: Mutex<Bucket>,
    refused: Mutex<Bucket>,
}

#[derive(Debug, Default)]
struct Bucket {
    /// Number of written lines, minus those that the elapsed time has made available again.
    used: f64,
    at_s: f64,
    left_out: u64,
}

impl Bucket {
    /// Reserves a line. Returns the number of lines omitted since the last reserved line, or `None` if the limit is
    /// reached.
    fn reserve_line(&mut self, now_s: f64, burst: f64, seconds: f64) -> Option<u64> {
        self.used = (self.used - (now_s - self.at_s).max(0.0) / seconds).max(0.0);
        self.at_s = now_s;
        if self.used + 1.0 > burst {
            self.left_out += 1;
            return None;
        }
        self.used += 1.0;
        Some(std::mem::take(&mut self.left_out))
    }
}

impl AccessLines {
    /// Writes the journal line unless its limit is reached.
    pub fn record(&self, shared: &SharedState, note: AccessNote) {
        let now_s = shared.clock.now_s();
        let left_out = match note.what {
            AccessKind::Login => self.logins.lock().reserve_line(now_s, LOGIN_BURST, LOGIN_SECONDS),
            AccessKind::LoginRefused | AccessKind::Forbidden => {
                self.refused
                    .lock()
                    .reserve_line(now_s, REFUSED_BURST, REFUSED_SECONDS)
            }
        };
        let Some(left_out) = left_out else { return };
        let cut = |text: String| text.chars().take(SAID_MAX).collect();
        let event = Event::Access {
            what: note.what,
            user: note.user.map(cut),
            from: note.from,
            over: note.over,
            request: cut(note.request),
            left_out: (left_out > 0).then_some(left_out),
        };
        shared.record(0, event);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flood_of_refusals_writes_a_bounded_number_of_lines_and_a_count() {
        let mut bucket = Bucket::default();
        let mut written = 0;
        for n in 0..100_000 {
            // 1000 refusals per second
            let now_s = f64::from(n) / 1000.0;
            written += u64::from(
                bucket
                    .reserve_line(now_s, REFUSED_BURST, REFUSED_SECONDS)
                    .is_some(),
            );
        }
        assert_eq!(written, 21, "20 at once, and 1 after a minute");
        let left_out = bucket.reserve_line(200.0, REFUSED_BURST, REFUSED_SECONDS);
        assert!(left_out.is_some_and(|left_out| left_out > 39_000), "{left_out:?}");
        assert_eq!(bucket.reserve_line(1e6, REFUSED_BURST, REFUSED_SECONDS), Some(0));
    }
}
