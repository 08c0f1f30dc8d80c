//! Fixed cycles: one block becomes many items.

mod tapping;

pub(crate) use tapping::{Step, Tapping, outputs, tapping};
