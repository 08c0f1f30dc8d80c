//! The protocol between the Tandem runtime and its clients: all messages and requests, their forms on each
//! transport, and the rules of the handshake.
//!
//! Runtimes, transports and clients without handlers depend on this crate. Sequence programs depend on
//! `plc-api`, which re-exports by name the types that their handlers use.
//!
//! | module | contents |
//! | --- | --- |
//! | [`port`] | the whole interface as one trait, which the runtime and each client transport implement |
//! | [`types`] | messages and requests |
//! | [`wire`] | a row for each request and state: its right, routes, topic and schemas |
//! | [`handshake`] | the state machine of outputs and resets, for all transports |
//! | [`handler_registry`] | the handlers that are online |
//! | [`execution`] | the commands that are allowed in each state |
//! | [`io_points`], [`lock_input`] | inputs and outputs of the plant, and levels that hold the machine |
//! | [`hub`], [`queue`] | distribution of messages to slow and fast readers |
//! | [`server`], [`supervisor`] | what a server end needs from the machine, and its tasks after a fault |
//! | [`transport`] | client ends |
//! | [`fake`] | a scripted machine for tests |
//!
//! A number such as D16 names a decision on how the runtime interprets the NC language; a number such as H4
//! names a rule of the [handshake](handshake::rules).
//!
//! # Compatibility
//! A release without a new major version (before 1.0: without a new minor version) may add variants to
//! enumerations that are `#[non_exhaustive]`, and members to messages (the structs of [`types`]). Read
//! members by their names, end a pattern with `..`, and create a message by its constructor or from its
//! `Default`.
//!
//! Features: `mqtt` is the MQTT client, with TLS; `rest` is the client for REST and WebSocket; `schema`
//! derives JSON Schemas of the types. Without these features the crate has few dependencies except tokio and
//! serde.

pub mod alarm;
pub mod error;
pub mod execution;
pub mod fake;
pub mod handler_registry;
pub mod handshake;
pub mod hub;
pub mod io_points;
pub mod lock;
pub mod lock_input;
pub mod names;
pub mod port;
pub mod queue;
pub mod server;
pub mod supervisor;
mod text;
pub mod transport;
pub mod types;
pub mod wire;
