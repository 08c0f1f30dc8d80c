//! JSON that comes in.

/// Reads a JSON object. Without the check of its first character an array would pass for the fields of one, in their
/// order.
pub(crate) fn json_object<T: serde::de::DeserializeOwned>(bytes: &[u8]) -> Result<T, String> {
    if bytes.trim_ascii_start().first() != Some(&b'{') {
        return Err("write an object: {...}".to_owned());
    }
    serde_json::from_slice(bytes).map_err(|error| error.to_string())
}
