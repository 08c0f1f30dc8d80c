//! The Rust blocks of the book's pages as documentation tests: each block compiles and runs unchanged.
#![cfg_attr(doctest, doc = include_str!("src/how-to/handler.md"))]
#![cfg_attr(doctest, doc = include_str!("src/how-to/watch.md"))]
#![cfg_attr(doctest, doc = include_str!("src/how-to/io.md"))]
#![cfg_attr(doctest, doc = include_str!("src/how-to/scan.md"))]
#![cfg_attr(doctest, doc = include_str!("src/how-to/tool-change.md"))]
#![cfg_attr(doctest, doc = include_str!("src/how-to/two-coordinate-systems.md"))]
