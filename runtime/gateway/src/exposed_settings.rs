//! Checks settings that open the server to other computers: pages of other origins, and a folder of files.

use std::path::{Path, PathBuf};

use axum::http::uri::Authority;

/// Returns true if a text is an origin as a browser writes it: scheme and host in small letters, and a port that is not
/// the default.
pub(crate) fn is_origin(text: &str) -> bool {
    let named = text
        .strip_prefix("https://")
        .or_else(|| text.strip_prefix("http://"));
    named.is_some_and(|named| {
        let is_written =
            |byte: u8| byte.is_ascii_lowercase() || byte.is_ascii_digit() || b".-:[]".contains(&byte);
        let parsed = named.parse::<Authority>().ok();
        let again = parsed.map(|parsed| match parsed.port_u16() {
            Some(port) => format!("{}:{port}", parsed.host()),
            None => parsed.host().to_owned(),
        });
        named.bytes().all(is_written) && again.is_some_and(|again| again == named)
    })
}

/// Returns the reason why a folder cannot be served: it is not a folder, or it contains secret files.
pub(crate) fn folder_problem(dir: &Path, secrets: &[PathBuf]) -> Option<String> {
    let place = match dir.canonicalize() {
        Ok(place) if place.is_dir() => place,
        Ok(_) => return Some("this is not a folder".to_owned()),
        Err(error) => return Some(error.to_string()),
    };
    let secret = secrets.iter().find(|secret| {
        let secret = secret.canonicalize();
        secret.is_ok_and(|secret| secret.starts_with(&place) || place.starts_with(&secret))
    })?;
    let text = format!(
        "every client may read this folder, but {} is in it; write a folder that contains only pages",
        secret.display()
    );
    Some(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_origin_is_written_as_browsers_write_it() {
        for origin in [
            "https://hmi.example.com",
            "http://localhost:5173",
            "http://[::1]:9000",
            "https://10.0.0.7",
        ] {
            assert!(is_origin(origin), "{origin}");
        }
        for origin in [
            "*",
            "null",
            "",
            "hmi.example.com",
            "https://",
            "https://hmi.example.com/",
            "https://HMI.example.com",
            "https://hmi.example.com/page",
            "https://user@hmi.example.com",
            "ftp://hmi.example.com",
            "https://*.example.com:x",
            "file://",
        ] {
            assert!(!is_origin(origin), "{origin}");
        }
    }

    #[test]
    fn a_folder_with_secrets_in_it_or_around_it_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir_all(folder.path().join("hmi/parts")).unwrap();
        std::fs::write(folder.path().join("hmi/index.html"), "").unwrap();
        let at = |name: &str| folder.path().join(name);
        let tokens = at("hmi/tokens.toml");
        assert_eq!(
            folder_problem(&at("hmi"), &[tokens.clone(), at("data")]),
            None,
            "neither is there"
        );
        std::fs::write(&tokens, "").unwrap();
        assert!(
            folder_problem(&at("hmi"), &[tokens])
                .unwrap()
                .contains("tokens.toml")
        );
        assert!(
            folder_problem(&at("hmi/parts"), &[at("hmi")]).is_some(),
            "the data folder contains it"
        );
        assert!(
            folder_problem(&at("hmi/index.html"), &[])
                .unwrap()
                .contains("not a folder")
        );
        assert!(folder_problem(&at("none"), &[]).is_some());
    }
}
