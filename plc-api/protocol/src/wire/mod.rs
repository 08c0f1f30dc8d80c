//! Tables of the wire formats: every request to the machine with its routes and topics. The same rows write
//! and read a request.
//!
//! A [`Row`](row::Row) is one request: its right, its routes and topics, its content, and the functions that
//! read and write it. Client transports write with [`rest::encode`], [`mqtt::encode`] and
//! [`websocket::encode`]. Server ends read with the row of their route, with [`mqtt::decode`] and with
//! [`ClientFrame::requests`](websocket::ClientFrame::requests). The module is pure: no sockets, no async.

mod age_limit;
pub mod answer;
mod find_row;
pub mod hmi;
mod io;
mod json;
mod lease_rows;
pub mod login;
pub mod machines;
pub mod message_sender;
pub mod mqtt;
pub mod parameter;
pub mod path_parameter;
mod pattern;
mod payloads;
pub mod problem;
mod program_rows;
mod requests;
pub mod rest;
pub mod right;
pub mod route;
pub mod row;
mod row_macros;
pub mod states;
pub mod subject;
pub mod tag;
pub mod topic_level;
mod trace;
pub mod websocket;

pub use find_row::takes_not_after;
pub use json::json_object;
pub use pattern::percent_encoded;
pub use requests::ROWS;

/// Largest content of one message of a client, bytes, on every transport: an MQTT payload, a JSON body over
/// REST, or a frame of the WebSocket. A larger message is refused. Reason: the largest message of a correct
/// client, with 1024 variables or a fault text, is much smaller.
pub const PAYLOAD_MAX: usize = 64 * 1024;

#[cfg(test)]
mod tests;
