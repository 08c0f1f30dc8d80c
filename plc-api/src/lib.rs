//! Sequence-control API of the Tandem runtime: M-code handlers, commands, inputs and states of CNC coordinate systems.
