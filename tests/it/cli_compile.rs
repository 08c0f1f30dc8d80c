//! `tandem compile` and `tandem explain`.

use crate::support::machine::Machine;
use crate::support::simulated::{Ran, run};

/// A program with everything for which the intermediate code has a rule.
const MAIN: &str = "\
n5 g90 G64 F800 ta200 /* one comment
over two lines */
n6 S900 M3
/ X4.50

/2/3 Y[Q7] Z-1
while (P2<=L3) { P2=P2+1
X[P2] }
M110 VA1.25 VH[L0]
M98 P1200 L3
G98 G74 X20 Y5 Z-8 R-2 P250 K2 // first hole
G99 X30
Y9
G80 M5
if(isnan(P2)||!(P2==4)) M98 P1201 else {
G04 P50
}
M30 // the end
";

/// By the rules of the manual's appendix A-1 and D43.
const MAIN_CODE: &str = "\
open prog 1
N1 G90 G64 F800 ta200 M999.002
N3 S900 M3 M999.002
cskip1 N4 X4.50 M999.002
cskip2 cskip3 N6 Y(Q7) Z-1 M999.002
while(P2 <= L3)
{
P2 = P2 + 1
N8 X(P2) M999.002
}
N9 M110 A1.25 H(L0) M999.002
N10 M98 P1200 L3 M999.002
N11 G98 G80.001 G74 X20 Y5 Z-8 R-2 P250 K2 M999.002
N12 G99 G74 X30 M999.002
N13 G74 Y9 M999.002
N14 G80 M5 M999.002
if(isnan(P2) || !(P2 == 4))
N15 M98 P1201 M999.002
else
{
N16 G04 P50 M999.002
}
N18 M30 M999.002
close
";

fn compile(name: &str, text: &str, arguments: &[&str]) -> Ran {
    let machine = Machine::new("");
    machine.write(name, text);
    let mut all = vec!["compile", name];
    all.extend(arguments);
    run(machine.folder(), &all)
}

