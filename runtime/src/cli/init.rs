//! `tandem init`: creates a folder with a configuration, an NC program, and handlers with a test that passes.

use std::io;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use clap::Args;

use super::{CommandResult, EXIT_OK, print_line};

/// Files to write, by their path in the folder, with their templates. `{{...}}` in a template is replaced.
const FILES: [(&str, &str); 7] = [
    ("Cargo.toml", include_str!("init/Cargo.toml.txt")),
    (".gitignore", "/target\n/tandem-data\n"),
    ("tandem.toml", include_str!("init/tandem.toml.txt")),
    ("nc/1.nc", include_str!("init/1.nc.txt")),
    ("src/lib.rs", include_str!("init/lib.rs.txt")),
    ("src/main.rs", include_str!("init/main.rs.txt")),
    ("tests/program.rs", include_str!("init/program.rs.txt")),
];

/// Name of the machine and of the package if the name of the folder contains no letter.
const NAME: &str = "my-machine";

/// Largest number of characters of a name, as for an MQTT topic level.
const NAME_MAX: usize = 32;

/// Names that a package cannot have: keywords and crates of Rust, folders that cargo creates, and packages
/// that the project uses.
const TAKEN: &[&str] = &[
    "abstract",
    "alloc",
    "as",
    "async",
    "await",
    "become",
    "bin",
    "box",
    "break",
    "build",
    "const",
    "continue",
    "core",
    "crate",
    "deps",
    "do",
    "dyn",
    "else",
    "enum",
    "examples",
    "extern",
    "false",
    "final",
    "fn",
    "for",
    "gen",
    "if",
    "impl",
    "in",
    "incremental",
    "let",
    "loop",
    "macro",
    "main",
    "match",
    "mod",
    "move",
    "mut",
    "override",
    "plc-api",
    "priv",
    "proc-macro",
    "program",
    "pub",
    "ref",
    "return",
    "self",
    "static",
    "std",
    "struct",
    "super",
    "tandem-testing",
    "target",
    "test",
    "tokio",
    "trait",
    "true",
    "try",
    "tracing",
    "type",
    "typeof",
    "union",
    "unsafe",
    "unsized",
    "use",
    "virtual",
    "where",
    "while",
    "yield",
];

/// List of the files in the folder.
const CONTENT: &str = "  \
  tandem.toml       motors, axes, M codes
  nc/1.nc           an NC program
  src/lib.rs        handlers of M codes
  tests/program.rs  a unit test of machine, program and handlers
";

/// Next steps that are printed for the user.
const NEXT: &str = "Next, in this folder: cargo test; then tandem serve --config tandem.toml and, in a second shell, cargo \
     run.";

#[derive(Args)]
pub struct InitArguments {
    /// Folder to write; it must be new or empty
    dir: PathBuf,
    /// Checkout of Tandem whose plc-api and tandem-testing the project uses; default: the checkout that contains the current
    /// folder, otherwise the one in which this command was built, otherwise the published versions
    #[arg(long, value_name = "DIR")]
    checkout: Option<PathBuf>,
}

pub(super) fn run(arguments: &InitArguments) -> CommandResult {
    let dir = &arguments.dir;
    let cannot = |what: &Path| format!("cannot write {}", what.display());
    let checkout = find_checkout(arguments.checkout.as_deref())?;
    let is_empty = match std::fs::read_dir(dir) {
        Ok(mut entries) => entries.next().is_none(),
        Err(error) if error.kind() == io::ErrorKind::NotFound => true,
        Err(error) => return Err(error).with_context(|| cannot(dir)),
    };
    if !is_empty {
        bail!("{} is not empty; name a new folder", dir.display());
    }
    let wanted = file_name_of(dir);
    let name = name_of(&wanted)?;
    let dependency = |folder: &str| match &checkout {
        Some(checkout) => {
            let path = checkout.join(folder).display().to_string();
            format!("path = {}", toml::Value::String(path))
        }
        None => format!("version = \"{}\"", env!("CARGO_PKG_VERSION")),
    };
    for (place, text) in FILES {
        let text = text
            .replace("{{name}}", &name)
            .replace("{{crate}}", &name.replace('-', "_"))
            .replace("{{plc-api}}", &dependency("plc-api"))
            .replace("{{tandem-testing}}", &dependency("runtime/testing"));
        let path = dir.join(place);
        if let Some(folder) = path.parent() {
            std::fs::create_dir_all(folder).with_context(|| cannot(folder))?;
        }
        std::fs::write(&path, text).with_context(|| cannot(&path))?;
    }
    if let Some(checkout) = &checkout {
        // The checkout is tested with the versions in its lock file.
        let lock = dir.join("Cargo.lock");
        std::fs::copy(checkout.join("Cargo.lock"), &lock).with_context(|| cannot(&lock))?;
    }
    let crates = match &checkout {
        Some(checkout) => format!("It uses plc-api and tandem-testing of {}.", checkout.display()),
        None => format!(
            "It uses plc-api and tandem-testing {} of crates.io. If they are not published, name \
             a checkout: tandem init DIR --checkout PATH",
            env!("CARGO_PKG_VERSION")
        ),
    };
    if name != wanted {
        print_line(format!(
            "The machine and its package are called {name}: a name has the letters a to z, digits and hyphens."
        ));
    }
    print_line(format!(
        "{} holds a machine:\n{CONTENT}{crates}\n{NEXT}",
        dir.display()
    ));
    Ok(EXIT_OK)
}

