//! Blocks to path segments: transforms, offsets, geometry.
