//! A program without findings does not stop with an alarm that depends only on its text. The test uses random
//! programs of both dialects, with branches, loops, block skip and calls where the dialect has them. The
//! programs are seeded; `TANDEM_LONG` runs more programs.

#[path = "random/programs.rs"]
mod programs;
mod properties;
mod random;

use std::collections::BTreeMap;
use std::sync::Arc;

use programs::Made;
use properties::{few_variables, run_with};
use tandem_interp::CheckContext;
use tandem_model::alarm::STEP_LIMIT;
use tandem_model::{Alarm, Severity};
use tandem_syntax::NcProgram;

/// Least number of generated programs that must be without findings.
const CLEAN: u64 = 5000;

/// Maximum number of items for which a program is run.
const ITEMS: usize = 3000;

fn is_long() -> bool {
    std::env::var_os("TANDEM_LONG").is_some()
}

/// Value that other writers set in P3 to P9 and Q3 to Q9, and the block skip inputs.
type Outside = (f64, u32);

fn run(
    made: &Made,
    main: &Arc<NcProgram>,
    programs: &BTreeMap<u16, Arc<NcProgram>>,
    (value, optional_skip): Outside,
) -> Result<(), Alarm> {
    let variables = few_variables();
    for index in 3..10 {
        variables.global.set(index, value);
        variables.coordinate_system.set(index, value);
    }
    run_with(main, programs, &variables, optional_skip, made.dialect, ITEMS)
}

fn clean_programs_run_clean(wanted: u64, make: fn(u64) -> Made, runs: &[Outside]) {
    let (mut clean, mut wrong, mut made, mut alarms) = (0, 0, 0_u64, 0_u64);
    while clean < wanted {
        made += 1;
        let text = make(made.wrapping_mul(0x9e37_79b9_7f4a_7c15));
        let (main, programs) = text.trees();
        let check = text.check(&programs, CheckContext::default());
        let called = check.called.values().flat_map(|of| &of.diagnostics);
        let found: Vec<_> = check.diagnostics.iter().chain(called).collect();
        // findings that concern the whole text do not concern a run
        let is_clean = found.iter().all(|found| found.code == "W0002");
        let is_wrong = found.iter().any(|found| found.severity == Severity::Error);
        wrong += u64::from(is_wrong);
        clean += u64::from(is_clean);
        for outside in runs {
            let Err(alarm) = run(&text, &main, &programs, *outside) else {
                continue;
            };
            alarms += 1;
            // whether a loop ends cannot be decided, and the text does not determine values from outside
            let from_outside = text.contains("Q1");
            let decided =
                alarm.entry != &STEP_LIMIT && !(from_outside && matches!(alarm.entry.number, 10 | 11));
            assert!(!(is_clean && decided), "{outside:?} {alarm:?}\n{text}");
        }
    }
    // neither all programs nor no programs are without findings
    assert!(
        wrong > wanted / 10 && alarms > wanted / 10,
        "{wrong} wrong, {alarms} alarms of {made}"
    );
    eprintln!("{clean} clean of {made}, {wrong} with errors, {alarms} alarms");
}

#[test]
fn what_the_checker_calls_clean_stops_by_no_alarm_that_its_text_decides() {
    let runs = [(0.0, 0), (1.0, 0), (5.0, 1), (2.5, 7), (0.0, 2)];
    let wanted = if is_long() { 20 * CLEAN } else { CLEAN };
    clean_programs_run_clean(wanted, Made::nj, &runs);
}

#[test]
fn dgshape_program_checked_clean_raises_no_alarm_decided_by_its_text() {
    let wanted = if is_long() { CLEAN } else { CLEAN / 5 };
    clean_programs_run_clean(wanted, Made::dgshape, &[(0.0, 0), (0.0, 1)]);
}
