//! The container file fits the build that is documented; containers are not built here.

use super::page::read;

/// Returns the words of the command for the static build, from `cargo build` on.
fn build(text: &str) -> Vec<String> {
    let joined = text.replace("\\\n", " ");
    let command = joined
        .lines()
        .find_map(|line| line.split_once("cargo build --profile"))
        .map(|(_, rest)| format!("--profile{rest}"))
        .expect("a build of a static file");
    let words = command.split_whitespace().filter(|word| *word != "#");
    words.map(str::to_owned).collect()
}

fn after<'a>(words: &'a [String], option: &str) -> &'a str {
    let at = words.iter().position(|word| word == option).unwrap();
    &words[at + 1]
}

#[test]
fn the_container_file_copies_what_the_documented_build_makes() {
    let file = read("docs/deploy/Containerfile");
    let words = build(&file);
    assert_eq!(
        words,
        build(&read("docs/src/how-to/deploy.md")),
        "the page of deployment"
    );
    let (profile, target) = (after(&words, "--profile"), after(&words, "--target"));
    let (package, command) = (after(&words, "-p"), after(&words, "--bin"));
    let copied = format!("COPY target/{target}/{profile}/{command} /tandem\n");
    assert!(file.contains(&copied), "{copied}");
    assert!(file.contains("ENTRYPOINT [\"/tandem\"]\n"));
    assert!(read("Cargo.toml").contains(&format!("[profile.{profile}]\n")));
    let manifest = read("runtime/Cargo.toml");
    assert!(manifest.contains(&format!("name = \"{package}\"\n")));
    assert!(manifest.contains(&format!("[[bin]]\nname = \"{command}\"\n")));
}

#[test]
fn the_static_file_of_the_long_tests_is_that_of_the_container() {
    let tests = read("tests/run").replace("$triple", "x86_64-unknown-linux-gnu");
    let words = build(&tests);
    let of_container = build(&read("docs/deploy/Containerfile"));
    assert_eq!(words[..of_container.len()], of_container[..]);
}
