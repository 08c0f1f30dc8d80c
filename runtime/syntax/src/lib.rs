//! NC text to a program tree with diagnostics.
