//! The row of a request that arrived without a route or topic, such as in a WebSocket frame.

use super::requests::ROWS;
use super::row::{ParsedRequest, Row};
use crate::types::request::Request;

/// Adds the right of its row to a request that arrived without a route or topic. Returns `None` if the
/// request has no row.
pub(super) fn parsed(request: Request) -> Option<ParsedRequest> {
    row_of(&request).map(|row| row.parsed(request))
}

fn row_of(request: &Request) -> Option<&'static Row> {
    let mut sought = request.clone();
    for row in &ROWS {
        match (row.write)(sought) {
            Ok(_) => return Some(row),
            Err(other) => sought = other,
        }
    }
    None
}

/// Returns true for a request that may carry an age limit, because it can cause a motion.
pub fn takes_not_after(request: &Request) -> bool {
    row_of(request).is_some_and(|row| row.takes_not_after)
}
