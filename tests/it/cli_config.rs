//! Errors for which `tandem check --config` and `tandem serve` refuse a configuration, with equal texts.

use std::path::Path;
use std::time::Duration;

use crate::support::binary::tandem;
use crate::support::machine::{COORDINATE_SYSTEMS, MOTORS, Machine};
use crate::support::served::{FREE_PORTS, Process};
use crate::support::simulated::{Ran, run};

/// Returns a configuration with one linear motor and one coordinate system, with the further keys `motor` and
/// `system`, followed by `more`.
fn small(motor: &str, system: &str, more: &str) -> String {
    format!(
        "[[motor]]\nnumber = 1\nkind = \"linear\"\nmax_velocity = 500.0\nmax_acceleration = 5000.0\n{motor}\n\
         [[coordinate_system]]\nnumber = 1\naxes = {{ X = 1 }}\n{system}\n{more}\n"
    )
}

fn check(config: &str) -> Ran {
    let machine = Machine::with_config(config);
    run(machine.folder(), &["check", "--config", "tandem.toml"])
}

/// Checks that each configuration is refused with exit code 2, and that the text contains all the words.
fn all_refused(cases: &[(String, &[&str])]) {
    let wrong: Vec<String> = cases
        .iter()
        .filter_map(|(config, words)| {
            let ran = check(config);
            let missing = words.iter().any(|word| !ran.stderr.contains(word));
            let text = format!("exit {}, {words:?} in:\n{}\n{config}", ran.code, ran.stderr);
            (ran.code != 2 || missing).then_some(text)
        })
        .collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n----\n"));
}

#[test]
fn the_configuration_that_these_tests_change_is_good() {
    let ran = check(&small("", "", ""));
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let all =
        "reference_points = [0.0, 1.0, -10.0, 5.0]\nsoft_limits = [-5, 5.5]\norientation_position = -90";
    assert_eq!(check(&small(all, "", "")).code, 0);
}

#[test]
fn a_motor_has_four_reference_points_and_two_soft_limits() {
    all_refused(&[
        (
            small("reference_points = [2.0]", "", ""),
            &["line 6", "1st to 4th"],
        ),
        (
            small("reference_points = [0.0, 0.0, 0.0, 0.0, 0.0]", "", ""),
            &["line 6", "reference_points", "1st to 4th"],
        ),
        (
            small("reference_points = []", "", ""),
            &["line 6", "reference_points"],
        ),
        (
            small("soft_limits = [-1.0, 1.0, 2.0]", "", ""),
            &["line 6", "soft_limits", "[lowest, highest]"],
        ),
        (small("soft_limits = [-1.0]", "", ""), &["line 6", "soft_limits"]),
    ]);
}

#[test]
fn every_number_of_a_motor_is_finite_and_in_range() {
    for key in [
        "max_jerk",
        "rapid_velocity",
        "rapid_acceleration",
        "skip_velocity",
        "in_position",
        "in_position_timeout_ms",
        "orientation_velocity",
    ] {
        let of = |value: &str| small(&format!("{key} = {value}"), "", "");
        let words: &[&str] = &["[[motor]] number = 1", key];
        all_refused(&["nan", "inf", "-1.0", "0.0", "1e308"].map(|value| (of(value), words)));
    }
    for value in ["nan", "inf", "-inf", "1e308"] {
        all_refused(&[
            (
                small(&format!("orientation_position = {value}"), "", ""),
                &["orientation_position"],
            ),
            (small(&format!("lag_ms = {value}"), "", ""), &["lag_ms"]),
            (
                small(&format!("reference_points = [0.0, {value}, 0.0, 0.0]"), "", ""),
                &["reference_points"],
            ),
            (
                small(&format!("soft_limits = [{value}, {value}]"), "", ""),
                &["soft_limits"],
            ),
            (
                small("", "", "").replace("max_velocity = 500.0", &format!("max_velocity = {value}")),
                &["max_velocity"],
            ),
        ]);
    }
    all_refused(&[
        (small("soft_limits = [-inf, 5.0]", "", ""), &["soft_limits"]),
        (small("soft_limits = [5.0, 5.0]", "", ""), &["soft_limits"]),
    ]);
}