/// Returns the checkout on which the project depends: the named one, otherwise the one that contains the
/// current folder, otherwise the one that contains this executable.
fn find_checkout(named: Option<&Path>) -> anyhow::Result<Option<PathBuf>> {
    if let Some(named) = named {
        let there = named.canonicalize().ok().filter(|path| is_checkout(path));
        let missing = || format!("{} is not a checkout of Tandem", named.display());
        return there.with_context(missing).map(Some);
    }
    let around = [std::env::current_dir().ok(), std::env::current_exe().ok()];
    let mut folders = around.iter().flatten().flat_map(|path| path.ancestors());
    Ok(folders.find(|path| is_checkout(path)).map(Path::to_owned))
}

fn is_checkout(folder: &Path) -> bool {
    ["plc-api/Cargo.toml", "runtime/Cargo.toml", "Cargo.lock"]
        .iter()
        .all(|file| folder.join(file).is_file())
}

/// Returns the last part of the folder's path.
fn file_name_of(dir: &Path) -> String {
    let absolute = std::path::absolute(dir).unwrap_or_else(|_| dir.to_owned());
    absolute
        .file_name()
        .unwrap_or_default()
        .to_string_lossy()
        .into_owned()
}

/// Converts the name of a folder into a name for a package and a machine: `[a-z0-9-]`, beginning with a
/// letter.
///
/// # Errors
/// Returns an error if cargo or Rust rejects the name for a package.
fn name_of(file_name: &str) -> anyhow::Result<String> {
    let name: String = file_name.to_lowercase().chars().map(plain).collect();
    let name = name.trim_start_matches(|letter: char| !letter.is_ascii_lowercase());
    let name: String = name.chars().take(NAME_MAX).collect();
    let name = name.trim_end_matches('-');
    if name.is_empty() {
        return Ok(NAME.to_owned());
    }
    if TAKEN.contains(&name) {
        bail!(
            "a package cannot be called {name}, because Rust or cargo reserves this name; name another \
             folder, such as {name}-machine"
        );
    }
    Ok(name.to_owned())
}

/// Returns the replacement of a letter: letters with diacritics are replaced by letters without.
fn plain(letter: char) -> &'static str {
    const PLAIN: &[(&str, &str)] = &[
        ("ä", "ae"),
        ("ö", "oe"),
        ("ü", "ue"),
        ("ß", "ss"),
        ("æ", "ae"),
        ("œ", "oe"),
        ("ø", "o"),
        ("å", "a"),
        ("àáâãā", "a"),
        ("èéêëě", "e"),
        ("ìíîï", "i"),
        ("òóôõ", "o"),
        ("ùúûů", "u"),
        ("çčć", "c"),
        ("ñň", "n"),
        ("šś", "s"),
        ("žźż", "z"),
        ("ř", "r"),
        ("ýÿ", "y"),
        ("ł", "l"),
        ("ďð", "d"),
        ("ťþ", "t"),
        ("ğ", "g"),
    ];
    const ASCII: &str = "abcdefghijklmnopqrstuvwxyz0123456789";
    if let Some(place) = ASCII.find(letter) {
        return &ASCII[place..=place];
    }
    let known = PLAIN.iter().find(|(letters, _)| letters.contains(letter));
    known.map_or("-", |(_, plain)| plain)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_name_is_one_of_a_package_and_of_a_machine() {
        let name = |dir: &str| name_of(&file_name_of(Path::new(dir))).unwrap();
        assert_eq!(name("Mill 1"), "mill-1");
        assert_eq!(name("a/5-axis_mill"), "axis-mill");
        assert_eq!(name("42"), NAME);
        assert_eq!(name("Mühle"), "muehle");
        assert_eq!(name("x".repeat(50).as_str()), "x".repeat(32));
    }

    #[test]
    fn a_name_that_rust_keeps_for_itself_is_refused_with_another() {
        for taken in ["self", "core", "std", "Test", "async", "plc-api"] {
            let refusal = name_of(taken).unwrap_err().to_string();
            assert!(refusal.contains("-machine"), "{refusal}");
        }
    }
}
