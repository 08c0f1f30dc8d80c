//! Runs by hand: manual data input, homing and jogs.

pub(super) mod cut_short;
pub(super) mod jog;
pub(super) mod manual_input;
