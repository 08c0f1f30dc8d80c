//! Rules of the source that no compiler checks. `cargo test -p tandem-tidy` needs no other crate of the project.

mod architecture;
mod circles;
mod codes;
mod crates;
mod dialects;
mod language;
mod names;
mod product;
mod public_items;
mod quick;
mod roadmap;
mod sizes;
mod spawns;
mod test_items;
mod texts;
