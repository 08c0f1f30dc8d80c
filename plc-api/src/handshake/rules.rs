//! The rules of the handshake, under the numbers that tests and comments cite.

/// Number and text in Markdown, ascending.
#[rustfmt::skip] // one row a line
pub static RULES: &[(&str, &str)] = &[
    ("H1", "An output is QUEUED, OUTPUT once handlers may see it, and CLAIMED once one of them owns it. It ends in one of four ways: reset, failed, cancelled, timed out. Each open output can be ended."),
    ("H2", "`seq` grows from output to output of a coordinate system and is never used again as long as the runtime runs (`boot_id`). Whatever a handler or an operator says about an output names `boot_id` and `seq`, so an old reset never frees a later output with the same M number."),
    ("H3", "An output that is not open is answered `duplicate` if it was reset; `stale` if it was cancelled, failed or timed out, if its boot is another one, or if 4096 outputs have ended since; `unknown` if this boot never put it out there with that M number. None of the three changes anything."),
    ("H4", "The first claim owns. Repeated by its owner it is `accepted` again; anyone else is `not_owner`."),
    ("H5", "A reset of an output that nobody owns claims it and resets it. After a claim only its owner resets it, others are `not_owner`. An operator's reset with `force` ends any open output: the owner is cancelled with the reason `operator`, and the journal says who did it."),
    ("H6", "A reset with the result `fault` ends the output as failed: an alarm with the number 10000 + `code` and the text unchanged, which stops the NC program."),
    ("H7", "`m_code/pending` is retained and the truth. It is published before the notice of an output that it shows, and before the answer to a reset that takes one out."),
    ("H8", "At most `open_outputs_max` outputs are open. When as many are, the interpreter waits; nothing is dropped."),
    ("H9", "Reset, stop, abort and an alarm cancel all open outputs. Handlers are told first, with the reason; then `m_code/pending` shows none. Of one that was still QUEUED no handler hears."),
    ("H10", "`timeout_ms` counts from OUTPUT on, under a hold too and from owner to owner; then the output has timed out, which is an alarm."),
    ("H11", "When a handler goes away, what it owned is OUTPUT again, with a warning and the reason HANDLER_LOST. What happens when it comes back is its `on_redelivery`: `redo`, `verify` or `ask`, which is the default and leaves it to the operator."),
    ("H12", "An output that nobody owns is published again, `redelivered` and with `attempt` one higher, when a handler for it comes online, when the connection to the broker is made anew, and when the operator says how it is to be taken up."),
    ("H13", "The owner may tell its progress: a text, cut after 200 characters, and 0 to 100 percent."),
    ("H14", "The owner may ask the operator one question at a time, with choices. It is answered once, with one of them, and ends with the output."),
    ("H15", "A reset under feed hold is taken, and the program goes on after the resume."),
    ("H16", "M02, M30 and M99 of a main program end it when every output of the run has ended (D32)."),
    ("H17", "An output whose M code no handler has follows `unhandled`: an alarm, waiting, or a reset by the stock sequence program."),
    ("H18", "The id of a handler has 1 to 64 characters without `/ + #`; with another one it never owns anything."),
];
