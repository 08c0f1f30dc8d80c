//! If checker and trial find nothing in a program, no alarm of interpreter or path stage that depends on its
//! text alone stops it. With the configuration of the machine, no alarm at all stops it. Tested with random
//! programs of both dialects, with the branches, loops, block skips and calls that the dialect has. Seeded;
//! `TANDEM_LONG` tests more programs.

#![allow(clippy::panic, clippy::unwrap_used, reason = "tests")]

#[allow(dead_code, reason = "shared with the tests of the checker")]
#[path = "../interp/tests/random/programs.rs"]
mod programs;
#[path = "../interp/tests/random/mod.rs"]
mod random;

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use plc_api::SequenceProgram;
use plc_protocol::types::machine::{AlarmRecord, AlarmSeverity};
use programs::Made;
use tandem_interp::{CheckContext, Inputs, Interpreter, NO_TOOLS};
use tandem_model::alarm::{COMPENSATION_REFUSED, STEP_LIMIT, VALUE_NOT_FINITE, VALUE_OUT_OF_RANGE};
use tandem_model::flow::{Compensation, Item};
use tandem_model::settings::{CoordinateSystemSettings, MotorKind, MotorSettings, Tool, WorkOffsets};
use tandem_model::variables::Variables;
use tandem_model::{AXES_MAX, Alarm, MachinePosition};
use tandem_path::PathStage;
use tandem_runtime::trial::{Trial, TrialResult};
use tandem_runtime::{Config, Machine};
use tandem_syntax::NcProgram;
use tandem_testing::Bench;

/// Number of generated programs without findings that are tested.
const CLEAN: u64 = 5000;

/// Number of programs without findings that run on a machine.
const CLEAN_ON_MACHINE: u64 = 50;

/// Time limit of a program on the machine, simulated seconds: enough for the longest program at F500.
const LONGEST_S: f64 = 300.0;

/// Number of items for which a program is run.
const ITEMS: usize = 3000;

/// Limits of the axes of a mill with dialect dgshape; many programs reach them.
const ENDS: [(&str, &str); 6] = [
    ("LIMITS_OF_X", "[-30.0, 30.0]"),
    ("LIMITS_OF_Y", "[-20.0, 30.0]"),
    ("LIMITS_OF_Z", "[-10.0, 20.0]"),
    ("REFERENCE_OF_X", "0.0"),
    ("REFERENCE_OF_Y", "0.0"),
    ("REFERENCE_OF_Z", "20.0"),
];

/// M codes of the mill.
const M_CODES: &str = r#"
[m_code.6]
stock = "select_tool"
[m_code.8]
unhandled = "auto_reset"
[m_code.100]
unhandled = "auto_reset"
[m_code.12]
unhandled = "auto_reset"
[m_code.13]
unhandled = "auto_reset"
timing = "after_motion"
"#;

fn wanted(clean: u64, of_long: u64) -> u64 {
    if std::env::var_os("TANDEM_LONG").is_some() {
        of_long
    } else {
        clean
    }
}

/// All axes, without limits.
fn settings(made: &Made) -> CoordinateSystemSettings {
    let motor = MotorSettings::new(1, MotorKind::Linear, 1e9, 1e9);
    CoordinateSystemSettings {
        motors: std::array::from_fn(|_| Some(motor.clone())),
        spindle: Some(MotorSettings::new(9, MotorKind::Spindle, 1e9, 1e9)),
        max_feedrate_mm_min: 1e9,
        path: made.dialect.path,
        ..CoordinateSystemSettings::default()
    }
}

/// Values for P and Q below 3 that differ from all other values of the programs.
const OTHERS: [f64; 5] = [0.25, 3.75, -7.5, 50.5, 1234.5];

