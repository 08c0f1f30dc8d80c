//! Finds the user of the operating system that has started a command.

use std::fs;
use std::os::unix::fs::MetadataExt as _;

/// Returns the user name of this process, or for example `uid 1000` if the user has no name. With sudo, also
/// contains the name of the user that called sudo.
pub(super) fn os_user() -> Option<String> {
    let uid = fs::metadata("/proc/self").ok()?.uid();
    let users = fs::read_to_string("/etc/passwd").unwrap_or_default();
    let name = name_of(uid, &users).map_or_else(|| format!("uid {uid}"), str::to_owned);
    Some(match std::env::var("SUDO_USER") {
        Ok(caller) if uid == 0 && !caller.is_empty() => format!("{name} (sudo of {caller:.64})"),
        _ => name,
    })
}

/// Finds the name of a user id in the text of `/etc/passwd`.
fn name_of(uid: u32, users: &str) -> Option<&str> {
    users.lines().find_map(|line| {
        let mut fields = line.split(':');
        let (name, id) = (fields.next()?, fields.nth(1)?);
        (id.parse() == Ok(uid)).then_some(name)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_user_has_the_name_of_its_id() {
        let users = "root:x:0:0:root:/:/bin/sh\nanna:x:1000:1000::/:/bin/sh\nbroken\n";
        assert_eq!(name_of(1000, users), Some("anna"));
        assert_eq!(name_of(0, users), Some("root"));
        assert_eq!(name_of(7, users), None);
    }
}
