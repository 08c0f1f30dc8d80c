//! Reads and writes the messages of the editor over standard input and output. A message that cannot be
//! parsed is reported and skipped; later messages are read normally.

use std::io::{self, BufRead, Read};
use std::thread::JoinHandle;

use crossbeam_channel::bounded;
use lsp_server::{Connection, Message, Notification};
use lsp_types::notification::{self, Notification as _};
use tandem_model::limits::PROGRAM_BYTES_MAX;

/// Maximum size of a message, in bytes. Reason: some characters of the largest program take several bytes in
/// JSON.
const MESSAGE_BYTES_MAX: u64 = 4 * PROGRAM_BYTES_MAX as u64;

/// Maximum size of a header line before a message, bytes.
const HEADER_BYTES_MAX: u64 = 4096;

/// Method of the notification that the server receives instead of a message that cannot be parsed.
pub(super) const MALFORMED: &str = "$/tandem/malformed";

/// Next input from the editor.
enum NextInput {
    Message(Message),
    /// Input that is not a valid message; contains the reason.
    Malformed(String),
    End,
}

/// Opens the connection over standard input and output. The returned thread ends after it has written all
/// messages.
pub(super) fn stdio() -> (Connection, JoinHandle<io::Result<()>>) {
    let (to_editor, written) = bounded::<Message>(0);
    let (read, from_editor) = bounded::<Message>(0);
    let writer = std::thread::spawn(move || {
        let mut output = io::stdout().lock();
        written
            .into_iter()
            .try_for_each(|message| message.write(&mut output))
    });
    // This thread ends when its input ends; no other thread joins it.
    std::thread::spawn(move || {
        let mut input = io::stdin().lock();
        while let Ok(Some(message)) = read_message(&mut input) {
            let is_exit = matches!(&message, Message::Notification(notice) if notice.method == notification::Exit::METHOD);
            if read.send(message).is_err() || is_exit {
                break;
            }
        }
    });
    let connection = Connection {
        sender: to_editor,
        receiver: from_editor,
    };
    (connection, writer)
}

/// Reads the next message. Returns a notification if the message cannot be parsed, and `None` at the end of
/// the input.
fn read_message(input: &mut impl BufRead) -> io::Result<Option<Message>> {
    Ok(match next(input)? {
        NextInput::Message(message) => Some(message),
        NextInput::Malformed(why) => Some(Notification::new(MALFORMED.to_owned(), why).into()),
        NextInput::End => None,
    })
}

fn next(input: &mut impl BufRead) -> io::Result<NextInput> {
    let (mut length, mut wrong) = (None, None);
    loop {
        let mut line = Vec::new();
        input
            .by_ref()
            .take(HEADER_BYTES_MAX)
            .read_until(b'\n', &mut line)?;
        if line.is_empty() {
            return Ok(NextInput::End);
        }
        let line = String::from_utf8_lossy(line.trim_ascii());
        if line.is_empty() {
            break;
        }
        match line.split_once(':') {
            Some((name, value)) if name.eq_ignore_ascii_case("Content-Length") => {
                length = value.trim().parse::<u64>().ok();
            }
            Some(_) => {}
            None => wrong = Some(format!("`{}` is not a message header", line.escape_debug())),
        }
    }
    if let Some(why) = wrong {
        return Ok(NextInput::Malformed(why));
    }
    let Some(length) = length else {
        return Ok(NextInput::Malformed("a message has no Content-Length".to_owned()));
    };
    let mut body = input.by_ref().take(length);
    if length > MESSAGE_BYTES_MAX {
        io::copy(&mut body, &mut io::sink())?;
        let why = format!("a message has {length} bytes; the maximum is {MESSAGE_BYTES_MAX}");
        return Ok(NextInput::Malformed(why));
    }
    let mut bytes = Vec::new();
    body.read_to_end(&mut bytes)?;
    if (bytes.len() as u64) < length {
        return Ok(NextInput::End);
    }
    Ok(match serde_json::from_slice(&bytes) {
        Ok(message) => NextInput::Message(message),
        Err(error) => NextInput::Malformed(format!("a message is not valid JSON-RPC: {error}")),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the methods of all valid messages, and the reasons why other messages are invalid.
    fn all(input: &str) -> Vec<String> {
        let mut input = input.as_bytes();
        let mut all = Vec::new();
        while let Some(Message::Notification(notice)) = read_message(&mut input).unwrap() {
            let why = notice.params.as_str().unwrap_or_default();
            all.push(format!("{} {why}", notice.method).trim().to_owned());
        }
        all
    }

    #[test]
    fn what_is_no_message_is_told_and_the_next_one_is_read() {
        let good = "Content-Length: 14\r\n\r\n{\"method\":\"a\"}";
        for (bad, why) in [
            ("Content-Length: 5\r\n\r\n{{{{{", "is not valid JSON-RPC"),
            (
                "Content-Length: 15\r\n\r\n{\"jsonrpc\":2.0}",
                "is not valid JSON-RPC",
            ),
            ("Content-Length: 2\r\n\r\n\u{e4}", "is not valid JSON-RPC"),
            ("Content-Length: -5\r\n\r\n", "has no Content-Length"),
            ("Content-Type: x\r\n\r\n", "has no Content-Length"),
            ("hello\r\n\r\n", "`hello` is not a message header"),
        ] {
            let told = all(&format!("{good}{bad}{good}"));
            assert_eq!(told.len(), 3, "{told:?}");
            assert_eq!((told[0].as_str(), told[2].as_str()), ("a", "a"));
            assert!(
                told[1].starts_with(MALFORMED) && told[1].contains(why),
                "{told:?}"
            );
        }
    }

    #[test]
    fn a_message_that_says_it_is_larger_than_any_program_takes_no_memory() {
        let told = all("Content-Length: 999999999999\r\n\r\nabc");
        assert_eq!(told.len(), 1);
        assert!(
            told[0].contains("999999999999 bytes; the maximum is 268435456"),
            "{told:?}"
        );
        let too_large_for_a_number = format!("Content-Length: {}0\r\n\r\n", u64::MAX);
        assert!(all(&too_large_for_a_number)[0].contains("no Content-Length"));
    }

    #[test]
    fn input_that_breaks_off_is_its_end() {
        assert_eq!(all("Content-Length: 10\r\n\r\nabc"), [""; 0]);
        assert_eq!(all("Content-Len"), ["$/tandem/malformed"; 0]);
    }
}
