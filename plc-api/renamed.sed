# Names of plc-api and tandem-runtime that have changed since commit 71e10300. To apply the table to a crate:
#     sed -E -i -f plc-api/renamed.sed $(git ls-files '*.rs')

# handlers and their parameters
s/(use plc_api::\{.*)\bState\b/\1HandlerState/
s/\b(plc_api|extract)::State\b/\1::HandlerState/
s/(^|[^:[:alnum:]_])State([<(])/\1HandlerState\2/g
s/\bfn of\(number: Option<f64>\)/fn from_number(number: Option<f64>)/
s/(ParamLetter::[A-H])\.of\(/\1.value_in(/g
s/\.nest\(/.merge_at(/g

# guards that a program holds
s/\bplc_api::Lease\b/plc_api::LeaseGuard/g
s/\bplc_api::Heartbeat\b/plc_api::HeartbeatGuard/g
s/(heartbeat|beats?)\.end\(\)/\1.release()/g

# messages
s/\bProgramPlace\b/ProgramLocation/g
s/\bPlannedPlace\b/PlannedLocation/g
s/\bstate::Captured\b/state::CapturedPositions/g
s/\bHandlerPresence::gone\(/HandlerPresence::offline(/g
s/\bVariableArea::of\(/VariableArea::from_kind(/g

# the scripted machine, the raw queue and the ledger
s/\.put_out\(/.issue_output(/g
s/\.put_out_within\(/.issue_output_within(/g
s/\.put_end\(/.end_program(/g
s/\.lose_handler\(/.disconnect_handler(/g
s/\.say\(/.publish_message(/g
s/\bhandshake::Closed\b/handshake::OutputOutcome/g
s/(^|[^:[:alnum:]_])Closed::/\1OutputOutcome::/g
s/\b(subscription|messages|events)\.lost\(\)/\1.dropped_events()/g

# a machine in simulated time
s/(tandem_runtime::test::\{?.*)\bEnded\b/\1OutputEnd/
s/(tandem_runtime::test::\{?.*)\bStopped\b/\1RunEndReason/
s/(^|[^:[:alnum:]_])Ended::/\1OutputEnd::/g
s/(^|[^:[:alnum:]_])Stopped::/\1RunEndReason::/g