#[test]
fn every_number_of_the_other_tables_is_finite_and_in_range() {
    for value in ["nan", "inf", "1e308"] {
        all_refused(&[
            (
                small("", "", &format!("[[tool]]\nid = 7\nradius = {value}")),
                &["[[tool]] id = 7", "radius"],
            ),
            (
                small("", "", &format!("[[tool]]\nid = 7\nlength = {value}")),
                &["[[tool]] id = 7", "length"],
            ),
            (
                small(
                    "",
                    "",
                    &format!("[coordinate_system.work_offset]\nG54 = {{ X = {value} }}"),
                ),
                &["work_offset.G54", "X"],
            ),
            (
                small("", "", &format!("[[simulated_skip]]\nmotor = 1\nbelow = {value}")),
                &["[[simulated_skip]] motor = 1"],
            ),
            (
                small("", "", &format!("[m_code.5]\nsimulated_ms = {value}")),
                &["[m_code.5]", "simulated_ms"],
            ),
        ]);
        for key in ["max_feedrate", "default_ts_ms", "rotary_feedrate", "hold_slew_ms"] {
            all_refused(&[(small("", &format!("{key} = {value}"), ""), &[key])]);
        }
    }
    all_refused(&[
        (
            small("", "", "[m_code.5]\ntimeout_ms = 0"),
            &["[m_code.5]", "timeout_ms"],
        ),
        (
            small("", "", "[m_code.5]\ntimeout_ms = 9223372036854775807"),
            &["[m_code.5]", "timeout_ms"],
        ),
        (
            small("", "", "[m_code.5]\nwait_state = \"\""),
            &["[m_code.5]", "wait_state"],
        ),
        (small("", "", "[machine]\ndata_dir = \"\""), &["data_dir"]),
        (small("", "", "[[tool]]\nid = 0"), &["[[tool]] id = 0"]),
        (
            small("", "", "[[tool]]\nid = 3\n[[tool]]\nid = 3"),
            &["[[tool]] id = 3", "twice"],
        ),
    ]);
}

#[test]
fn invalid_config_word_reported_with_line_and_allowed_words() {
    for (key, words) in [
        ("units", "\"mm\" or \"inch\""),
        ("short_block", "\"shrink\" or \"extend\""),
        ("compensation_feed", "\"centre\" or \"edge\""),
        ("overcut", "\"detect\" or \"prevent\""),
    ] {
        let message = format!("{key} = \"all\": write {words}");
        all_refused(&[(small("", &format!("{key} = \"all\""), ""), &["line 10", &message])]);
    }
    for (key, words) in [
        ("timing", "\"after_motion\" or \"with_motion\""),
        ("unhandled", "\"alarm\", \"wait\" or \"auto_reset\""),
        ("stock", "\"select_tool\""),
    ] {
        let message = format!("{key} = \"all\": write {words}");
        all_refused(&[(
            small("", "", &format!("[m_code.5]\n{key} = \"all\"")),
            &[&message],
        )]);
    }
    let broker = "[mqtt]\non_bus_loss = \"all\"";
    all_refused(&[(
        small("", "", broker),
        &["on_bus_loss = \"all\": write \"continue\" or \"hold_at_wait\""],
    )]);
    all_refused(&[(
        small("", "", "").replace("linear", "line"),
        &[
            "line 3",
            "kind = \"line\": write \"linear\", \"rotary\" or \"spindle\"",
        ],
    )]);
}

#[test]
fn a_number_that_is_a_key_is_written_in_one_way() {
    all_refused(&[
        (small("", "", "[m_code.012]"), &["[m_code.012]", "[m_code.12]"]),
        (small("", "", "[m_code.12]\n[m_code.012]"), &["[m_code.012]"]),
        (small("", "", "[m_code.\"+5\"]"), &["[m_code.+5]"]),
        (
            small("", "programs = { 21 = \"a.nc\", 021 = \"b.nc\" }", ""),
            &["programs", "021", "write 21"],
        ),
    ]);
}

#[test]
fn an_axis_stands_once_in_capital_letters() {
    let of = |axes: &str| {
        let two = COORDINATE_SYSTEMS.replacen("axes = { X = 1, Y = 2, Z = 3 }", axes, 1);
        let two = two.replace("G54 = { X = 10.0, Y = 20.0, Z = 30.0 }", "G54 = { X = 10.0 }");
        format!("{MOTORS}{two}")
    };
    all_refused(&[
        (of("axes = { X = 1, x = 2 }"), &["axes: x", "write X"]),
        (of("axes = { X = 1, Y = 1 }"), &["motor 1 already belongs"]),
    ]);
    let ran = check(&of("axes = { X = 1, Y = 2 }"));
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let note = "[[motor]] number = 3: no coordinate system has it";
    assert!(ran.stdout.contains(note), "{}", ran.stdout);
}

