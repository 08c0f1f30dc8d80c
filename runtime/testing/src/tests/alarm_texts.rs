//! Tests that alarms contain the texts of the machine builder.

use plc_api::UserAlarm;
use plc_protocol::types::machine::AlarmRecord;
use plc_protocol::types::request::typed;

use super::*;

const DEMO: &str = include_str!("../../../../examples/config/demo.toml");

const NO_AIR: UserAlarm = UserAlarm::new(12, "the air pressure is low")
    .remedy("Open the main valve.")
    .in_language("de", "der Luftdruck ist zu niedrig", "Hauptventil öffnen.");

/// Returns the alarm of M20 on the demo machine with these tables in the configuration, and its explanation.
fn raise_and_explain(tables: &str) -> (AlarmRecord, String) {
    let program = SequenceProgram::new()
        .on(20, async |_output: AuxOutput| Err(NO_AIR.with("2.1 bar")))
        .alarms([NO_AIR]);
    let mut config = Config::demo();
    config.alarm = Config::from_toml(&format!("{DEMO}{tables}"), "").unwrap().alarm;
    let machine = config.resolve().unwrap();
    Bench::on_machine(machine)
        .serve(program)
        .subprogram(99, "M20\nM30")
        .play(async |scene, _runtime| {
            scene.cs(1).load(99).await.unwrap();
            scene.cs(1).start().await.unwrap();
            scene.cs(1).wait_until(Execution::Stopped).await.unwrap();
            let record = scene.plc().alarms().await.unwrap().remove(0);
            let explain = typed::Explain(format!("alarm {}", record.number));
            let explained = scene.plc().port().ask(explain).await.unwrap();
            (record, explained.text)
        })
        .unwrap()
}

#[test]
fn an_alarm_has_the_remedy_and_the_languages_that_its_handler_says() {
    let (alarm, explained) = raise_and_explain("");
    assert_eq!(alarm.number, 10_012);
    assert_eq!(alarm.text, "the air pressure is low: 2.1 bar");
    assert_eq!(alarm.remedy.as_deref(), Some("Open the main valve."));
    let german = &alarm.languages["de"];
    assert_eq!(german.text, "der Luftdruck ist zu niedrig");
    assert_eq!(german.remedy.as_deref(), Some("Hauptventil öffnen."));
    for part in [
        "alarm 10012: the air pressure is low",
        "Open the main valve.",
        "de: der Luftdruck",
    ] {
        assert!(explained.contains(part), "{part}: {explained}");
    }
}

#[test]
fn what_the_configuration_says_of_an_alarm_counts_first() {
    let (alarm, explained) =
        raise_and_explain("\n[alarm.12]\ntext = \"no air\"\nremedy = \"Call the fitter.\"\n");
    assert_eq!(alarm.text, "the air pressure is low: 2.1 bar");
    assert_eq!(alarm.remedy.as_deref(), Some("Call the fitter."));
    assert!(alarm.languages.is_empty());
    assert!(explained.starts_with("alarm 10012: no air\n"), "{explained}");
}

#[test]
fn a_table_of_alarms_that_is_wrong_says_where_and_what_to_write() {
    for (table, says) in [
        ("[alarm.x]\ntext = \"a\"", "0 to 9999"),
        ("[alarm.10000]\ntext = \"a\"", "0 to 9999"),
        ("[alarm.1]\nremedy = \"a\"", "1 to 1000 characters"),
        (
            "[alarm.1]\ntext = \"a\"\nlanguage.d = { text = \"b\" }",
            "a tag such as `de`",
        ),
    ] {
        let config = Config::from_toml(&format!("{DEMO}\n{table}\n"), "");
        let error = config
            .and_then(|config| config.resolve().map(|_| ()))
            .unwrap_err()
            .to_string();
        assert!(error.contains(says) && error.contains("[alarm."), "{error}");
    }
}
