//! The rules of the handshake, under the numbers that tests and comments cite.

/// Number and text in Markdown, ascending.
#[rustfmt::skip] // one row a line
pub static RULES: &[(&str, &str)] = &[
    ("H1", "An output is QUEUED, then OUTPUT when it is published to handlers, then CLAIMED when one of them owns it. It ends in one of four ways: reset, failed, cancelled, timed out. Every open output can be ended."),
    ("H2", "`seq` increases from output to output of a coordinate system, and is not reused while the runtime runs (`boot_id`). Every message of a handler or an operator about an output contains `boot_id` and `seq`, so an old reset never resets a later output with the same M number."),
    ("H3", "A message about an output that is not open is answered `duplicate` if it was reset; `stale` if it was cancelled, failed or timed out, belongs to another boot, or if 4096 outputs have ended since; `unknown` if this boot never put it out in that coordinate system with that M number. Nothing changes then."),
    ("H4", "The first claim makes its handler the owner. A repeated claim of the owner is `accepted` again; any other is `not_owner`, also that of another instance of the handler."),
    ("H5", "An output that nobody owns may be reset without a claim. A claimed output can only be reset by its owner; others are `not_owner`. An operator's reset with `force` ends any open output: the owner receives a cancel with the reason `operator`, and the journal records the operator."),
    ("H6", "A reset with the result `fault` ends the output as failed: an alarm with the number 10000 + `code` and the unchanged text stops the NC program."),
    ("H7", "The retained topic `m_code/pending` is authoritative. It is published before the notice of an output that it shows, and before the answer to a reset that removes one."),
    ("H8", "At most `open_outputs_max` outputs are open. At this limit the interpreter waits; nothing is dropped."),
    ("H9", "Reset, stop, abort and an alarm cancel all open outputs. First handlers receive the cancel with its reason, then `m_code/pending` is published without the outputs. Handlers receive nothing for an output that was still QUEUED."),
    ("H10", "`timeout_ms` starts with OUTPUT, and continues in a hold and when the owner changes. An output that times out raises an alarm."),
    ("H11", "When a handler is lost, the outputs that it had claimed are OUTPUT again, with a warning and the reason HANDLER_LOST. Who may claim one then is decided by `redelivery`, of the M code's configuration, of the handler that was lost and of the one that claims: the strictest that is said counts, `ask` before `verify` before `redo`, and `ask` where nothing is said. With `ask` it is withheld: a claim, and a reset by a handler that is there, are answered `withheld`, until the operator decides by `redeliver` or a reset. The instance that was lost may always claim it again: it still works on it."),
    ("H12", "An output that nobody owns and that is not withheld is published again, `redelivered` and with `attempt` one higher, when a handler for it comes online, when the connection to the broker is restored, and when the operator decides how to continue."),
    ("H13", "The owner may report progress: a text, cut after 200 characters, and 0 to 100 percent."),
    ("H14", "The owner may ask the operator one question with choices at a time. It is answered once, with one of the choices, and ends with the output."),
    ("H15", "A reset in a feed hold is accepted, and the program continues after the resume."),
    ("H16", "A main program ends by M02, M30 and M99 once all outputs of the run have ended (D32)."),
    ("H17", "The setting `unhandled` decides about an output without a handler: an alarm, waiting, or a reset by the stock sequence program."),
    ("H18", "The id of a handler has 1 to 64 characters without `/ + #`; with any other id, claims and resets are `not_owner`."),
    ("H19", "One instance of a handler is there at a time. Another one's presence is refused (`handler_taken`), unless it is to take over: then the first is told on `handler/{id}/result` that it is at its end, and what it had claimed is lost (H11). An instance names itself in its presence, claims and resets; without a name it is its connection to the embedded broker, its WebSocket, or, where neither is known, the handler. That an instance has gone changes nothing for another that has come since."),
    ("H20", "Where one handler alone serves an M code and its presence says `exclusive` and names its instance, an output of it is claimed for that instance in the step that makes it: `m_code/pending` shows it CLAIMED, with `handler_id` and `instance`, and no claim is sent. Only that instance begins with it, and only once, which may be after a loss of its connection: `lost_instance` names it then. It holds for the first delivery alone (`attempt` 1); an output that is published again is claimed by a message."),
    ("H21", "The owner may note a checkpoint, any JSON of at most 4096 bytes. It stands in `m_code/pending`, in place of the one before, and is kept when its owner is lost: whoever takes the output up, by `redo` or `verify`, is given it. `null` takes it away. It ends with the output."),
];
