//! Times of the whole runtime as a user experiences them, measured in real time. Run it on a quiet machine:
//!
//! ```text
//! cargo bench -p tandem-runtime --bench runtime              all, about 3 min
//! cargo bench -p tandem-runtime --bench runtime -- m_code    one of: m_code many servo rest subscribers program simulated
//!                                                            ten_minutes
//! ```
//!
//! The doc comment of each part describes the measurement, its results and the computer.

mod http;
mod m_code;
mod machine;
mod many;
mod mosquitto;
mod program;
mod rest;
mod servo;
mod simulated;
mod subscribers;
mod table;
mod ten_minutes;

use machine::in_real_time;

fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    // `cargo test --all-targets` runs benches too, without this flag
    if !arguments.iter().any(|argument| argument == "--bench") {
        return Ok(());
    }
    let wanted: Vec<&String> = arguments
        .iter()
        .filter(|argument| !argument.starts_with('-'))
        .collect();
    let is_wanted = |part: &str| wanted.is_empty() || wanted.iter().any(|name| part.contains(name.as_str()));
    if is_wanted("m_code") {
        in_real_time(m_code::run())?;
    }
    if is_wanted("many") {
        in_real_time(many::run())?;
    }
    if is_wanted("servo") {
        in_real_time(servo::run())?;
    }
    if is_wanted("rest") {
        in_real_time(rest::run())?;
    }
    if is_wanted("subscribers") {
        in_real_time(subscribers::run())?;
    }
    if is_wanted("program") {
        in_real_time(program::run())?;
    }
    if is_wanted("simulated") {
        simulated::run()?;
    }
    if is_wanted("ten_minutes") {
        ten_minutes::run()?;
    }
    Ok(())
}
