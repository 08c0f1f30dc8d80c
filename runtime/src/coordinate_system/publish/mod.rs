//! Published data of a coordinate system.

pub(super) mod published_values;
pub(super) mod rest;
pub(super) mod view;