#[test]
fn d35_an_m_code_that_the_runtime_handles_itself_has_no_table() {
    for m in [0, 1, 2, 30, 98, 99] {
        all_refused(&[(
            small("", "", &format!("[m_code.{m}]\ntimeout_ms = 5")),
            &[&format!("[m_code.{m}]"), "has no effect"],
        )]);
    }
    assert_eq!(check(&small("", "", "[m_code.3]\n[m_code.19]")).code, 0);
}

#[test]
fn coordinate_systems_do_not_preload_different_files_under_one_number() {
    let config = format!(
        "{MOTORS}{}programs = {{ 7 = \"b.nc\" }}\n",
        COORDINATE_SYSTEMS.replacen("spindle = 4", "spindle = 4\nprograms = { 7 = \"a.nc\" }", 1)
    );
    all_refused(&[(config, &["number = 2", "programs: 7", "a.nc"])]);
}

#[test]
fn a_broker_is_embedded_or_a_host_with_a_port_and_carries_no_user() {
    for broker in [
        "mqtt://",
        "mqtt://:1883",
        "mqtt://h:99999",
        "mqtt://h:0",
        "mqtt://h:",
        "mqtt://h:1883/plant",
        "mqtt://a b",
        "mqtt://h:1:2",
        "mqtt://[::1",
        "http://h:1883",
    ] {
        all_refused(&[(
            small("", "", &format!("[mqtt]\nbroker = \"{broker}\"")),
            &["[mqtt] broker", broker],
        )]);
    }
    for broker in [
        "mqtt://h",
        "mqtt://h:1884",
        "mqtt://[::1]:1883",
        "mqtt://10.0.0.7",
    ] {
        let ran = check(&small("", "", &format!("[mqtt]\nbroker = \"{broker}\"")));
        assert_eq!(ran.code, 0, "{broker}: {}", ran.stderr);
    }
    let ran = check(&small("", "", "[mqtt]\nbroker = \"mqtt://anna:s3cret@h:1883\""));
    assert_eq!(ran.code, 2);
    assert!(
        ran.stderr.contains("username") && ran.stderr.contains("password_file"),
        "{}",
        ran.stderr
    );
    let shown = ran.stdout + &ran.stderr;
    assert!(!shown.contains("s3cret") && !shown.contains("anna"), "{shown}");
}

#[test]
fn a_key_of_mqtt_that_nothing_reads_is_refused() {
    all_refused(&[
        (
            small("", "", "[mqtt]\nusername = \"a\""),
            &["[mqtt] username", "embedded"],
        ),
        (
            small("", "", "[mqtt]\npassword_file = \"p\""),
            &["[mqtt]", "password_file", "embedded"],
        ),
        (
            small("", "", "[mqtt]\nbroker = \"mqtt://h\"\npassword_file = \"p\""),
            &["password_file", "username"],
        ),
        (
            small(
                "",
                "",
                "[mqtt]\nbroker = \"mqtt://h\"\nlisten = \"127.0.0.1:1883\"",
            ),
            &["[mqtt] listen", "embedded"],
        ),
        (
            small("", "", "[mqtt]\nca_file = \"ca.pem\""),
            &["[mqtt]", "ca_file", "mqtts"],
        ),
    ]);
}

/// Errors outside of values: addresses, and named files.
fn of_server_ends() -> Vec<(String, Vec<&'static str>)> {
    let mut cases = Vec::new();
    for end in ["http", "mqtt"] {
        for address in ["foo", "127.0.0.1:99999", "127.0.0.1", "0.0.0.0:0"] {
            let name = if end == "http" {
                "[http] listen"
            } else {
                "[mqtt] listen"
            };
            cases.push((format!("[{end}]\nlisten = \"{address}\""), vec![name, address]));
        }
    }
    for prefix in ["a/#", "+", "a//b", "a/", "/a", "/", "$SYS", "$share/a"] {
        let text = format!("[mqtt]\nprefix = \"{prefix}\"");
        cases.push((text, vec!["[mqtt] prefix", prefix]));
    }
    let same = "[http]\nlisten = \"127.0.0.1:1883\"\n[mqtt]\nlisten = \"127.0.0.1:1883\"";
    cases.push((same.to_owned(), vec!["[http] listen", "[mqtt] listen"]));
    let files = [
        (
            "[http]\ntoken_file = \"no.toml\"",
            vec!["[http] token_file", "no.toml"],
        ),
        ("[http]\ntoken_file = \"1.nc\"", vec!["[http] token_file", "1.nc"]),
        (
            "[mqtt]\nbroker = \"mqtt://h\"\nusername = \"a\"\npassword_file = \"no.txt\"",
            vec!["[mqtt] password_file", "no.txt"],
        ),
        (
            "[mqtt]\nbroker = \"mqtts://h\"\nca_file = \"no.pem\"",
            vec!["[mqtt] ca_file", "no.pem"],
        ),
        (
            "[mqtt]\nbroker = \"mqtts://h\"\nca_file = \"1.nc\"",
            vec!["[mqtt] ca_file", "1.nc", "no certificate"],
        ),
    ];
    cases.extend(files.map(|(text, words)| (text.to_owned(), words)));
    cases
}