/// Runs a program with `outside` as P3 to P9 and Q3 to Q9, and with `others` as the lower P and Q.
fn run(
    made: &Made,
    main: &Arc<NcProgram>,
    programs: &BTreeMap<u16, Arc<NcProgram>>,
    (outside, optional_skip): Outside,
    others: f64,
) -> Result<(), Alarm> {
    let variables = Variables::default();
    for index in 0..10 {
        let value = if index < 3 { others } else { outside };
        variables.global.set(index, value);
        variables.coordinate_system.set(index, value);
    }
    let settings = settings(made);
    let mut interpreter = Interpreter::new(&settings, made.dialect);
    let mut path = PathStage::new(&settings, MachinePosition::default());
    interpreter.start(Arc::clone(main), 0);
    let mut segments = Vec::new();
    for _ in 0..ITEMS {
        let item = interpreter.next(&Inputs {
            programs,
            optional_skip,
            work_offsets: &WorkOffsets::default(),
            variables: &variables,
            tool: Some(Tool::default()),
            tools: &NO_TOOLS,
            captured: Some([0.0; AXES_MAX]),
            position: Some(path.counts_from().0),
        })?;
        segments.clear();
        match item {
            Item::Block(block) => path.push(&block, &mut segments)?,
            Item::Output(output) if !output.has_params() => {}
            Item::Output(_) | Item::Stop(_) | Item::End(_)
                if path.is_compensating() || interpreter.modal().compensation != Compensation::Off =>
            {
                return Err(Alarm::new(&COMPENSATION_REFUSED, "rest in compensation"));
            }
            Item::End(_) => return path.finish(&mut segments),
            _ => path.flush(&mut segments),
        }
    }
    Ok(())
}

/// Generates programs until `wanted` of them have no findings, and calls `look` with each of these.
fn each_clean(
    wanted: u64,
    make: fn(u64) -> Made,
    trial: impl Fn(&Made, &Arc<NcProgram>, &BTreeMap<u16, Arc<NcProgram>>) -> Option<TrialResult>,
    look: impl Fn(&Made, &Arc<NcProgram>, &BTreeMap<u16, Arc<NcProgram>>),
) {
    let (mut clean, mut made, mut stopped) = (0, 0_u64, 0_u64);
    while clean < wanted {
        made += 1;
        let text = make(made.wrapping_mul(0xd134_2543_de82_ef95));
        let (program, programs) = text.trees();
        let Some(shown) = trial(&text, &program, &programs) else {
            continue;
        };
        if !shown.stops.is_empty() {
            stopped += 1;
            continue;
        }
        clean += 1;
        look(&text, &program, &programs);
    }
    eprintln!("{clean} clean of {made}, {stopped} stopped in the trial");
    assert!(stopped > 0);
}

/// Returns the result of the trial for a program in which the checker finds nothing.
fn tried(
    made: &Made,
    program: &Arc<NcProgram>,
    programs: &BTreeMap<u16, Arc<NcProgram>>,
    machine: Option<&Machine>,
) -> Option<TrialResult> {
    let system = machine.map(|machine| (machine, &machine.coordinate_systems[0]));
    let of_machine = system.map(|(_, system)| CheckContext::from_settings(&system.settings));
    let context = CheckContext {
        calculates: true,
        ..of_machine.unwrap_or_default()
    };
    let check = made.check(programs, context);
    let called = check.called.values().flat_map(|of| &of.diagnostics);
    let mut found = check.diagnostics.iter().chain(called);
    // W0002 is about the text as a whole, not about a run
    if found.any(|found| found.code != "W0002") {
        return None;
    }
    let trial = Trial {
        program,
        programs,
        dialect: made.dialect,
        machine: system,
    };
    Some(trial.run())
}

/// A value for variables from outside, and the block skip inputs.
type Outside = (f64, u32);

