//! The log on standard error: one line for each event, even if a client has put line breaks into the text of
//! an event.

use std::io::{self, IsTerminal, Write};

use tracing_subscriber::EnvFilter;
use tracing_subscriber::fmt::MakeWriter;

/// Log filter that is used if `RUST_LOG` is not set.
const FILTER: &str = "warn,journal=info,mqtt5=error";

/// Starts the log with the default filter; `RUST_LOG` overrides it.
pub(super) fn start() {
    start_with(FILTER);
}

/// Starts the log with this filter; `RUST_LOG` overrides it.
pub(super) fn start_with(filter: &str) {
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(filter));
    let colours = io::stderr().is_terminal();
    let make = io::stderr;
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_ansi(colours)
        .with_writer(EscapingMakeWriter { make, colours })
        .init();
}

/// Writes each event as one line, and escapes control characters in the event. Reason: a line break in the ID
/// of a command must not begin a line that looks like a line of the runtime. The subscriber passes each event
/// in one `write`.
struct EscapingMakeWriter<M> {
    make: M,
    /// True if the subscriber writes colours; escape sequences for colours are then not escaped.
    colours: bool,
}

impl<'a, M: MakeWriter<'a>> MakeWriter<'a> for EscapingMakeWriter<M> {
    type Writer = EscapingWriter<M::Writer>;

    fn make_writer(&'a self) -> Self::Writer {
        EscapingWriter {
            writer: self.make.make_writer(),
            colours: self.colours,
        }
    }
}

struct EscapingWriter<W> {
    writer: W,
    colours: bool,
}

impl<W: Write> Write for EscapingWriter<W> {
    fn write(&mut self, event: &[u8]) -> io::Result<usize> {
        let text = String::from_utf8_lossy(event);
        let mut line = String::with_capacity(text.len() + 1);
        let mut rest = text.trim_end_matches('\n').chars();
        while let Some(character) = rest.next() {
            if is_escaped(character) && !(self.colours && is_colour(character, rest.as_str())) {
                line.extend(character.escape_default());
            } else {
                line.push(character);
            }
        }
        line.push('\n');
        self.writer.write_all(line.as_bytes())?;
        Ok(event.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.writer.flush()
    }
}

/// Returns true for control characters, and for characters that some viewers treat as the end of a line or as
/// a change of its direction.
fn is_escaped(character: char) -> bool {
    let separates = matches!(character, '\u{2028}' | '\u{2029}');
    let turns = matches!(character, '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
    character.is_control() || separates || turns
}

/// Returns true at the start of an escape sequence that only sets a colour, such as `ESC [ 3 1 m`.
fn is_colour(character: char, rest: &str) -> bool {
    let of_numbers = |character: char| character.is_ascii_digit() || character == ';';
    let rest = rest
        .strip_prefix('[')
        .map(|rest| rest.trim_start_matches(of_numbers));
    character == '\u{1b}' && rest.is_some_and(|rest| rest.starts_with('m'))
}

#[cfg(test)]
mod tests {
    use std::sync::{Arc, Mutex};

    use super::*;

    #[derive(Clone, Default)]
    struct CapturedLog(Arc<Mutex<Vec<u8>>>);

    impl Write for CapturedLog {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            self.0.lock().unwrap().extend_from_slice(bytes);
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    /// Returns the log text of an event with this text in its message and in a field.
    fn logged(text: &str, colours: bool) -> String {
        let kept = CapturedLog::default();
        let writer = kept.clone();
        let subscriber = tracing_subscriber::fmt()
            .with_ansi(colours)
            .with_writer(EscapingMakeWriter {
                make: move || writer.clone(),
                colours,
            })
            .finish();
        tracing::subscriber::with_default(subscriber, || {
            tracing::warn!(field = %text, "MQTT command {text} rejected");
        });
        String::from_utf8(kept.0.lock().unwrap().clone()).unwrap()
    }

    #[test]
    fn an_event_is_one_line_whatever_its_text_holds() {
        let forged = "x\n2030-01-01T00:00:00.000000Z  INFO journal: {\"event\":\"start\"}";
        for text in [
            forged,
            "a\r\nb",
            "a\u{b}b",
            "a\u{85}b",
            "a\u{2028}b",
            "a\u{202e}b",
            "\u{1b}[2Kb",
            "\u{0}",
            "\n",
        ] {
            let line = logged(text, false);
            assert_eq!(line.lines().count(), 1, "{line}");
            assert!(line.ends_with('\n') && line.contains("rejected"), "{line}");
            let within = line.trim_end_matches('\n').chars();
            let strange: String = within.filter(|c| c.is_control() || is_escaped(*c)).collect();
            assert_eq!(strange, "", "{line}");
        }
        assert!(logged("é ✓ a\tb", false).contains("é ✓ a\\tb"));
        let coloured = logged("\u{1b}[2Kb\n", true);
        assert!(coloured.contains("\u{1b}[0m") && !coloured.contains("\u{1b}[2K"));
    }
}
