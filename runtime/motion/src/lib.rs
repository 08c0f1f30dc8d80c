//! Path segments to motion profiles: ramps, limits, look-ahead.

mod planner;

pub use planner::Planner;
