//! Pages generated from the product: `TANDEM_UPDATE=1 cargo test -p tandem --test it book::`.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use std::process::Command;

use serde_json::Value;

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

/// Returns the names of the third-party packages in the command on Linux, with their licences and addresses.
fn third_party() -> BTreeSet<(String, String, String)> {
    let ran = Command::new(env!("CARGO"))
        .args(["metadata", "--format-version", "1", "--locked", "--offline"])
        .args(["--filter-platform", "x86_64-unknown-linux-gnu"])
        .current_dir(root())
        .output()
        .unwrap();
    assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr));
    let metadata: Value = serde_json::from_slice(&ran.stdout).unwrap();
    let by_id = |list: &Value| -> BTreeMap<String, Value> {
        let list = list.as_array().unwrap().iter();
        list.map(|entry| (entry["id"].as_str().unwrap().to_owned(), entry.clone()))
            .collect()
    };
    let (packages, nodes) = (by_id(&metadata["packages"]), by_id(&metadata["resolve"]["nodes"]));
    let is_command = |package: &&Value| package["name"] == "tandem-runtime";
    let command = packages.values().find(is_command).unwrap();
    let mut open = vec![command["id"].as_str().unwrap()];
    let mut reached = BTreeSet::new();
    while let Some(id) = open.pop() {
        if !reached.insert(id) {
            continue;
        }
        for dependency in nodes[id]["deps"].as_array().unwrap() {
            let kinds = dependency["dep_kinds"].as_array().unwrap();
            if kinds.iter().any(|kind| kind["kind"].is_null()) {
                open.push(dependency["pkg"].as_str().unwrap());
            }
        }
    }
    let text = |value: &Value| value.as_str().unwrap_or_default().to_owned();
    let others = reached.into_iter().map(|id| &packages[id]);
    others
        .filter(|package| !package["source"].is_null())
        .map(|package| {
            let (name, licence) = (text(&package["name"]), text(&package["license"]));
            (name, licence.replace('/', " OR "), text(&package["repository"]))
        })
        .collect()
}

#[test]
fn third_party_page_lists_the_linked_packages_with_licences() {
    let packages = third_party();
    let mut page = String::from(
        "# Third-party licences\n\nThe packages of others that the command `tandem` is made of on Linux; `Cargo.lock` names their \
         versions. Each carries the text\nof its licence. The editor of the HMI is CodeMirror (MIT); `web/vendor/LICENSES.txt` has the licences of \
         its parts.\n\n| package | licence | address |\n| --- | --- | --- |\n",
    );
    for (name, licence, address) in &packages {
        assert!(!licence.is_empty(), "{name} names no licence");
        writeln!(page, "| {name} | {licence} | {address} |").unwrap();
    }
    assert!(packages.iter().any(|(name, ..)| name == "tokio"), "{packages:?}");
    check("docs/src/reference/third-party.md", &page);
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
