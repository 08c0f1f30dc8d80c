//! NC programs run as the rules say: times and positions from formulas, M codes in their order, alarms in their place.

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
