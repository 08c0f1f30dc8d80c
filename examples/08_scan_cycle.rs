//! A sequence program as a PLC scan, every 10 ms: `cargo run --example 08_scan_cycle`
//!
//! M20 VA runs a conveyor for VA mm; M21 waits for a part at its end and is an alarm when none comes within 8 seconds.
//! M codes are flags with parameters, resets are written as flags, and what takes time is a state of the program. P200
//! counts the parts, and while the hood is open the interlock holds the machine.

#![allow(clippy::print_stdout, reason = "an example shows what it does")]

use std::time::Duration;

use plc_api::scan::{Image, Reads, ScanProgram};
use plc_api::types::command::Command;
use plc_api::{Alarm, Execution, SequenceProgram};
use tandem_runtime::test::{Bench, TestError};

const PERIOD: Duration = Duration::from_millis(10);
const BELT_MM_PER_S: f64 = 200.0;
const PART_PATIENCE_S: f64 = 8.0;

/// P variable that counts the parts.
const PARTS: u32 = 200;

/// The hood is open from 0.5 s to 1.5 s.
const HOOD_OPEN_S: std::ops::Range<f64> = 0.5..1.5;

/// What a PLC keeps from scan to scan. `belt_mm` stands for the encoder, `part` for the light barrier.
#[derive(Default)]
struct Conveyor {
    belt_mm: f64,
    moved_mm: f64,
    part_after_mm: f64,
    waiting_since_s: Option<f64>,
}

impl ScanProgram for Conveyor {
    fn reads(&self) -> Reads {
        Reads::default().p(PARTS, 1)
    }

    fn scan(&mut self, image: &mut Image) {
        let is_open = HOOD_OPEN_S.contains(&image.time_s());
        image.set_interlock(1, is_open, "the hood is open");
        if is_open {
            return;
        }
        let is_interrupted = image.execution(1) == Execution::Interrupted;
        if is_interrupted && image.interlock(1).is_some_and(|lock| !lock.value) {
            image.command(1, Command::Resume);
        }
        self.run_belt(image);
        self.wait_for_part(image);
    }
}

impl Conveyor {
    fn run_belt(&mut self, image: &mut Image) {
        let Some(way_mm) = image.params(1, 20).map(|params| params.a().unwrap_or(100.0)) else {
            self.moved_mm = 0.0;
            return;
        };
        let step_mm = BELT_MM_PER_S * PERIOD.as_secs_f64();
        self.belt_mm += step_mm;
        self.moved_mm += step_mm;
        image.progress(1, 20, "the belt runs", 100.0 * self.moved_mm / way_mm);
        if self.moved_mm >= way_mm {
            image.reset(1, 20);
        }
    }

    fn wait_for_part(&mut self, image: &mut Image) {
        if !image.is_on(1, 21) {
            self.waiting_since_s = None;
            return;
        }
        let since_s = *self.waiting_since_s.get_or_insert(image.time_s());
        if self.belt_mm >= self.part_after_mm {
            let parts = image.p(PARTS).unwrap_or(0.0);
            image.set_p(PARTS, parts + 1.0);
            image.reset(1, 21);
        } else if image.time_s() - since_s >= PART_PATIENCE_S {
            image.fail(1, 21, Alarm::user(21, "no part at the end of the conveyor"));
        }
    }
}

fn machine(part_after_mm: f64) -> Bench {
    let conveyor = Conveyor {
        part_after_mm,
        ..Conveyor::default()
    };
    Bench::new().serve(SequenceProgram::new().scan([20, 21], PERIOD, conveyor))
}

fn main() -> Result<(), TestError> {
    let program = "M20 VA300\nM21\nG01 X10 F3000\nM30\n";
    let run = machine(250.0).run(program)?.completed()?;
    println!("part there: {:?}", run.order(1));
    let run = machine(900.0).run(program)?;
    println!("{} after {:.2} s", run.alarm()?.text, run.time_s);
    Ok(())
}
