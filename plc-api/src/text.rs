//! Limits of texts that come from outside.

/// Cuts the text after `chars_max` characters.
pub(crate) fn cut(text: &mut String, chars_max: usize) {
    if let Some((end, _)) = text.char_indices().nth(chars_max) {
        text.truncate(end);
    }
}
