//! How a coordinate system is operated: single block, interlock, manual data input, jog, homing, hold and stop.

mod back_trace;
mod holding;
mod inputs;
mod jog;
mod macros;
mod manual;
mod ordered_run;
mod outputs;
mod plan_identity;
mod planned;
mod replanning;
mod rig;
mod single_block;
mod spindle_speed;
mod stairs;
mod within;
