//! Outputs of M codes: their issue, their ledger, and the work of the stock sequence program.

pub(super) mod output_issue;
pub(super) mod output_ledger;
pub(super) mod stock_work;