fn server_ends(more: &str) -> Machine {
    let machine = Machine::with_config(&small("", "", more));
    machine.write("1.nc", "M30\n");
    machine
}

#[test]
fn check_refuses_what_serve_refuses_of_addresses_and_files() {
    let mut wrong = Vec::new();
    for (more, words) in of_server_ends() {
        let ran = run(server_ends(&more).folder(), &["check", "--config", "tandem.toml"]);
        let missing = words.iter().any(|word| !ran.stderr.contains(word));
        let twice = ran.stderr.matches("os error").count() > 1;
        if ran.code != 2 || missing || twice || !ran.stdout.is_empty() {
            wrong.push(format!(
                "{more}\n exit {}\n {}{}",
                ran.code, ran.stdout, ran.stderr
            ));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n----\n"));
}

#[test]
fn serve_refuses_with_the_words_of_check_before_anything_is_written() {
    let programs = ("programs".to_owned(), vec!["no.nc"]);
    let mut cases = of_server_ends();
    cases.truncate(4);
    cases.extend(
        of_server_ends()
            .into_iter()
            .filter(|(more, _)| more.contains("no.")),
    );
    let mut machines: Vec<_> = cases
        .into_iter()
        .map(|(more, words)| (server_ends(&more), words))
        .collect();
    let with_program = small("", "programs = { 1 = \"1.nc\", 7 = \"no.nc\" }", FREE_PORTS);
    machines.push((Machine::with_config(&with_program), programs.1));
    for (machine, words) in machines {
        let checked = run(machine.folder(), &["check", "--config", "tandem.toml"]);
        assert_eq!(checked.code, 2, "{words:?}");
        let arguments = ["serve", "--config", "tandem.toml"];
        let mut process = Process::start(tandem(), Path::new(machine.folder()), &arguments);
        let code = process.exit_code_within(Duration::from_secs(20));
        assert_eq!(code, Some(2), "{}", process.output);
        for word in words {
            assert!(process.output.contains(word), "{word} in {}", process.output);
        }
        assert_eq!(process.output, checked.stderr);
        assert!(!machine.path("tandem-data").exists(), "{}", process.output);
    }
}

#[test]
fn all_that_is_wrong_with_addresses_and_files_is_said_at_once() {
    let more = "[http]\nlisten = \"foo\"\n[mqtt]\nprefix = \"a/#\"";
    let ran = check(&small("", "programs = { 7 = \"no.nc\" }", more));
    for word in ["[http] listen", "[mqtt] prefix", "programs: 7", "tandem.toml"] {
        assert!(ran.stderr.contains(word), "{word} in {}", ran.stderr);
    }
}

#[test]
fn a_program_to_preload_is_a_file_that_can_be_read() {
    let machine = Machine::with_config(&small("", "programs = { 7 = \".\" }", ""));
    let ran = run(machine.folder(), &["check", "--config", "tandem.toml"]);
    assert_eq!(ran.code, 2, "{}", ran.stdout);
    assert!(ran.stderr.contains("programs: 7"), "{}", ran.stderr);
}

#[test]
fn config_check_with_json_format_prints_only_json() {
    let machine = Machine::new("");
    let arguments = ["check", "--config", "tandem.toml", "--format", "json"];
    let ran = run(machine.folder(), &arguments);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    assert_eq!(ran.json(), serde_json::json!({"files": []}));
}

#[test]
fn a_config_before_a_subcommand_is_refused() {
    let machine = Machine::new("");
    machine.write("1.nc", "M30\n");
    for command in ["check", "simulate", "compile"] {
        let ran = run(machine.folder(), &["--config", "nothing.toml", command, "1.nc"]);
        assert_eq!((ran.code, ran.stdout.as_str()), (2, ""), "{command}");
        assert!(
            ran.stderr.contains("--config") && ran.stderr.contains(command),
            "{}",
            ran.stderr
        );
    }
}

#[test]
fn tandem_token_tells_that_its_file_is_read_again_while_the_machine_runs() {
    let machine = Machine::new("");
    let arguments = ["token", "hmi-1", "--role", "view", "--file", "tokens.toml"];
    let ran = run(machine.folder(), &arguments);
    assert!(ran.stdout.contains("within 5 s"), "{}", ran.stdout);
}
