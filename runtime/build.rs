//! Tells the command of which commit it is: `TANDEM_BUILD`.
#![allow(clippy::print_stdout, reason = "this is how a build script talks to cargo")]

use std::path::Path;
use std::process::Command;

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    // A debug build is of whatever the folder holds: no commit names it, and a new one compiles nothing again.
    let is_debug = std::env::var("PROFILE").is_ok_and(|profile| profile == "debug");
    let build = if is_debug {
        "debug build".to_owned()
    } else {
        let commit = packaged().or_else(checked_out);
        format!("commit {}", commit.as_deref().unwrap_or("unknown"))
    };
    println!("cargo::rustc-env=TANDEM_BUILD={build}");
}

/// Returns the commit that a package was made of.
fn packaged() -> Option<String> {
    let text = std::fs::read_to_string(".cargo_vcs_info.json").ok()?;
    let (_, rest) = text.split_once("\"sha1\": \"")?;
    Some(rest.split('"').next()?.to_owned())
}

/// Returns the commit of the checkout that this folder belongs to.
fn checked_out() -> Option<String> {
    let top = git(&["--show-toplevel"])?;
    let is_ours = Path::new("..").canonicalize().ok()? == Path::new(&top).canonicalize().ok()?;
    if !is_ours {
        return None;
    }
    // both change with each commit and checkout; a file that is not there would run this at each build
    for file in ["HEAD", "logs/HEAD"] {
        let path = git(&["--git-path", file])?;
        if Path::new(&path).exists() {
            println!("cargo::rerun-if-changed={path}");
        }
    }
    git(&["HEAD"])
}

/// Returns the output of `git rev-parse`.
fn git(what: &[&str]) -> Option<String> {
    let ran = Command::new("git").arg("rev-parse").args(what).output().ok()?;
    let said = String::from_utf8(ran.stdout).ok()?;
    ran.status.success().then(|| said.trim().to_owned())
}
