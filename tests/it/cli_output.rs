//! Standard output of the commands: a failure to write it is an error.

use std::fs::File;
use std::io::Read as _;
use std::process::{Command, Stdio};

use crate::support::binary::{root, tandem};

/// Commands that print something and succeed.
const COMMANDS: [&[&str]; 8] = [
    &["--help"],
    &["--version"],
    &["check", "--format", "json", "examples/nc/flange.nc"],
    &["compile", "examples/nc/flange.nc"],
    &["explain"],
    &["token", "hmi", "--role", "view"],
    &["completions", "bash"],
    &["man"],
];

#[test]
fn what_cannot_be_written_to_standard_output_is_no_success_and_is_told() {
    for arguments in COMMANDS {
        let run = |out: Stdio| {
            let mut command = Command::new(tandem());
            command.args(arguments).current_dir(root());
            command.stdout(out).output().expect("tandem starts")
        };
        let well = run(Stdio::piped());
        assert_eq!(well.status.code(), Some(0), "{arguments:?}");
        let full = run(File::create("/dev/full").expect("a full disk").into());
        assert_eq!(full.status.code(), Some(2), "{arguments:?}");
        let told = String::from_utf8_lossy(&full.stderr);
        assert!(
            told.contains("cannot write to standard output"),
            "{arguments:?}: {told}"
        );
        assert_eq!(told.matches("cannot write").count(), 1, "{arguments:?}: {told}");
    }
}

#[test]
fn a_reader_that_has_gone_is_no_failure() {
    let mut child = Command::new(tandem())
        .arg("explain")
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("tandem starts");
    drop(child.stdout.take());
    let mut told = String::new();
    child.stderr.take().unwrap().read_to_string(&mut told).unwrap();
    assert_eq!((child.wait().unwrap().code(), told.as_str()), (Some(0), ""));
}
