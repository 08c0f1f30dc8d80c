//! Runs: their state, programs, preparation and interruption.

pub(super) mod active_run;
pub(super) mod causes;
pub(super) mod conditions;
pub(super) mod holding;
pub(super) mod line_entry;
pub(crate) mod line_search;
pub(super) mod notes;
pub(super) mod parts;
pub(super) mod pipeline;
pub(super) mod preparation;
pub(super) mod programs;
pub(super) mod replanning;
pub(super) mod run_state;
