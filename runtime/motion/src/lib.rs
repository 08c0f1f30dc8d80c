//! Path segments to motion profiles: ramps, limits, look-ahead.
