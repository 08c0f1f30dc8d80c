//! Pages generated from the product: `TANDEM_UPDATE=1 cargo test -p tandem --test it book::`.

use std::fmt::Write;
use std::process::Command;

use crate::support::binary::{root, tandem};

/// Compares a page with its expected text, or writes it again.
pub fn check(path: &str, text: &str) {
    let file = root().join(path);
    if std::env::var_os("TANDEM_UPDATE").is_some() {
        std::fs::write(&file, text).unwrap();
    }
    let stored = std::fs::read_to_string(&file).unwrap_or_default();
    assert!(
        stored == text,
        "{path} is not up to date: TANDEM_UPDATE=1 cargo test -p tandem --test it book:: writes it anew"
    );
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
        "# Command line\n\nThis is the output of `tandem -h` and `tandem COMMAND -h`. Exit status: 0 clean, completed, \
         or shut down on request;\n1 errors were found, or an alarm ended the program; 2 a file cannot be read, or \
         the command cannot be executed;\n70 `tandem serve` stopped after an internal fault.\n\n",
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

#[test]
fn the_version_that_is_told_is_that_of_the_packages_and_of_the_pages() {
    let ran = Command::new(tandem()).arg("--version").output().unwrap();
    let said = String::from_utf8(ran.stdout).unwrap();
    let version = env!("CARGO_PKG_VERSION");
    assert!(said.starts_with(&format!("tandem {version} (")), "{said}");
    let page = |path: &str| std::fs::read_to_string(root().join(path)).unwrap();
    assert!(page("README.md").contains(&format!("\nTandem {version} runs machine mill-1.\n")));
    assert!(page("CHANGELOG.md").contains(version));
}

#[test]
fn bash_completes_commands_and_options() {
    let complete = |words: &str, current: &str| {
        let script = format!(
            "source <(\"$0\" completions bash); COMP_WORDS=({words}); COMP_CWORD=$((${{#COMP_WORDS[@]}} - 1)); \
             _tandem tandem '{current}' x; echo \"${{COMPREPLY[@]}}\""
        );
        let ran = Command::new("bash")
            .args(["-c", &script])
            .arg(tandem())
            .output()
            .unwrap();
        String::from_utf8(ran.stdout).unwrap().trim().to_owned()
    };
    assert_eq!(complete("tandem si", "si"), "simulate");
    assert_eq!(
        complete("tandem simulate --trace-", "--trace-"),
        "--trace-spindle"
    );
}

#[test]
fn each_command_has_a_manual_page() {
    let page = |arguments: &[&str]| {
        let ran = Command::new(tandem())
            .arg("man")
            .args(arguments)
            .output()
            .unwrap();
        (ran.status.code(), String::from_utf8(ran.stdout).unwrap())
    };
    let top = help(&[]);
    let (_, tandem) = page(&[]);
    for command in listed(&top) {
        assert!(
            tandem.contains(&format!("tandem\\-{}(1)", command.replace('-', "\\-"))),
            "{command}"
        );
        let (code, text) = page(&[command]);
        assert_eq!(code, Some(0), "{command}");
        assert!(text.contains(&format!(".TH tandem-{command} 1")), "{text}");
    }
    assert_eq!(page(&["nothing"]), (Some(2), String::new()));
}
