//! Tags as text: the values of `ETag`, `If-Match` and `If-None-Match`, which HTTP compares.

use crate::types::BootId;
use crate::types::command::Expect;
use crate::types::upload::Hashes;

/// Number of digits of a program's hash.
const HASH_DIGITS: usize = 64;

/// Largest number of tags in one header. Reason: no request needs more programs at the same time.
const TAGS_MAX: usize = 64;

/// Returns a hash as the value of `ETag`.
pub fn etag(hash: &str) -> String {
    format!("\"{hash}\"")
}

/// Returns true if `If-None-Match` contains the hash, or any hash: the client already has the program.
pub fn is_had(header: &str, hash: &str) -> bool {
    let mut tags = tags(header);
    tags.any(|tag| tag == "*" || unquoted(tag.strip_prefix("W/").unwrap_or(tag)) == hash)
}

fn tags(header: &str) -> impl Iterator<Item = &str> {
    header.split(',').map(str::trim)
}

fn unquoted(tag: &str) -> &str {
    let inner = tag.strip_prefix('"').and_then(|tag| tag.strip_suffix('"'));
    inner.unwrap_or(tag)
}

fn boot_id(tag: &str) -> Option<BootId> {
    let id = tag.strip_prefix(BOOT)?;
    let is_name =
        (1..=BOOT_ID_MAX).contains(&id.len()) && id.bytes().all(|byte| byte.is_ascii_alphanumeric());
    is_name.then(|| BootId(id.to_owned()))
}

fn hash(tag: &str) -> Option<String> {
    let is_hash = tag.len() == HASH_DIGITS && tag.bytes().all(|digit| digit.is_ascii_hexdigit());
    is_hash.then(|| tag.to_ascii_lowercase())
}

/// Prefix of a boot id in a tag, because a boot id without a prefix could look like a number.
const BOOT: &str = "boot:";

/// Largest number of characters of a boot id.
const BOOT_ID_MAX: usize = 64;

/// Parses the condition of a command: the revision of the state, the hash of the program and the boot, all of
/// which must match.
pub(super) fn expected(header: &str) -> Result<Expect, String> {
    let mut expect = Expect::default();
    for tag in tags(header).map(unquoted) {
        if let Some(hash) = hash(tag)
            && expect.hash.is_none()
        {
            expect.hash = Some(hash);
        } else if let Some(boot_id) = boot_id(tag)
            && expect.boot_id.is_none()
        {
            expect.boot_id = Some(boot_id);
        } else if let Ok(rev) = tag.parse()
            && expect.state_rev.is_none()
        {
            expect.state_rev = Some(rev);
        } else {
            let text = "If-Match is the ETag of the state of the coordinate system, such as \"12\", the ETag of the program, or \"boot:ID\" with a boot_id, separated by commas";
            return Err(text.to_owned());
        }
    }
    Ok(expect)
}

/// Returns the condition as a header, or `None` if the header can express no part of the condition.
pub(super) fn of_expected(expect: &Expect) -> Option<String> {
    let rev = expect.state_rev.map(|rev| rev.to_string());
    let boot = expect.boot_id.as_ref().map(|boot| format!("{BOOT}{}", boot.0));
    let said = rev.iter().chain(&expect.hash).chain(&boot);
    let tags: Vec<String> = said.map(|tag| etag(tag)).collect();
    (!tags.is_empty()).then(|| tags.join(", "))
}

/// Parses the hashes in a header. With `is_strict`, as in `If-Match`, a weak tag matches no program.
pub(super) fn hashes(name: &str, header: &str, is_strict: bool) -> Result<Hashes, String> {
    if header.trim() == "*" {
        return Ok(Hashes::Any);
    }
    let read = tags(header).map(|tag| match tag.strip_prefix("W/") {
        Some(_) if is_strict => Ok(String::new()),
        weak => hash(unquoted(weak.unwrap_or(tag)))
            .ok_or_else(|| format!("{name} is * or the ETag of a program, its hash in quotes")),
    });
    let read: Vec<String> = read.take(TAGS_MAX + 1).collect::<Result<_, _>>()?;
    if read.len() > TAGS_MAX {
        let text = format!("{name} names more than {TAGS_MAX} programs");
        return Err(text);
    }
    Ok(Hashes::OneOf(
        read.into_iter().filter(|hash| !hash.is_empty()).collect(),
    ))
}

/// Returns the hashes as a header. An empty list becomes a tag that matches no program.
pub(super) fn of_hashes(hashes: &Hashes) -> String {
    match hashes {
        Hashes::Any => "*".to_owned(),
        Hashes::OneOf(hashes) if hashes.is_empty() => format!("W/{}", etag(&"0".repeat(HASH_DIGITS))),
        Hashes::OneOf(hashes) => hashes
            .iter()
            .map(|hash| etag(hash))
            .collect::<Vec<_>>()
            .join(", "),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn a() -> String {
        "aB".repeat(32)
    }

    #[test]
    fn command_if_match_takes_a_revision_quoted_or_not_a_hash_or_both() {
        let expect = |state_rev, hash: Option<String>| Expect {
            state_rev,
            hash,
            ..Expect::default()
        };
        let hash = a().to_ascii_lowercase();
        for (header, expected) in [
            ("\"12\"".to_owned(), Some(expect(Some(12), None))),
            ("7".to_owned(), Some(expect(Some(7), None))),
            ("W/\"3\"".to_owned(), None),
            ("*".to_owned(), None),
            (String::new(), None),
            ("1, 2".to_owned(), None),
            (etag(&a()), Some(expect(None, Some(hash.clone())))),
            (
                format!("{}, \"4\"", etag(&a())),
                Some(expect(Some(4), Some(hash.clone()))),
            ),
            (etag(&a()[1..]), None),
            (
                "\"boot:00c1\", \"4\"".to_owned(),
                Some(Expect {
                    boot_id: Some(BootId("00c1".to_owned())),
                    ..expect(Some(4), None)
                }),
            ),
            ("\"boot:\"".to_owned(), None),
            ("\"boot:a\", \"boot:b\"".to_owned(), None),
            (format!("\"boot:{}\"", "a".repeat(65)), None),
        ] {
            assert_eq!(super::expected(&header).ok(), expected, "{header}");
        }
    }

    #[test]
    fn program_conditions_take_lists_any_and_weak_tags_only_for_reads() {
        let hash = a().to_ascii_lowercase();
        let read = |name, header: &str| hashes(name, header, name == "if-match").ok();
        let one = Hashes::OneOf(vec![hash.clone()]);
        assert_eq!(read("if-match", "*"), Some(Hashes::Any));
        assert_eq!(read("if-match", &etag(&a())), Some(one.clone()));
        assert_eq!(read("if-match", &a()), Some(one.clone()));
        assert_eq!(
            read("if-match", &format!("W/{}", etag(&a()))),
            Some(Hashes::OneOf(vec![]))
        );
        assert_eq!(read("if-none-match", &format!("W/{}", etag(&a()))), Some(one));
        assert_eq!(read("if-match", "\"12\""), None);
        assert_eq!(read("if-match", ""), None);
        assert_eq!(read("if-match", &vec![etag(&a()); 65].join(",")), None);
        assert!(is_had("*", &hash) && is_had(&format!("\"x\", W/\"{hash}\""), &hash));
        assert!(!is_had("\"x\"", &hash));
    }
}
