//! Tests of the whole product: the `tandem` command as a process, the machine over its port, over MQTT and over REST.
//!
//! Each test is named after the rule that it proves. Expected values come from the manuals' rules and from formulas.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "this crate is tests and nothing else"
)]
#![allow(clippy::float_cmp, reason = "a motion ends at its end point exactly")]

mod support;

mod book;
mod cli_check;
mod cli_check_trial;
mod cli_compile;
mod cli_config;
mod cli_diff;
mod cli_findings;
mod cli_fleet;
mod cli_fmt;
mod cli_limits;
mod cli_lsp;
mod cli_output;
mod cli_plot;
mod cli_served;
mod cli_simulate;
mod cli_simulate_tables;
mod clients;
mod conformance;
mod convert;
mod damage;
mod dgshape;
mod examples;
mod extension;
mod faults;
mod init;
mod modes;
#[rustfmt::skip]
mod readme;
mod serve;
mod structured_text;
mod tidy;
mod transports;
