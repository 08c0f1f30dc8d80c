//! What users add, through the public API only: a handler, a transport, a G code in a dialect of their own.

mod g_code;
mod handler;
mod transport;
