//! `tandem fleet`: many machines at one broker, each with a handler and an HMI.

use std::time::{Duration, Instant};

use crate::support::binary::tandem;
use crate::support::broker::Mosquitto;
use crate::support::simulated::run;

/// Returns the number after a name in the report.
fn number(report: &str, name: &str) -> f64 {
    let line = report.lines().find_map(|line| line.trim().strip_prefix(name));
    let line = line.unwrap_or_else(|| panic!("no {name} in:\n{report}"));
    let word = line.split_whitespace().next().unwrap_or_default();
    word.trim_end_matches(',')
        .parse()
        .unwrap_or_else(|_| panic!("{name}{line}"))
}

#[test]
fn machines_of_a_fleet_run_their_m_codes_at_one_broker_and_are_measured() {
    let broker = Mosquitto::start();
    let address = format!("mqtt://{}", broker.address());
    let folder = tempfile::tempdir().unwrap();
    let arguments = [
        "fleet",
        "--machines",
        "3",
        "--broker",
        &address,
        "--m-codes-per-minute",
        "60",
        "--seconds",
        "3",
    ];
    let ran = run(folder.path(), &arguments);
    assert_eq!(ran.code, 0, "{}{}", ran.stdout, ran.stderr);
    let of = |name| number(&ran.stdout, name);
    assert_eq!(of("machines "), 3.0);
    assert_eq!(of("machines that do not run"), 0.0);
    assert_eq!(of("handlers that were lost"), 0.0);
    // one a second each, for three seconds; those at both ends may be outside
    let m_codes = of("M codes");
    assert!(
        (3.0..=12.0).contains(&m_codes),
        "{m_codes} M codes:\n{}",
        ran.stdout
    );
    assert!(of("messages that HMIs read") > 0.0);
}

#[test]
fn a_fleet_without_its_broker_says_so() {
    let folder = tempfile::tempdir().unwrap();
    // builds the command, which must not count
    tandem();
    let begun = Instant::now();
    let ran = run(
        folder.path(),
        &[
            "fleet",
            "--machines",
            "1",
            "--broker",
            "mqtt://127.0.0.1:1",
            "--seconds",
            "1",
        ],
    );
    assert_eq!(ran.code, 2, "{}", ran.stdout);
    for part in ["mqtt://127.0.0.1:1", "refused the connection", "--broker"] {
        assert!(ran.stderr.contains(part), "{}", ran.stderr);
    }
    // the connection is tried again for 5 s, and a busy computer needs some time for the start
    assert!(begun.elapsed() < Duration::from_secs(20), "{:?}", begun.elapsed());
}
