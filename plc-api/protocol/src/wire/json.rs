//! Parsing of JSON objects in received messages.

use std::fmt;

use serde::de::value::{BorrowedStrDeserializer, U64Deserializer};
use serde::de::{
    DeserializeOwned, DeserializeSeed, Deserializer, IgnoredAny, IntoDeserializer, MapAccess, Visitor,
};

/// Parses a JSON object. The first character is checked, because otherwise an array would be accepted, with
/// its elements as the fields in order.
///
/// # Errors
/// Fails if the JSON is not valid; the text is for the sender of the message.
pub fn json_object<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, String> {
    edited_json_object(bytes, None, &[])
}

/// Parses a JSON object as if it also contained the field `added`, whose value comes from the path. The
/// fields `left_out`, which are read separately, are ignored.
pub(super) fn edited_json_object<T: DeserializeOwned>(
    bytes: &[u8],
    added: Option<(&'static str, u64)>,
    left_out: &[&str],
) -> Result<T, String> {
    if bytes.trim_ascii_start().first() != Some(&b'{') {
        return Err("write an object: {...}".to_owned());
    }
    let mut body = serde_json::Deserializer::from_slice(bytes);
    let edited = EditedDeserializer {
        added,
        left_out,
        inner: &mut body,
    };
    T::deserialize(edited)
        .and_then(|value| body.end().map(|()| value))
        .map_err(|error| error.to_string())
}

/// Wrapper of a deserializer, of its visitor or of its fields, which adds the field `added`, and leaves out
/// the fields `left_out`.
struct EditedDeserializer<'a, D> {
    added: Option<(&'static str, u64)>,
    left_out: &'a [&'a str],
    inner: D,
}

impl<'de, D: Deserializer<'de>> Deserializer<'de> for EditedDeserializer<'_, D> {
    type Error = D::Error;

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, D::Error> {
        let Self {
            added,
            left_out,
            inner,
        } = self;
        inner.deserialize_map(EditedDeserializer {
            added,
            left_out,
            inner: visitor,
        })
    }

    serde::forward_to_deserialize_any! {
        bool i8 i16 i32 i64 i128 u8 u16 u32 u64 u128 f32 f64 char str string bytes byte_buf option unit unit_struct
        newtype_struct seq tuple tuple_struct map struct enum identifier ignored_any
    }
}

impl<'de, V: Visitor<'de>> Visitor<'de> for EditedDeserializer<'_, V> {
    type Value = V::Value;

    fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.inner.expecting(formatter)
    }

    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<V::Value, A::Error> {
        let Self {
            added,
            left_out,
            inner,
        } = self;
        inner.visit_map(EditedMap {
            name: added.map(|(name, _)| name),
            value: added.map(|(_, value)| value),
            left_out,
            map,
        })
    }
}

struct EditedMap<'a, A> {
    name: Option<&'static str>,
    value: Option<u64>,
    left_out: &'a [&'a str],
    map: A,
}

impl<'de, A: MapAccess<'de>> MapAccess<'de> for EditedMap<'_, A> {
    type Error = A::Error;

    fn next_key_seed<K: DeserializeSeed<'de>>(&mut self, seed: K) -> Result<Option<K::Value>, A::Error> {
        if let Some(name) = self.name.take() {
            return seed.deserialize(BorrowedStrDeserializer::new(name)).map(Some);
        }
        while let Some(name) = self.map.next_key::<String>()? {
            if !self.left_out.contains(&name.as_str()) {
                return seed.deserialize(name.into_deserializer()).map(Some);
            }
            self.map.next_value::<IgnoredAny>()?;
        }
        Ok(None)
    }

    fn next_value_seed<S: DeserializeSeed<'de>>(&mut self, seed: S) -> Result<S::Value, A::Error> {
        match self.value.take() {
            Some(value) => seed.deserialize(U64Deserializer::new(value)),
            None => self.map.next_value_seed(seed),
        }
    }
}

#[cfg(test)]
mod tests {
    use serde::Deserialize;

    use super::*;

    #[derive(Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct PathObject {
        seq: u64,
        name: String,
    }

    #[test]
    fn a_field_of_the_path_is_one_of_the_object_and_may_not_be_there_twice() {
        let read = |text: &str| edited_json_object::<PathObject>(text.as_bytes(), Some(("seq", 7)), &[]);
        let name = "h".to_owned();
        assert_eq!(read(r#"{"name": "h"}"#), Ok(PathObject { seq: 7, name }));
        assert_eq!(read("{}").unwrap_err(), "missing field `name` at line 1 column 2");
        for wrong in [
            r#"{"name": "h", "seq": 7}"#,
            r#"{"name": "h"} x"#,
            r#"{"name": "h", "x": 1}"#,
            "[]",
        ] {
            assert!(read(wrong).is_err(), "{wrong}");
        }
    }
}
