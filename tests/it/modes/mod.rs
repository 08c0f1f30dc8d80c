//! How a coordinate system is operated: single block, interlock, manual data input, jog, homing, hold and stop.

mod back_trace;
mod holding;
mod inputs;
mod jog;
mod manual;
mod outputs;
mod planned;
mod replanning;
mod rig;
mod single_block;
mod stairs;
mod within;
