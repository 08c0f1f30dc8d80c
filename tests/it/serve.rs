//! `tandem serve` as a process: start, life of a program over every server end, refusals, end.

mod access;
mod audit;
mod conditions;
mod coordinate_systems;
mod data_folder;
mod dialects;
mod disk;
mod identity;
mod kept;
mod late;
mod life;
mod locks;
mod lost_values;
mod memory;
mod modes;
mod orders;
mod outputs;
mod plans;
mod positions;
mod programs;
mod reach;
mod start;
mod unread;
mod urgent;
mod viewers;

use crate::support::machine::Machine;
use crate::support::served::{FREE_PORTS, Served};

/// M100 waits until a client resets it; M20 is issued with the motion.
const M_CODES: &str = r#"
[m_code.100]
unhandled = "wait"
wait_state = "TOOL_LOAD"

[m_code.20]
unhandled = "wait"
timing = "with_motion"
"#;

fn machine() -> Machine {
    Machine::new(&format!("{M_CODES}{FREE_PORTS}"))
}

fn served() -> (Machine, Served) {
    served_with("")
}

/// Returns the machine with `more` in its configuration.
fn served_with(more: &str) -> (Machine, Served) {
    let machine = Machine::new(&format!("{M_CODES}{FREE_PORTS}{more}"));
    let served = Served::start(&machine);
    (machine, served)
}
