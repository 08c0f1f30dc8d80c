//! What the checker and a trial call clean is stopped by no alarm of interpreter or path stage that its text alone decides:
//! on random programs with branches, loops, block skip and calls. Seeded; `TANDEM_LONG` takes more programs.

#[path = "../interp/tests/random/programs.rs"]
mod programs;
#[path = "../interp/tests/random/mod.rs"]
mod random;

use std::collections::BTreeMap;
use std::sync::Arc;

use programs::Made;
use tandem_interp::dialects::nj;
use tandem_interp::{Inputs, Interpreter, NO_TOOLS};
use tandem_model::alarm::{COMPENSATION_REFUSED, STEP_LIMIT, VALUE_NOT_FINITE, VALUE_OUT_OF_RANGE};
use tandem_model::flow::{Compensation, Item};
use tandem_model::settings::{CoordinateSystemSettings, MotorKind, MotorSettings, Tool, WorkOffsets};
use tandem_model::variables::Variables;
use tandem_model::{AXES_MAX, Alarm, MachinePosition};
use tandem_path::PathStage;
use tandem_runtime::trial::Trial;
use tandem_syntax::NcProgram;

/// Programs that must be clean, of those that are made.
const CLEAN: u64 = 5000;

/// Items that a program is run for.
const ITEMS: usize = 3000;

/// All axes, without limits.
fn settings() -> CoordinateSystemSettings {
    let motor = MotorSettings::new(1, MotorKind::Linear, 1e9, 1e9);
    CoordinateSystemSettings {
        motors: std::array::from_fn(|_| Some(motor.clone())),
        spindle: Some(MotorSettings::new(9, MotorKind::Spindle, 1e9, 1e9)),
        max_feedrate_mm_min: 1e9,
        ..CoordinateSystemSettings::default()
    }
}

/// Runs a program with P3 to P9 and Q3 to Q9 from outside.
fn run(
    main: &Arc<NcProgram>,
    programs: &BTreeMap<u16, Arc<NcProgram>>,
    outside: f64,
    optional_skip: u32,
) -> Result<(), Alarm> {
    let variables = Variables::default();
    for index in 3..10 {
        variables.global.set(index, outside);
        variables.coordinate_system.set(index, outside);
    }
    let settings = settings();
    let mut interpreter = Interpreter::new(&settings, nj());
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

#[test]
fn what_check_and_trial_call_clean_is_stopped_by_no_alarm_that_its_text_decides() {
    let wanted = if std::env::var_os("TANDEM_LONG").is_some() {
        20 * CLEAN
    } else {
        CLEAN
    };
    let (mut clean, mut made, mut stopped) = (0, 0_u64, 0_u64);
    while clean < wanted {
        made += 1;
        let text = Made::new(made.wrapping_mul(0xd134_2543_de82_ef95));
        let (program, programs) = text.trees();
        let check = text.check(&programs);
        let mut found = check
            .diagnostics
            .iter()
            .chain(check.called.values().flat_map(|of| &of.diagnostics));
        // what is told of the whole text says nothing about a run
        if found.any(|found| found.code != "W0002") {
            continue;
        }
        let trial = Trial {
            program: &program,
            programs: &programs,
            dialect: nj(),
            machine: None,
        };
        if trial.run().stop.is_some() {
            stopped += 1;
            continue;
        }
        clean += 1;
        for (outside, skip) in [(0.0, 0), (1.0, 0), (5.0, 0), (3.0, 7), (0.0, 7)] {
            let Err(alarm) = run(&program, &programs, outside, skip) else {
                continue;
            };
            // whether a loop ends is not decided, and values from outside are not the text's
            let from_outside = text.contains("Q1");
            let of_value = [&VALUE_NOT_FINITE, &VALUE_OUT_OF_RANGE].contains(&alarm.entry);
            assert!(
                alarm.entry == &STEP_LIMIT || from_outside && of_value,
                "{outside} {skip} {alarm:?}\n{text}"
            );
        }
    }
    eprintln!("{clean} clean of {made}, {stopped} stopped in the trial");
    assert!(stopped > 0);
}
