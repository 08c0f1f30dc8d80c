//! PLC-side runtime that emulates the sequence-control interface of an NC integrated controller.
