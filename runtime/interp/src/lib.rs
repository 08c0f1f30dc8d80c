//! NC program tree to blocks: modal state, codes, control flow, subprograms.
