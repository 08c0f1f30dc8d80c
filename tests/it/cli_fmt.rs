//! `tandem fmt`.

use std::fs;
use std::os::unix::fs::{PermissionsExt as _, symlink};

use crate::cli_findings::run_with;
use crate::support::binary::root;
use crate::support::machine::Machine;
use crate::support::simulated::run;

const UGLY: &str = "g90  g54\nG01X10 f1000// fast\nm30";
const LAID_OUT: &str = "G90 G54\nG01 X10 F1000 // fast\nM30\n";

#[test]
fn fmt_rewrites_only_unformatted_files_and_keeps_mode_and_links() {
    let machine = Machine::new("");
    machine.write("ugly.nc", UGLY);
    machine.write("good.nc", LAID_OUT);
    symlink("ugly.nc", machine.path("link.nc")).unwrap();
    fs::set_permissions(machine.path("ugly.nc"), fs::Permissions::from_mode(0o640)).unwrap();
    let written = || fs::metadata(machine.path("good.nc")).unwrap().modified().unwrap();
    let before = written();
    let ran = run(machine.folder(), &["fmt", "link.nc", "good.nc"]);
    assert_eq!((ran.code, ran.stdout.as_str(), ran.stderr.as_str()), (0, "", ""));
    assert_eq!(fs::read_to_string(machine.path("ugly.nc")).unwrap(), LAID_OUT);
    assert_eq!(written(), before);
    assert!(
        fs::symlink_metadata(machine.path("link.nc"))
            .unwrap()
            .is_symlink()
    );
    let mode = fs::metadata(machine.path("ugly.nc"))
        .unwrap()
        .permissions()
        .mode();
    assert_eq!(mode & 0o777, 0o640);
    let names: Vec<_> = fs::read_dir(machine.folder())
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .filter(|name| !["ugly.nc", "good.nc", "link.nc", "tandem.toml"].contains(&name.as_str()))
        .collect();
    assert_eq!(names, [""; 0], "nothing else is left");
}

#[test]
fn fmt_check_names_the_files_and_writes_nothing() {
    let machine = Machine::new("");
    machine.write("ugly.nc", UGLY);
    machine.write("good.nc", LAID_OUT);
    let ran = run(machine.folder(), &["fmt", "--check", "good.nc", "ugly.nc"]);
    assert_eq!((ran.code, ran.stdout.as_str()), (1, "ugly.nc\n"));
    assert_eq!(fs::read_to_string(machine.path("ugly.nc")).unwrap(), UGLY);
    assert_eq!(run(machine.folder(), &["fmt", "--check", "good.nc"]).code, 0);
    let ran = run_with(machine.folder(), &["fmt", "--check", "-"], UGLY);
    assert_eq!((ran.code, ran.stdout.as_str()), (1, "<stdin>\n"));
}

#[test]
fn fmt_reads_standard_input_and_writes_standard_output() {
    let machine = Machine::new("");
    let ran = run_with(machine.folder(), &["fmt", "-"], UGLY);
    assert_eq!((ran.code, ran.stdout.as_str()), (0, LAID_OUT));
    let text = "%\no1\ng00x1.\nm30\n%\n";
    let ran = run_with(machine.folder(), &["fmt", "-", "--dialect", "dgshape"], text);
    assert_eq!((ran.code, ran.stdout.as_str()), (0, "%\nO1\nG00 X1.\nM30\n%\n"));
}

#[test]
fn fmt_leaves_a_program_with_errors_as_it_is_and_says_what_is_wrong() {
    let machine = Machine::new("");
    let broken = "g90\nx 1 (c)\n";
    machine.write("broken.nc", broken);
    let ran = run(machine.folder(), &["fmt", "broken.nc", "nothing.nc"]);
    assert_eq!(ran.code, 2);
    let ran = run(machine.folder(), &["fmt", "broken.nc"]);
    assert_eq!((ran.code, ran.stdout.as_str()), (1, ""));
    for said in ["broken.nc:2:5", "E0003", "broken.nc: not changed"] {
        assert!(ran.stderr.contains(said), "{}", ran.stderr);
    }
    assert_eq!(fs::read_to_string(machine.path("broken.nc")).unwrap(), broken);
    let ran = run_with(machine.folder(), &["fmt", "-"], broken);
    assert_eq!((ran.code, ran.stdout.as_str()), (1, broken));
    fs::write(machine.path("old.nc"), b"g90 // \xe4\nM30\n").unwrap();
    let ran = run(machine.folder(), &["fmt", "old.nc"]);
    assert_eq!(ran.code, 2);
    assert!(ran.stderr.contains("not UTF-8"), "{}", ran.stderr);
}

#[test]
fn every_example_is_laid_out() {
    for (dialect, folder) in [("nj", "examples/nc"), ("dgshape", "examples/nc/dgshape")] {
        let files: Vec<String> = fs::read_dir(root().join(folder))
            .unwrap()
            .map(|entry| entry.unwrap().path())
            .filter(|path| path.extension().is_some_and(|extension| extension == "nc"))
            .map(|path| path.to_str().unwrap().to_owned())
            .collect();
        assert!(!files.is_empty(), "{folder}");
        let mut arguments = vec!["fmt", "--check", "--dialect", dialect];
        arguments.extend(files.iter().map(String::as_str));
        let ran = run(root(), &arguments);
        assert_eq!((ran.code, ran.stdout.as_str()), (0, ""), "{}", ran.stderr);
    }
}
