//! Pages that are written from the product: `TANDEM_UPDATE=1 cargo test -p tandem --test it book::generated`.

use std::fmt::Write;
use std::process::Command;

use crate::support::binary::{root, tandem};

/// Compares a page with what it must be, or writes it anew.
fn check(path: &str, text: &str) {
    let file = root().join(path);
    if std::env::var_os("TANDEM_UPDATE").is_some() {
        std::fs::write(&file, text).unwrap();
    }
    let stored = std::fs::read_to_string(&file).unwrap_or_default();
    assert!(stored == text, "{path} is not up to date");
}

fn help(arguments: &[&str]) -> String {
    let ran = Command::new(tandem()).args(arguments).arg("-h").output().unwrap();
    assert!(ran.status.success(), "tandem {arguments:?} -h");
    String::from_utf8(ran.stdout).unwrap()
}

/// The commands that `tandem -h` lists.
fn listed(help: &str) -> Vec<&str> {
    let list = help.split_once("Commands:\n").unwrap().1;
    let rows = list.lines().take_while(|line| !line.is_empty());
    rows.filter_map(|line| line.split_whitespace().next())
        .filter(|name| *name != "help")
        .collect()
}

#[test]
fn the_page_of_the_command_line_is_what_the_command_says() {
    let top = help(&[]);
    let mut page = String::from(
        "# Command line\n\nWhat `tandem -h` and `tandem COMMAND -h` print. Exit status: 0 clean, completed, or stopped in \
         order; 1 errors were\nfound, or an alarm ended the program; 2 something cannot be read, or cannot be carried \
         out.\n\n",
    );
    write!(page, "```text\n{top}```\n").unwrap();
    let commands = listed(&top);
    assert!(commands.len() > 8, "{commands:?}");
    for command in commands {
        let help = help(&[command]);
        write!(page, "\n## tandem {command}\n\n```text\n{help}```\n").unwrap();
    }
    check("docs/src/reference/cli.md", &page);
}