#[test]
fn d43_a_main_program_becomes_intermediate_code_byte_for_byte() {
    let ran = compile("plate.nc", MAIN, &[]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    assert_eq!(ran.stdout, MAIN_CODE);
}

#[test]
fn d43_return_stands_on_the_line_of_m99_and_else_in_the_footer() {
    let ran = compile("1200.nc", "X1\nM99\n", &[]);
    assert_eq!(
        ran.stdout,
        "open subprog 1200\nN1 X1 M999.002\nN2 M99 M999.002 return\nclose\n"
    );
    let ran = compile("O1200.nc", "if(L1==1) M99\nX1 M30\n", &[]);
    assert_eq!(
        ran.stdout,
        "open subprog 1200\nif(L1 == 1)\nN1 M99 M999.002 return\nN2 X1 M30 M999.002\nreturn\nclose\n"
    );
}

#[test]
fn the_header_is_that_of_the_file_name_or_the_flag() {
    for (name, flags, header) in [
        ("12.nc", &[][..], "open prog 12"),
        ("plate.nc", &["--main", "7"], "open prog 7"),
        ("plate.nc", &["--subprogram", "1000"], "open subprog 1000"),
        ("2999.nc", &["--main", "3"], "open prog 3"),
    ] {
        let ran = compile(name, "M30\n", flags);
        assert_eq!(ran.stdout.lines().next(), Some(header), "{name} {flags:?}");
    }
}

#[test]
fn with_a_folder_each_program_has_its_file() {
    let machine = Machine::new("");
    machine.write("plate.nc", MAIN);
    machine.write("1200.nc", "M99\n");
    let ran = run(
        machine.folder(),
        &["compile", "plate.nc", "1200.nc", "--out-dir", "out"],
    );
    assert_eq!((ran.code, ran.stdout.as_str()), (0, ""), "{}", ran.stderr);
    let read = |name: &str| std::fs::read_to_string(machine.path(name)).unwrap();
    assert_eq!(read("out/plate.pmc"), MAIN_CODE);
    assert!(read("out/1200.pmc").starts_with("open subprog 1200\n"));
}

#[test]
fn programs_with_the_same_output_name_are_refused_before_any_write() {
    let machine = Machine::new("");
    for folder in ["a", "b"] {
        std::fs::create_dir(machine.path(folder)).unwrap();
        machine.write(&format!("{folder}/7.nc"), "M30\n");
    }
    machine.write("8.nc", "M30\n");
    let compile = |files: &[&str]| {
        let mut arguments = vec!["compile"];
        arguments.extend(files);
        arguments.extend(["--out-dir", "out"]);
        run(machine.folder(), &arguments)
    };
    for files in [&["8.nc", "a/7.nc", "b/7.nc"][..], &["8.nc", "a/7.nc", "a/7.nc"]] {
        let ran = compile(files);
        assert_eq!(ran.code, 2, "{}", ran.stderr);
        for word in ["7.pmc", files[1], files[2]] {
            assert!(ran.stderr.contains(word), "{word} in {}", ran.stderr);
        }
        assert!(!machine.path("out").exists());
    }
    for flag in ["--main", "--subprogram"] {
        let ran = compile(&["8.nc", "a/7.nc", flag, "4"]);
        assert_eq!(ran.code, 2, "{}", ran.stderr);
        assert!(ran.stderr.contains(flag), "{}", ran.stderr);
        assert!(!machine.path("out").exists());
    }
}

#[test]
fn the_whole_name_of_a_program_is_that_of_its_result() {
    let machine = Machine::new("");
    machine.write("part.1.nc", "M30\n");
    machine.write("part.2.nc", "G04 P1\nM30\n");
    machine.write("source.pmc", "M30\n");
    let files = ["compile", "part.1.nc", "part.2.nc", "--out-dir", "."];
    assert_eq!(run(machine.folder(), &files).code, 0);
    for name in ["part.1.pmc", "part.2.pmc"] {
        assert!(machine.path(name).is_file(), "{name}");
    }
    let ran = run(machine.folder(), &["compile", "source.pmc", "--out-dir", "."]);
    assert_eq!(ran.code, 2, "{}", ran.stderr);
    assert_eq!(
        std::fs::read_to_string(machine.path("source.pmc")).unwrap(),
        "M30\n"
    );
}

#[test]
fn a_program_with_errors_is_not_compiled() {
    let ran = compile("plate.nc", "G01 X1 X2\nM30\n", &[]);
    assert_eq!((ran.code, ran.stdout.as_str()), (1, ""));
    assert!(
        ran.stderr.contains("E0105") && ran.stderr.contains("not compiled"),
        "{}",
        ran.stderr
    );
    assert_eq!(
        compile("plate.nc", "M30\n", &["nothing.nc", "--out-dir", "out"]).code,
        2
    );
}

#[test]
fn every_diagnostic_has_a_page() {
    let machine = Machine::new("");
    let all = run(machine.folder(), &["explain"]);
    let codes: Vec<&str> = all
        .stdout
        .lines()
        .filter_map(|line| line.split_whitespace().next())
        .collect();
    assert!(codes.contains(&"E0109") && codes.contains(&"W0006"), "{codes:?}");
    for code in codes {
        let page = run(machine.folder(), &["explain", &code.to_lowercase()]);
        assert_eq!(page.code, 0, "{code}");
        assert!(
            page.stdout.starts_with(&format!("{code}: ")) && page.stdout.contains("Example:"),
            "{code}"
        );
    }
    assert_eq!(run(machine.folder(), &["explain", "E9999"]).code, 2);
}

#[test]
fn a_key_of_the_configuration_and_a_rule_are_explained() {
    let machine = Machine::new("");
    let explain = |name: &str| {
        let ran = run(machine.folder(), &["explain", name]);
        assert_eq!(ran.code, 0, "{name}: {}", ran.stderr);
        ran.stdout
    };
    for name in ["coordinate_system.dry_run_feedrate", "dry_run_feedrate"] {
        assert_eq!(
            explain(name),
            "coordinate_system.dry_run_feedrate: number, units/min, 0 to 1e9, default 0.0\n\n\
             Feedrate of dry run; 0: `max_feedrate`.\n"
        );
    }
    let words = explain("overcut");
    assert!(
        words.contains("\n    \"detect\"  Raises an alarm before") && words.contains("\n    \"prevent\"  ")
    );
    let table = explain("machine");
    assert!(table.contains("machine.name: text, default \"mill-1\"") && table.contains("machine.data_dir: "));
    assert!(explain("d31").starts_with("D31: "));
    assert!(explain("H4").starts_with("H4: "));
    assert!(explain("M1b.2").starts_with("M1b.2: "));
    let group = explain("m1b");
    assert!(group.starts_with("M1b: ") && group.contains("\n\nM1b.4: "));
}

#[test]
fn a_name_that_nothing_has_is_told_with_the_nearest_one() {
    let machine = Machine::new("");
    for (name, nearest) in [
        ("dry_run_feedrat", "dry_run_feedrate"),
        ("motor.lag", "motor.lag_ms"),
        ("E0110x", "E0110"),
        ("M2b", "M1b"),
    ] {
        let ran = run(machine.folder(), &["explain", name]);
        assert_eq!(ran.code, 2, "{name}");
        assert!(
            ran.stderr.contains(&format!("did you mean {nearest}")),
            "{}",
            ran.stderr
        );
    }
}
