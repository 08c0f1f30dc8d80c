//! Motion profiles to setpoints: servo cycle, simulated drives, in-position check.
