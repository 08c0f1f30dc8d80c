//! A sequence program as a PLC scan, every 10 ms: `cargo run --example 08_scan_cycle`
//! M20 VA runs a conveyor for VA mm, 2 mm per scan. M21 waits for a part at its end, counts it in P200, and raises an
//! alarm if none comes within 8 s. M codes are flags with parameters, resets are written as flags, delays are timers.

#![allow(clippy::print_stdout, reason = "an example shows what it does")]

use plc_api::function_blocks::OnDelay;
use plc_api::{Alarm, SequenceProgram, scan::Image, scan::Reads, scan::ScanProgram};
use std::time::Duration;
use tandem_testing::{Bench, TestError};

const PERIOD: Duration = Duration::from_millis(10);
const STEP_MM: f64 = 2.0;

/// Values that a PLC keeps from scan to scan. `belt_mm` replaces the encoder, `part` the light barrier.
struct Conveyor {
    belt_mm: f64,
    moved_mm: f64,
    part_after_mm: f64,
    too_long: OnDelay,
}

impl ScanProgram for Conveyor {
    fn reads(&self) -> Reads {
        Reads::default().p(200, 1)
    }

    fn scan(&mut self, image: &mut Image) {
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
        self.belt_mm += STEP_MM;
        self.moved_mm += STEP_MM;
        image.progress(1, 20, "the belt runs", 100.0 * self.moved_mm / way_mm);
        if self.moved_mm >= way_mm {
            image.reset(1, 20);
        }
    }

    fn wait_for_part(&mut self, image: &mut Image) {
        let waits = image.is_on(1, 21);
        if self.too_long.update(waits, image.now()) {
            image.fail(1, 21, Alarm::user(21, "no part at the end of the conveyor"));
        } else if waits && self.belt_mm >= self.part_after_mm {
            image.set_p(200, image.p(200).unwrap_or(0.0) + 1.0);
            image.reset(1, 21);
        }
    }
}

fn machine(part_after_mm: f64) -> Bench {
    let conveyor = Conveyor {
        belt_mm: 0.0,
        moved_mm: 0.0,
        part_after_mm,
        too_long: OnDelay::new(Duration::from_secs(8)),
    };
    Bench::new().serve(SequenceProgram::new().scan([20, 21], PERIOD, conveyor))
}

fn main() -> Result<(), TestError> {
    let program = "M20 VA300\nM21\nG01 X10 F3000\nM30\n";
    println!(
        "part there: {:?}",
        machine(250.0).run(program)?.completed()?.order(1)
    );
    let run = machine(900.0).run(program)?;
    println!("{} after {:.2} s", run.alarm()?.text, run.time_s);
    Ok(())
}
