//! Embeds the HMI again when a file of `web/` or a picture is added, removed or changed.
#![allow(clippy::print_stdout, reason = "this is how a build script talks to cargo")]

fn main() {
    println!("cargo:rerun-if-changed=web");
    println!("cargo:rerun-if-changed=pictures");
}
