//! Embeds the HMI anew when a file of `web/` or a picture comes, goes or changes.
#![allow(clippy::print_stdout, reason = "this is how a build script talks to cargo")]

fn main() {
    println!("cargo:rerun-if-changed=web");
    println!("cargo:rerun-if-changed=pictures");
}
