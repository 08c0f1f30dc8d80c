//! Functions for texts.

use std::any::Any;

/// Cuts the text after `chars_max` characters.
pub(crate) fn cut(text: &mut String, chars_max: usize) {
    // a text never has more characters than bytes
    if text.len() <= chars_max {
        return;
    }
    if let Some((end, _)) = text.char_indices().nth(chars_max) {
        text.truncate(end);
    }
}

/// Returns the message of a panic.
pub(crate) fn panic_text(panicked: &(dyn Any + Send)) -> &str {
    panicked
        .downcast_ref::<&str>()
        .copied()
        .or_else(|| panicked.downcast_ref::<String>().map(String::as_str))
        .unwrap_or("no text")
}
