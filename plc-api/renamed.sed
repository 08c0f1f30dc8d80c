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
s/\bhandshake::Closed\b/fake::OutputOutcome/g
s/(^|[^:[:alnum:]_])Closed::/\1OutputOutcome::/g
s/\b(subscription|messages|events)\.lost\(\)/\1.dropped_events()/g

# a machine in simulated time
s/\btandem_runtime::test\b/tandem_testing/g
s/(tandem_testing::\{?.*)\bEnded\b/\1OutputEnd/
s/(tandem_testing::\{?.*)\bStopped\b/\1RunEndReason/
s/(^|[^:[:alnum:]_])Ended::/\1OutputEnd::/g
s/(^|[^:[:alnum:]_])Stopped::/\1RunEndReason::/g

# what only runtimes, transports and other clients need is in the crate plc-protocol
s/\bplc_api::(execution|handler_registry|io_points|lock_input|queue|server|supervisor|transport|wire)\b/plc_protocol::\1/g
s/\bplc_api::handshake::(Ledger|Effect|Full|Now|OpenOutput|OutputSpec|CLOSED_REMEMBERED|PROGRESS_TEXT_MAX|rules)\b/plc_protocol::handshake::\1/g
s/\bplc_api::hub::Hub\b/plc_protocol::hub::Hub/g
s/\bplc_api::port::BoxFuture\b/plc_protocol::port::BoxFuture/g
s/\bplc_api::alarm::(ALARM_TEXT_MAX|USER_ALARM_BASE|USER_CODE_MAX)\b/plc_protocol::alarm::\1/g
s/\bplc_api::alarm::(Alarm|UserAlarm)\b/plc_api::\1/g
s/\bplc_api::handlers::(M_CODE_MAX|RUNTIME_M_CODES)\b/plc_protocol::types::m_code::\1/g
s/\bplc_api::types::(execution|explained|form|heartbeat|ids|params|planned|redelivery|refusal|start|stored_data|trace|upload|verb|words)\b/plc_protocol::types::\1/g
s/\bplc_api::types::alarm_text::(ALARM_TEXTS_MAX|ALARM_TEXT_MAX|AlarmText|LANGUAGES_MAX|USER_CODE_MAX)\b/plc_protocol::types::alarm_text::\1/g
s/\bplc_api::types::command::(CommandMeta|CommandReply|Expect|MemoryKey)\b/plc_protocol::types::command::\1/g
s/\bplc_api::types::data::(JOURNAL_LINES_MAX|JournalFilter|JsonNumber|PublishedVariables|ToolTable|VARIABLES_AT_ONCE_MAX|VariableKind|VariableValues|WorkOffsetTable|WorkOffsetValues)\b/plc_protocol::types::data::\1/g
s/\bplc_api::types::handler::(CONNECTION_MARK|Departure|EXPIRES_MS|HandledCode|HandlerAct|HandlerResult|HandlerStatus|INSTANCE_MAX|REFRESHES|RETURNS_WITHIN_MS)\b/plc_protocol::types::handler::\1/g
s/\bplc_api::types::io::(IO_MAX|IoDeclarations|IoForce|IoSet|KeepWord|LastWord)\b/plc_protocol::types::io::\1/g
s/\bplc_api::types::lock::(DEFAULT_SOURCE|LOCK_TEXT_MAX|LockSet|OnLoss)\b/plc_protocol::types::lock::\1/g
s/\bplc_api::types::m_code::(DECLARED_NAME_MAX|GivenParam|MCodeDeclaration|M_CODE_MAX|ParamFault|RUNTIME_M_CODES|UNIT_MAX)\b/plc_protocol::types::m_code::\1/g
s/\bplc_api::types::machine::(ActiveAlarms|AlarmRaise|Birth|BrokerInUse|CoordinateSystemInfo|Identification|Limits|MCodeInfo|MotorInfo|Presence|ServedMCode|ServedMCodesFile)\b/plc_protocol::types::machine::\1/g
s/\bplc_api::types::message::(INTERFACE_VERSION)\b/plc_protocol::types::message::\1/g
s/\bplc_api::types::not_after::(NOT_AFTER_MAX_MS|NOT_AFTER_MS)\b/plc_protocol::types::not_after::\1/g
s/\bplc_api::types::output::(CHECKPOINT_MAX|Cancel|CheckpointReport|Claim|HandledCode|HandlerPresence|HandlerResult|HandlerStatus|HandshakeResult|OutputAct|ProgressReport|Redeliver|Reset|ResetResult)\b/plc_protocol::types::output::\1/g
s/\bplc_api::types::program::(FOLDER_CHARS_MAX|FOLDER_DEPTH_MAX|PROGRAM_BYTES_MAX|ProgramCheck|ProgramFolder|ProgramText)\b/plc_protocol::types::program::\1/g
s/\bplc_api::types::question::(Ask|CHOICES_MAX|CHOICE_TEXT_MAX|OperatorAnswer|QUESTION_ID_MAX|QUESTION_TEXT_MAX|Validate|ValidateResult)\b/plc_protocol::types::question::\1/g
s/\bplc_api::types::request::(Answer|CoordinateSystemRequest|Destination|MachineRequest|OutputRequest|ProgramRequest|TypedRequest)\b/plc_protocol::types::request::\1/g
s/\bplc_api::types::run::(PARTS_MAX|RUNS_AT_ONCE_MAX|RUNS_KEPT|RUN_WAIT_MAX_S|RunQuery|RunState|TimeLeft)\b/plc_protocol::types::run::\1/g
s/\bplc_api::types::state::(LockSet)\b/plc_protocol::types::state::\1/g
s/\bplc_api::types::topic::(Payload)\b/plc_protocol::types::topic::\1/g
s/\bplc_api::types::request::typed\b/plc_protocol::types::request::typed/g
s/\bplc_protocol::(types::request::typed::WriteProgram)\b/plc_api::\1/g
s/\bplc_api::types::lease::(LEASE_HOLDER_MAX|LEASE_TTL_DEFAULT_MS|LEASE_TTL_MAX_MS|LEASE_TTL_MIN_MS|Lease|LeaseRelease|LeaseRequest|LeaseTake)\b/plc_protocol::types::lease::\1/g
