//! NC programs run by the rules: times and positions from formulas, order of M codes, location of alarms.

mod alarms;
mod chains;
mod codes;
mod compensation;
mod linear;
mod look_ahead;
mod m_codes;
mod positions;
mod program_flow;
mod rapid;
mod skip;
mod spindle;
mod tables;
mod tapping;
