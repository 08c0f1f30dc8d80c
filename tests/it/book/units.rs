//! systemd accepts every line of the unit files.

use std::process::Command;

use super::page::{blocks, pages, read};

/// Replaces the program of a unit by an installed program.
fn with_a_program_that_is_there(unit: &str) -> String {
    let lines = unit.lines().map(|line| match line.strip_prefix("ExecStart=") {
        Some(command) => {
            let arguments = command.split_once(' ').map_or("", |(_, arguments)| arguments);
            format!("ExecStart=/bin/true {arguments}\n")
        }
        None => format!("{line}\n"),
    });
    lines.collect()
}

#[test]
fn systemd_takes_every_line_of_every_unit() {
    if Command::new("systemd-analyze").arg("--version").output().is_err() {
        // a system without systemd cannot check its units
        return;
    }
    let of_pages = pages().into_iter().flat_map(|path| {
        let units = blocks(&read(&path)).into_iter().map(|block| block.text);
        let units = units.filter(|text| text.contains("[Unit]\n"));
        units.map(|text| (path.clone(), text)).collect::<Vec<_>>()
    });
    let file = "docs/deploy/tandem.service";
    let units: Vec<_> = of_pages.chain([(file.to_owned(), read(file))]).collect();
    assert!(units.len() > 3, "{} units", units.len());
    let folder = tempfile::tempdir().unwrap();
    for (path, unit) in units {
        let here = folder.path().join("unit.service");
        std::fs::write(&here, with_a_program_that_is_there(&unit)).unwrap();
        let said = Command::new("systemd-analyze")
            .args(["verify", "--man=no"])
            .arg(&here)
            .output()
            .unwrap();
        let says = String::from_utf8_lossy(&said.stderr);
        let of_it: Vec<_> = says
            .lines()
            .filter(|line| line.contains("unit.service"))
            .collect();
        assert!(said.status.success() && of_it.is_empty(), "{path}: {says}");
    }
}