fn clean_programs_run_clean(clean: u64, make: fn(u64) -> Made, runs: &[Outside]) {
    let trial = |made: &Made, program: &Arc<NcProgram>, programs: &BTreeMap<u16, Arc<NcProgram>>| {
        tried(made, program, programs, None)
    };
    each_clean(clean, make, trial, |text, program, programs| {
        for outside in runs {
            let Err(alarm) = run(text, program, programs, *outside, 0.0) else {
                continue;
            };
            // the end of a loop is not checked; a value alarm depends on the text only if it occurs with all
            // values from outside
            let same = |others| {
                let again = run(text, program, programs, *outside, others);
                again.is_err_and(|again| again.entry == alarm.entry)
            };
            let is_value = [&VALUE_NOT_FINITE, &VALUE_OUT_OF_RANGE].contains(&alarm.entry);
            let from_outside = is_value && !OTHERS.into_iter().all(same);
            assert!(
                alarm.entry == &STEP_LIMIT || from_outside,
                "{outside:?} {alarm:?}\n{text}"
            );
        }
    });
}

#[test]
fn clean_check_and_trial_exclude_alarms_decided_by_the_text() {
    let runs = [(0.0, 0), (1.0, 0), (5.0, 0), (3.0, 7), (0.0, 7)];
    clean_programs_run_clean(wanted(CLEAN, 20 * CLEAN), Made::nj, &runs);
}

#[test]
fn dgshape_clean_check_and_trial_exclude_alarms_decided_by_the_text() {
    clean_programs_run_clean(wanted(CLEAN / 5, CLEAN), Made::dgshape, &[(0.0, 0), (0.0, 1)]);
}

/// Returns a sequence program that resumes after M00.
fn operator() -> SequenceProgram {
    SequenceProgram::new().task(|plc| async move {
        loop {
            plc.sleep(Duration::from_secs(1)).await;
            let _ = plc.coordinate_system(1).resume().await;
        }
    })
}

/// Returns the mill for programs of a dialect.
fn mill(dialect: &str) -> Machine {
    let base = include_str!("mill.toml").to_owned() + M_CODES;
    let fill = |text: String, (mark, value)| text.replace(mark, value);
    let text = ENDS.into_iter().fold(base, fill);
    let text = text.replace("dialect = \"dgshape\"", &format!("dialect = \"{dialect}\""));
    Config::from_toml(&text, "").unwrap().resolve().unwrap()
}

fn clean_programs_meet_no_alarm_on_the_mill(clean: u64, make: fn(u64) -> Made, dialect: &str) {
    let known = mill(dialect);
    let trial = |made: &Made, program: &Arc<NcProgram>, programs: &BTreeMap<u16, Arc<NcProgram>>| {
        tried(made, program, programs, Some(&known))
    };
    each_clean(clean, make, trial, |made, _, _| {
        let bench = Bench::on_machine(mill(dialect))
            .serve(operator())
            .max_time_s(LONGEST_S);
        let bench = made.called.iter().fold(bench, |bench, (number, text)| {
            bench.subprogram(*number, text.as_str())
        });
        let run = bench
            .run(made.main.as_str())
            .unwrap_or_else(|why| panic!("{why}\n{made}"));
        // a feedrate may be too low to reach the end within the limit, and the end of a loop is not checked
        let of_text =
            |alarm: &AlarmRecord| alarm.severity == AlarmSeverity::Alarm && alarm.number != STEP_LIMIT.number;
        assert!(!run.alarms.iter().any(of_text), "{:?}\n{made}", run.alarms);
    });
}

#[test]
fn what_is_clean_with_the_configuration_meets_no_alarm_on_the_machine() {
    let wanted = wanted(CLEAN_ON_MACHINE, CLEAN);
    clean_programs_meet_no_alarm_on_the_mill(wanted, Made::nj, "nj");
}

#[test]
fn dgshape_program_clean_with_configuration_meets_no_machine_alarm() {
    let wanted = wanted(CLEAN_ON_MACHINE, CLEAN);
    clean_programs_meet_no_alarm_on_the_mill(wanted, Made::dgshape, "dgshape");
}
