//! Topics that come in over MQTT. What goes out is [`Topic`](plc_api::types::topic::Topic), and only the runtime
//! publishes it.

use crate::access::Right;

/// One topic that comes in.
#[derive(Debug)]
pub(crate) struct InboundTopic {
    /// Topic filter below the root.
    pub(crate) filter: &'static str,
    /// What it asks of its sender.
    pub(crate) right: Right,
    /// True where the retain flag is right: a state of its sender. A retained command would be carried out again.
    pub(crate) retained: bool,
    /// Form of its payload, by name of the schema.
    #[cfg_attr(not(test), allow(dead_code, reason = "for the generated documents"))]
    pub(crate) schema: &'static str,
}

const fn topic(filter: &'static str, right: Right, schema: &'static str) -> InboundTopic {
    InboundTopic {
        filter,
        right,
        retained: false,
        schema,
    }
}

/// Every topic that comes in.
pub(crate) const INBOUND: [InboundTopic; 20] = [
    topic("cs/+/m_code/+/claim", Right::Handle, "Claim"),
    topic("cs/+/m_code/+/reset", Right::Reset, "Reset"),
    topic("cs/+/m_code/+/progress", Right::Handle, "ProgressReport"),
    topic("cs/+/m_code/+/redeliver", Right::Operate, "Redeliver"),
    topic("cs/+/m_code/+/ask", Right::Handle, "Ask"),
    topic("cs/+/m_code/+/answer", Right::Operate, "OperatorAnswer"),
    topic("cs/+/m_code/+/validate_result", Right::Handle, "ValidateResult"),
    topic("cs/+/input/+/set", Right::Operate, "InputSet"),
    topic("cs/+/override/set", Right::Operate, "OverrideChange"),
    topic("cs/+/spindle/set", Right::Operate, "SpindleCommand"),
    topic("cs/+/tool/set", Right::Operate, "Tool"),
    topic("cs/+/command/+", Right::Operate, "CommandMessage"),
    topic("cs/+/lease/take", Right::Operate, "LeaseTakeMessage"),
    topic("cs/+/lease/release", Right::Operate, "LeaseReleaseMessage"),
    topic("cs/+/lease/break", Right::Administrate, "LeaseBreakMessage"),
    topic("cs/+/variable/get", Right::Operate, "VariableGet"),
    topic("cs/+/variable/set", Right::Operate, "VariableSet"),
    topic("motor/+/skip_input/set", Right::Operate, "Switch"),
    topic("alarm/raise", Right::Raise, "AlarmRaise"),
    InboundTopic {
        filter: "handler/+/presence",
        right: Right::Handle,
        retained: true,
        schema: "HandlerPresence",
    },
];

/// The row of a path below the root.
pub(crate) fn inbound(path: &str) -> Option<&'static InboundTopic> {
    INBOUND.iter().find(|topic| fits(topic.filter, path))
}

/// True for a path on which commands, claims and settings come in, which must not be retained. Presence of handlers
/// comes in too, and is retained.
pub(crate) fn is_inbound(path: &str) -> bool {
    inbound(path).is_some_and(|topic| !topic.retained)
}

fn fits(filter: &str, path: &str) -> bool {
    let mut levels = path.split('/');
    let all = filter.split('/').all(|wanted| {
        levels
            .next()
            .is_some_and(|level| wanted == "+" || wanted == level)
    });
    all && levels.next().is_none()
}

#[cfg(test)]
mod tests {
    use super::is_inbound;

    #[test]
    fn only_what_must_not_be_retained_is_inbound() {
        for path in [
            "cs/1/command/start",
            "cs/1/input/dry_run/set",
            "cs/2/m_code/5/reset",
            "motor/1/skip_input/set",
        ] {
            assert!(is_inbound(path), "{path}");
        }
        for path in [
            "cs/1/state",
            "handler/h/presence",
            "presence",
            "cs/1/input/dry_run/state",
            "cs/1/command",
            "cs/1/command/start/x",
        ] {
            assert!(!is_inbound(path), "{path}");
        }
    }
}
