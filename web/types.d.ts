// Shapes of the interface, version 1: messages of the runtime over WebSocket and REST. Generated from the types;
// TANDEM_UPDATE=1 cargo test -p tandem-gateway contract generates them again.

/** Payload of `alarm/active`. */
export interface ActiveAlarmsMessage { alarms: AlarmRecord[]; boot_id: BootId; rev?: number; ts: string; v: 1; }

export interface AlarmHistory { alarms: AlarmRecord[]; }

/** One alarm: payload of `alarm/event`, and an entry of `alarm/active`. */
export interface AlarmRecord {
  acknowledged_by: string | null; cleared_at: Timestamp | null; column?: number; cs: number | null; id: number;
  languages?: Record<string, AlarmWords>; line: number | null; number: number; program: number | null;
  raised_at: Timestamp; remedy?: string; severity: AlarmSeverity; text: string;
}

/** One alarm: payload of `alarm/event`, and an entry of `alarm/active`. */
export interface AlarmRecordMessage {
  acknowledged_by: string | null; boot_id: BootId; cleared_at: Timestamp | null; column?: number; cs: number | null;
  id: number; languages?: Record<string, AlarmWords>; line: number | null; number: number; program: number | null;
  raised_at: Timestamp; remedy?: string; rev?: number; severity: AlarmSeverity; text: string; ts: string; v: 1;
}

/** Severity of an alarm. */
export type AlarmSeverity = "warning" | "alarm";

/** Texts of an alarm of a sequence program. When the alarm is raised, the machine adds the remedy and the
 * translations; each panel shows the text in its language. */
export interface AlarmText { code: number; languages?: Record<string, AlarmWords>; remedy?: string; text: string; }

/** Text and remedy of an alarm in one language. */
export interface AlarmWords { remedy?: string; text: string; }

/** All inputs and outputs of the plant, each with the last message of its state. */
export interface AllIo { in: Record<string, IoStateMessage>; out: Record<string, IoStateMessage>; }

/** Payload of `birth`: description of the machine. Only `serves` changes while the runtime runs. */
export interface BirthMessage {
  boot_id: BootId; coordinate_systems: CoordinateSystemInfo[]; identification: Identification; io: IoDeclarations;
  limits: Limits; m_codes: Record<string, MCodeInfo>; machine: string; motors: MotorInfo[]; rev?: number;
  serves: ServedMCode[]; servo_period_us: number; ts: string; v: 1;
}

/** Identifies one start of the runtime. Outputs, claims and resets of another boot are stale. */
export type BootId = string;

/** An external MQTT broker to which the runtime is connected. */
export interface BrokerInUse { address: string; since: Timestamp; }

/** A call in the program stack. */
export interface CallSite { line: number; program: number; }

/** Payload of `m_code/{m}/cancel`. */
export interface CancelMessage { boot_id: BootId; reason: CancelReason; rev?: number; seq: number; ts: string; v: 1; }

/** Why an output was cancelled. */
export type CancelReason = "reset" | "stop" | "abort" | "alarm" | "timeout" | "operator" | "shutdown";

/** Payload of `captured`: the positions that the last G31 captured. */
export interface CapturedPositionsMessage {
  boot_id: BootId; captured: boolean[]; line: number; motors: number[]; positions: number[]; rev?: number;
  run_id: string | null; ts: string; v: 1;
}

/** The answer to an accepted command. */
export interface CommandAccepted { command_id: string; hash?: string; }

/** Payload of `reply/{client_id}`, and of `GET /commands/{id}`. */
export interface CommandReply {
  code: string; command_id: string; hash?: string; lease?: Lease; moved?: Record<string, number>; run_id?: string;
  state_rev: number; status: CommandStatus; text: string; variables?: VariableValues;
}

/** Payload of `reply/{client_id}`, and of `GET /commands/{id}`. */
export interface CommandReplyMessage {
  boot_id: BootId; code: string; command_id: string; hash?: string; lease?: Lease; moved?: Record<string, number>;
  rev?: number; run_id?: string; state_rev: number; status: CommandStatus; text: string; ts: string; v: 1;
  variables?: VariableValues;
}

/** Status of a command. */
export type CommandStatus = "accepted" | "rejected" | "done" | "failed";

/** Consequence of a fault in a task or a thread. */
export type Consequence = "contained" | "restarted" | "stops_coordinate_system" | "coordinate_system_needs_restart" | "stops_all" | "exits";

/** One coordinate system. */
export interface CoordinateSystemInfo {
  axes: Record<string, number>; dialect: string; number: number; spindle: number | null; units: string;
}

/** All coordinate systems with their states. */
export interface CoordinateSystemList {
  coordinate_systems: ({ axes: Record<string, number>; dialect: string; number: number; spindle: number | null; state: StateMessage | null; units: string })[];
}

/** A coordinate system of another machine. */
export interface CoordinateSystemSeen {
  left_s: number | null; number: number; progress: number | null; start_conditions: StartConditions | null;
  state: State | null; waiting_on: PendingOutput | null;
}

/** The current user and the user's role. */
export interface CurrentUser { is_login: boolean; role: string; user: string | null; }

/** Severity of a finding. */
export type DiagnosticSeverity = "error" | "warning";

/** State word of a coordinate system, named as in MTConnect Execution. */
export type Execution = "READY" | "ACTIVE" | "WAIT" | "FEED_HOLD" | "PROGRAM_STOPPED" | "OPTIONAL_STOP" | "INTERRUPTED" | "STOPPED" | "PROGRAM_COMPLETED";

/** Meaning of a name. */
export interface Explanation { picture?: string; text: string; what: string; }

/** One M code that a handler serves. */
export interface HandledCode { cs: number; m: number; }

/** Message that a `handler/{id}/result` answers. */
export type HandlerAct = "presence";

export interface HandlerList { handlers: Record<string, HandlerPresence>; }

/** Payload of `handler/{id}/presence`. */
export interface HandlerPresence {
  alarms?: AlarmText[]; connection?: number; exclusive?: boolean; expires_ms?: number; handles: HandledCode[];
  instance?: string; m_codes?: MCodeDeclaration[]; online: boolean; redelivery?: Redelivery; returns_within_ms?: number;
  take_over?: boolean; validates: boolean;
}

/** Payload of `handler/{id}/result`: the answer to an `online` presence, a request to confirm that the
 * instance is still online, or the notice that another instance has replaced it. */
export interface HandlerResultMessage {
  boot_id: BootId; code?: RefusalCode; instance: string | null; of: HandlerAct; rev?: number; status: HandlerStatus;
  text?: string; ts: string; v: 1;
}

/** Status in the answer to a presence. */
export type HandlerStatus = "accepted" | "refused" | "confirm" | "taken_over";

/** Payload of `m_code/{m}/result`. */
export interface HandshakeResult {
  handler_id: string; how?: Redelivery; instance?: string; of?: OutputAct; seq: number; status: HandshakeStatus;
  text?: string;
}

/** Payload of `m_code/{m}/result`. */
export interface HandshakeResultMessage {
  boot_id: BootId; handler_id: string; how?: Redelivery; instance?: string; of?: OutputAct; rev?: number; seq: number;
  status: HandshakeStatus; text?: string; ts: string; v: 1;
}

/** Result of a claim or a reset. */
export type HandshakeStatus = "accepted" | "duplicate" | "stale" | "unknown" | "not_owner" | "withheld" | "refused";

/** Health of the server, its MQTT broker, and all tasks of the runtime. */
export interface Health {
  broker?: BrokerInUse; faults?: TaskFault[]; status: HealthStatus; stop_without_login?: boolean;
}

/** The status of a server that answers. */
export type HealthStatus = "ok" | "degraded" | "failed";

/** Payload of `heartbeat`, published 10 times a second while the servo runs; not published while the servo is
 * stopped. */
export interface HeartbeatMessage { boot_id: BootId; cycle: number; rev?: number; ts: string; v: 1; }

/** Additions of a machine builder to the HMI, and the limits of its jog buttons. */
export interface Hmi { buttons: HmiButton[]; cards: HmiCard[]; jog_step_max: number; }

/** A button of the panel Machine: it runs an M code or a line of NC text, sets a variable, or switches an
 * input. */
export interface HmiButton {
  confirm?: string; cs?: number; icon?: string; input?: string; m_code?: number; mdi?: string; states?: Execution[];
  text: string; value?: number; variable?: string;
}

/** A card of the panel Machine: it shows the open output of an M code, a variable, an input, or the drawing
 * of a module in the folder `dir`. */
export interface HmiCard {
  cs?: number; icon?: string; input?: string; m_code?: number; module?: string; text: string; unit?: string;
  variable?: string;
}

/** Data of a machine's nameplate: the table `[identification]` of its configuration. Entries that are not
 * configured are absent. */
export interface Identification {
  location?: string; manufacturer?: string; model?: string; product_instance_uri?: string; serial_number?: string;
  year_of_construction?: number;
}

export interface Inputs {
  dry_run?: SwitchMessage; interlock?: LockMessage; optional_skip?: OptionalSkipMessage; optional_stop?: SwitchMessage;
  single_block?: SwitchMessage; start_lock?: LockMessage;
}

/** Configuration of an input or output. */
export interface IoDeclaration {
  at_start?: IoStart; kind: IoKind; max?: number; min?: number; on_loss: IoLoss; text?: string; unit?: string;
}

/** All inputs and outputs of a plant, as the configuration declares them. */
export interface IoDeclarations { in: Record<string, IoDeclaration>; out: Record<string, IoDeclaration>; }

/** A forced value that replaces the written value. */
export interface IoForced { by: string; value: IoValue; }

/** Kind of a value. */
export type IoKind = "bool" | "number";

/** The value of an input or output whose owner is lost. */
export type IoLoss = IoValue | KeepWord;

/** The value of an output at a start of the machine. */
export type IoStart = IoValue | LastWord;

/** Payload of `io/in/{name}` and `io/out/{name}`. */
export interface IoStateMessage {
  boot_id: BootId; forced: IoForced | null; lost: boolean; owner: string | null; rev?: number; ts: string;
  unknown?: boolean; v: 1; value: IoValue; written: IoValue;
}

/** The value of an input or output. */
export type IoValue = boolean | number;

export interface JournalAnswer {
  lines: ({ cs: number | null; event: string; t_s: number | null; ts: string | null; [name: string]: unknown })[];
}

/** The word `keep`. */
export type KeepWord = "keep";

/** Response of `GET /cs/{n}/last_run`: the last run of a coordinate system in an earlier boot of the runtime. The
 * state was recorded at most 100 ms before that boot ended. */
export interface LastRun {
  at: Timestamp; boot_id: BootId; execution: Execution; line: number; outputs: PendingOutput[]; program: number | null;
  run_id: string; running: number | null;
}

export interface LastRunAnswer { last_run: LastRun | null; }

/** The word `last`. */
export type LastWord = "last";

/** A control lease that a client holds. */
export interface Lease { expires_at: Timestamp; fence: number; holder: string; }

/** Payload of `cs/{cs}/lease/state`: all fields are null while the lease is free. */
export interface LeaseStateMessage {
  boot_id: BootId; expires_at: Timestamp | null; fence: number | null; holder: string | null; rev?: number; ts: string;
  v: 1;
}

/** Limits of the interface. */
export interface Limits { open_outputs_max: number; program_bytes_max: number; }

/** State in force at the line where a run begins, and the actions of the start before the block of that line. */
export interface LineState {
  approach: (Record<string, number>)[]; block: string; line: number; machine: Record<string, number>; modal: Modal;
  not_restored: RestoredOutput[]; occurrence: number; program: number; restore: RestoredOutput[]; stack: CallSite[];
  variables: Record<string, number>; work: Record<string, number>;
}

/** Payload of `input/interlock/state` and `input/start_lock/state`: an input with the reasons why it is on. */
export interface LockMessage {
  boot_id: BootId; rev?: number; sources: LockSource[]; text: string; ts: string; v: 1; value: boolean;
}

/** One source of an interlock or start lock. */
export interface LockSource {
  forced_by?: string; handler_id: string | null; lost: boolean; source: string; text: string; value: boolean;
}

/** A token of a login, with limited validity. */
export interface Login { expires_s: number; role: string; token: string; user: string; }

/** Declaration of an M code by the handler that serves it: its name, and the meaning of its parameters. */
export interface MCodeDeclaration {
  cs?: number; m: number; name?: string;
  params?: { A?: ParamDeclaration; B?: ParamDeclaration; C?: ParamDeclaration; D?: ParamDeclaration; E?: ParamDeclaration; F?: ParamDeclaration; G?: ParamDeclaration; H?: ParamDeclaration };
  redelivery?: Redelivery;
}

/** Settings of one M code. */
export interface MCodeInfo {
  name?: string;
  params?: { A?: ParamDeclaration; B?: ParamDeclaration; C?: ParamDeclaration; D?: ParamDeclaration; E?: ParamDeclaration; F?: ParamDeclaration; G?: ParamDeclaration; H?: ParamDeclaration };
  timeout_ms: number | null; timing: Timing; wait_state: string | null;
}

/** Whether a machine is online. */
export type MachineLink = "online" | "silent" | "offline";

/** The other machines that the HMI shows. */
export interface MachineList { addresses: string[]; broker: SharedBroker; machines: MachineSeen[]; }

/** A machine according to its messages. */
export interface MachineSeen {
  age_ms: number | null; alarm_count: number; alarms: AlarmRecord[]; coordinate_systems: CoordinateSystemSeen[];
  link: MachineLink; machine: string; url: string | null;
}

/** Payload of `modal`. */
export interface Modal {
  f: number; g: Record<string, string>; mdi: string[]; s: number; ta: number; td: number; tool: number | null;
  ts_ms: number; work_offset: string | null;
}

/** Payload of `modal`. */
export interface ModalMessage {
  boot_id: BootId; f: number; g: Record<string, string>; mdi: string[]; rev?: number; s: number; ta: number; td: number;
  tool: number | null; ts: string; ts_ms: number; v: 1; work_offset: string | null;
}

/** One motor. */
export interface MotorInfo { kind: string; max_velocity: number; number: number; soft_limits: [number, number] | null; }

export type Number = number | "NaN" | "inf" | "-inf";

/** Payload of `input/optional_skip/state`. */
export interface OptionalSkipMessage {
  boot_id: BootId; effective: number[]; effective_from_line: number; requested: number[]; rev?: number; ts: string;
  v: 1;
}

/** Message that a `result` answers. */
export type OutputAct = "claim" | "reset" | "progress" | "checkpoint" | "ask" | "redeliver" | "answer";

/** One output, as in `m_code/{m}/output`. */
export interface OutputNoticeMessage {
  attempt: number; boot_id: BootId; id: string; line: number; m: number; params: Params; program: number;
  redelivered: boolean; rev?: number; run_id: string; seq: number; timing: Timing; ts: string; v: 1;
}

/** State of an open output. */
export type OutputState = "QUEUED" | "OUTPUT" | "CLAIMED";

/** Payload of `override/state`, percent. */
export interface OverridesMessage {
  boot_id: BootId; feed: number; rapid: number; rev?: number; spindle: number; ts: string; v: 1;
}

/** Meaning of one parameter, and the numbers that it accepts. */
export interface ParamDeclaration {
  max?: number; min?: number; name?: string; optional?: boolean; unit?: string; whole?: boolean;
}

/** Parameters VA to VH of an output, in JSON `A` to `H`: numbers as the program gives them, without a unit
 * (G20 and G21 do not change them); `None` if not programmed. */
export interface Params {
  A?: number; B?: number; C?: number; D?: number; E?: number; F?: number; G?: number; H?: number;
}

/** Payload of `m_code/pending`: all open outputs, ascending by `seq`. */
export interface PendingMessage { boot_id: BootId; outputs: PendingOutput[]; rev?: number; ts: string; v: 1; }

/** One open output, as in `m_code/pending`. */
export interface PendingOutput {
  attempt: number; checkpoint?: unknown; handler_id: string | null; how?: Redelivery; id: string; instance?: string;
  line: number; lost: boolean; lost_instance?: string; m: number; params: Params; program: number; progress?: Progress;
  question?: Question; redelivered: boolean; redelivery?: Redelivery; run_id: string; seq: number; since: Timestamp;
  state: OutputState; timing: Timing;
}

/** Identity of a plan: all inputs from which the plan is computed. Two plans with the same identity are
 * equal. */
export interface PlanIdentity { called: string | null; hash: string; inputs: string; }

/** A block of a program. */
export interface PlannedLocation { line: number; program: number; }

/** Payload of `position`. Lengths are mm and angles degrees, regardless of G20 and G21. */
export interface PositionMessage {
  actual: Record<string, number>; boot_id: BootId; distance_to_go: Record<string, number>; feedrate: number;
  following_error: Record<string, number>; homed: Record<string, boolean>; machine: Record<string, number>;
  rev?: number; spindle_rpm: number; ts: string; v: 1; work: Record<string, number>;
}

/** Payload of `presence`. */
export interface PresenceMessage {
  boot_id: BootId; broker?: BrokerInUse; expires_ms?: number; online: boolean; rev?: number; started_at: Timestamp;
  ts: string; url?: string; v: 1; version: string;
}

/** A refusal over HTTP. */
export interface Problem {
  allowed?: Verb[]; code: string; detail: string; diagnostics?: ProgramDiagnostic[]; reply?: CommandReply;
  run_id?: string; state?: Execution; status: number; title: string; type: string;
}

/** Production of one program in one coordinate system. */
export interface Production {
  cs: number; cut_short: number; last: Timestamp | null; parts: number; parts_s: number; program: number;
}

/** Result of a check of a program. */
export interface ProgramCheck {
  diagnostics: ProgramDiagnostic[]; dialect: string; hash: string; m_codes: number[]; o_number: number | null;
  programs: number[]; signature: SignatureState | null; unchanged?: boolean;
}

/** One finding of a check. */
export interface ProgramDiagnostic {
  code: string; column: number; end_column: number; end_line: number; help: string; line: number; message: string;
  severity: DiagnosticSeverity;
}

/** One program of the store. */
export interface ProgramInfo {
  bytes: number; dialect: string; errors: number; folder: string; hash: string; number: number; o_number: number | null;
  signature: SignatureState | null; title: string; warnings: number;
}

export interface ProgramList { programs: ProgramInfo[]; }

/** Payload of `program`. */
export interface ProgramLocationMessage {
  block: string; boot_id: BootId; interpreted_line: number; line: number; nest_level: number; number: number | null;
  rev?: number; stack: CallSite[]; ts: string; v: 1;
}

/** Progress of a handler, shown while the program waits. */
export interface Progress { percent?: number; text: string; }

/** Payload of `variables` and `cs/{cs}/variables`: the variables that `[[variables.published]]` of the
 * configuration lists, all at the same moment. */
export interface PublishedVariablesMessage {
  boot_id: BootId; rev?: number; ts: string; v: 1; variables: VariableValues[];
}

/** A question that a handler asks the operator. `m_code/pending` shows the question with its output. `state`
 * shows the question while the program waits for that output and the question has no answer. */
export interface Question { answer?: string; choices: string[]; id: string; since: Timestamp; text: string; }

/** Reason of a state. */
export type Reason = "HANDLER_LOST" | "SINGLE_BLOCK" | "INTERLOCK" | "BUS_LOST" | "SERVO_LATE" | "CLIENT_LOST" | "BACK_TRACE" | "BACK_TRACE_END" | "OVERRIDE_ZERO" | "ALARM" | "STOP" | "ABORTED" | "NO_PROGRAM" | "RESTARTED";

/** Treatment of an output on which a lost handler may already have worked. Later variants are stricter. */
export type Redelivery = "redo" | "verify" | "ask";

/** Machine-readable reason of a refusal. */
export type RefusalCode = "not_found" | "not_allowed" | "program_runs" | "start_locked" | "forbidden" | "busy" | "lease_lost" | "handler_taken" | "no_answer" | "command_id_reused" | "precondition_failed" | "program_has_errors" | "wrong_dialect" | "not_signed" | "line_refused" | "invalid" | "too_large" | "not_supported" | "retained" | "expired" | "unavailable";

/** Predicted run of a program. If a run of the program is in progress, it is planned with the conditions at
 * the start of that run, otherwise with the current conditions. Times apply to overrides of 100 percent. */
export interface Rehearsal {
  at: PlannedLocation | null; axes: Record<string, RehearsedAxis>; corners: RehearsedCorner[]; cs: number;
  cycle_time_s: number; depends: RunTimeDependence | null; feed_s: number; fixed_s: number; hash: string;
  lines: RehearsedLine[]; m_code_count: number; m_codes: RehearsedMCode[]; outcome: RehearsalOutcome;
  plan: PlanIdentity; program: number; rapid_s: number; revision: string; run: RehearsedRun | null;
  run_id: string | null; text: string; wait_s: number;
}

/** State of the planning. */
export type RehearsalOutcome = "planning" | "completed" | "alarm" | "too_long";

/** An axis of a planned run. */
export interface RehearsedAxis {
  acceleration: RehearsedPeak; highest: number; lowest: number; motor: number; soft_limits: [number, number] | null;
  velocity: RehearsedPeak;
}

/** A programmed corner that the path misses, because the next block begins without a stop. */
export interface RehearsedCorner { distance_mm: number; line: number; program: number; }

/** Start time of a block. */
export interface RehearsedLine { at_s: number; line: number; program: number; }

/** An M code of a planned run. */
export interface RehearsedMCode {
  at_s: number; line: number; m: number; program: number; wait_s: number | null; waits: boolean;
}

/** A highest value, its limit, and the block that causes it. */
export interface RehearsedPeak { limit: number; line: number; program: number; value: number; }

/** Progress of a run. */
export interface RehearsedRun { at_s: number; left_s: number | null; progress: number; }

/** An M code that a program issues before the line at which a run begins. */
export interface RestoredOutput { line: number; m: number; params: Params; program: number; }

/** A run of the loaded program, as in `cs/{n}/run`, `GET /runs/{id}` and `GET /runs`. */
export interface Run {
  alarms: RunAlarm[]; began: Timestamp; cs: number; end: RunEnded | null; from_line: number | null; hash: string | null;
  id: string; last_part_s: number | null; parts: number; parts_done: number; program: number; took_s: number;
  waits: RunWait[]; waits_for: string | null;
}

/** An alarm of a run. */
export interface RunAlarm { line: number | null; number: number; text: string; }

/** End of a run. */
export interface RunEnded { at: Timestamp; how: RunEndedHow; place: PlannedLocation | null; text: string; }

/** Kind of the end of a run. */
export type RunEndedHow = "completed" | "stopped" | "aborted" | "reset" | "alarm" | "lease_lost" | "replaced" | "refused" | "restarted";

/** Kind of a run. */
export type RunKind = "program" | "mdi" | "home" | "jog";

/** Response of `GET /runs`: runs that have ended, newest first, and production counters. */
export interface RunList { production: Production[]; runs: Run[]; }

/** Payload of `cs/{n}/run`. */
export interface RunStateMessage { boot_id: BootId; rev?: number; run: Run | null; ts: string; v: 1; }

/** First block whose path depends on events while the program runs. */
export interface RunTimeDependence { at_s: number; line: number; program: number; why: string; }

/** The waits of a run for one M code. */
export interface RunWait { count: number; longest_s: number; m: number; total_s: number; }

/** An M code that is served, and its handler. */
export interface ServedMCode {
  cs: number[]; handler_id: string | null; m: number; name?: string;
  params?: { A?: ParamDeclaration; B?: ParamDeclaration; C?: ParamDeclaration; D?: ParamDeclaration; E?: ParamDeclaration; F?: ParamDeclaration; G?: ParamDeclaration; H?: ParamDeclaration };
}

/** State of the broker that connects the machines. */
export type SharedBroker = "none" | "connecting" | "connected";

/** State of a program's signature. */
export type SignatureState = "valid" | "missing" | "wrong";

/** Rotation of a spindle. */
export type SpindleDirection = "cw" | "ccw" | "stop" | "orient";

/** Payload of `spindle/state`. */
export interface SpindleMessage {
  actual_rpm: number; boot_id: BootId; direction: SpindleDirection; oriented: boolean; rev?: number; rpm: number;
  ts: string; v: 1;
}

/** Payload of `cs/{n}/start_conditions`. */
export interface StartConditions { obstacles: StartObstacle[]; }

/** Payload of `cs/{n}/start_conditions`. */
export interface StartConditionsMessage { boot_id: BootId; obstacles: StartObstacle[]; rev?: number; ts: string; v: 1; }

/** One obstacle of a start. */
export interface StartObstacle {
  at: PlannedLocation | null; detail: string; kind: StartObstacleKind; m_codes: number[]; refuses: boolean;
  text: string;
}

/** Kind of an obstacle of a start. */
export type StartObstacleKind = "running" | "alarm" | "no_program" | "reset" | "interlock" | "start_lock" | "lease" | "program" | "m_code" | "prediction";

/** Payload of `state`. */
export interface State {
  alarm_count: number; dry_run: boolean; execution: Execution; hash: string | null; last_command_id: string | null;
  o_number: number | null; optional_skip: number[]; optional_stop: boolean; program: number | null;
  reason: Reason | null; run_id: string | null; run_kind: RunKind | null; single_block: boolean;
  transition: Transition | null; wait_state: string | null; waiting_on: WaitingOn | null;
}

/** Payload of `state`. */
export interface StateMessage {
  alarm_count: number; boot_id: BootId; dry_run: boolean; execution: Execution; hash: string | null;
  last_command_id: string | null; o_number: number | null; optional_skip: number[]; optional_stop: boolean;
  program: number | null; reason: Reason | null; rev?: number; run_id: string | null; run_kind: RunKind | null;
  single_block: boolean; transition: Transition | null; ts: string; v: 1; wait_state: string | null;
  waiting_on: WaitingOn | null;
}

/** Kind of inconsistency of a part of the stored data. */
export type StoredDataFault = "older" | "other_machine" | "not_verified";

/** A part of the stored data that is inconsistent with the other parts. */
export interface StoredDataFinding { fault: StoredDataFault; part: StoredDataPart; text: string; }

/** Payload of `stored_data`. */
export interface StoredDataMessage {
  boot_id: BootId; question: StoredDataQuestion | null; rev?: number; ts: string; v: 1;
}

/** A part of the stored data. */
export type StoredDataPart = "store" | "programs" | "folders" | "journal";

/** Stored files that are inconsistent. Until a person accepts or refuses them, their content is not used, and
 * no program starts. */
export interface StoredDataQuestion {
  findings: StoredDataFinding[]; newest_journal_entry: Timestamp | null; since: Timestamp;
}

/** Payload of an input with one value. */
export interface SwitchMessage { boot_id: BootId; rev?: number; ts: string; v: 1; value: boolean; }

/** Faults of a task or a thread since the start of the runtime. */
export interface TaskFault { consequence: Consequence; count: number; task: string; }

/** Payload of `cs/{n}/time_left`: remaining time of the program run in progress. */
export interface TimeLeftMessage {
  boot_id: BootId; left_s: number | null; plan: PlanIdentity | null; progress: number | null; rev?: number;
  run_id: string | null; ts: string; v: 1;
}

/** A time as RFC 3339 in UTC, such as `2026-01-31T12:00:00.250000Z`. */
export type Timestamp = string;

/** Time at which the machine issues an output (D30). */
export type Timing = "after_motion" | "with_motion";

/** A tool of the tool table: the dimensions that G41 to G44 use (D17). */
export interface ToolData { id: number; length: number; radius: number; }

/** Payload of `tool/state`. */
export interface ToolMessage { boot_id: BootId; id: number; rev?: number; ts: string; v: 1; }

/** The tool table, ascending by number: response of `GET /tools` and payload of `tools`. */
export interface ToolTable { tools: ToolData[]; }

/** The tool table, ascending by number: response of `GET /tools` and payload of `tools`. */
export interface ToolTableMessage { boot_id: BootId; rev?: number; tools: ToolData[]; ts: string; v: 1; }

/** Response of `GET /cs/{n}/trace`: samples of the last minute, in time order. */
export interface Trace {
  axes: Record<string, TraceAxis>; cs: number; feedrate: number[]; first: number; interval_s: number; next: number;
  now: Timestamp; now_s: number; spindle_rpm: number[]; time_s: number[];
}

/** Motion of one axis: a value for each sample; positions in mm or degrees. */
export interface TraceAxis {
  acceleration: number[]; following_error: number[]; position: number[]; velocity: number[];
}

/** Transition to another state. */
export type Transition = "STARTING" | "HOLDING" | "STOPPING" | "RESUMING" | "RESETTING";

/** Payload of `m_code/{m}/validate`: asks, when a program is loaded, whether this M code may be issued with
 * these parameters. */
export interface ValidateMessage {
  boot_id: BootId; line: number; params: Params; program: number; request_id: string; rev?: number; ts: string; v: 1;
}

/** Letter of the variables that are kept after the end of a program (manual 4-3). */
export type VariableKind = "P" | "Q";

/** Values of consecutive variables, all at the same moment: part of the reply to `variable/get`, and response
 * of `GET /variables/p`. */
export interface VariableValues { from: number; kind: VariableKind; values: Number[]; }

/** Verb of a command. */
export type Verb = "load" | "start" | "run" | "hold" | "resume" | "back_trace" | "stop" | "abort" | "reset" | "alarm_acknowledge" | "mdi" | "jog" | "home";

/** The output for which a program waits. */
export interface WaitingOn { m: number; progress?: Progress; question?: Question; seq: number; since: Timestamp; }

/** An error frame. */
export interface WebSocketError { code?: RefusalCode; error: string; }

/** The message of the topic, with its path in front; see the topic's channel for the other fields. */
export interface WebSocketMessage {
  boot_id: BootId; rev?: number; topic: string; ts: string; v: 1; [name: string]: unknown;
}

/** Work offsets of a coordinate system, mm or degrees: response of `GET /cs/{n}/work_offsets`. As the body of
 * `PUT` on this route the table is a change: offsets and axes that it does not contain do not change. The
 * machine applies the change completely or not at all. */
export interface WorkOffsetTable { work_offsets: Record<string, Record<string, number>>; }

/** Work offsets of a coordinate system, mm or degrees: payload of `cs/{cs}/work_offsets`. */
export interface WorkOffsetValuesMessage {
  boot_id: BootId; rev?: number; ts: string; v: 1; work_offsets: Record<string, Record<string, number>>;
}

/** The message of a topic, such as `cs/1/state`; for an unknown topic, any message. */
export type MessageOf<Topic extends string> =
  Topic extends `presence` ? PresenceMessage :
  Topic extends `birth` ? BirthMessage :
  Topic extends `heartbeat` ? HeartbeatMessage :
  Topic extends `alarm/event` ? AlarmRecordMessage :
  Topic extends `alarm/active` ? ActiveAlarmsMessage :
  Topic extends `reply/${string}` ? CommandReplyMessage :
  Topic extends `handler/${string}/result` ? HandlerResultMessage :
  Topic extends `io/in/${string}` ? IoStateMessage :
  Topic extends `io/out/${string}` ? IoStateMessage :
  Topic extends `variables` ? PublishedVariablesMessage :
  Topic extends `tools` ? ToolTableMessage :
  Topic extends `stored_data` ? StoredDataMessage :
  Topic extends `cs/${number}/state` ? StateMessage :
  Topic extends `cs/${number}/program` ? ProgramLocationMessage :
  Topic extends `cs/${number}/position` ? PositionMessage :
  Topic extends `cs/${number}/modal` ? ModalMessage :
  Topic extends `cs/${number}/m_code/pending` ? PendingMessage :
  Topic extends `cs/${number}/captured` ? CapturedPositionsMessage :
  Topic extends `cs/${number}/input/optional_skip/state` ? OptionalSkipMessage :
  Topic extends `cs/${number}/input/optional_stop/state` ? SwitchMessage :
  Topic extends `cs/${number}/input/single_block/state` ? SwitchMessage :
  Topic extends `cs/${number}/input/dry_run/state` ? SwitchMessage :
  Topic extends `cs/${number}/input/interlock/state` ? LockMessage :
  Topic extends `cs/${number}/input/start_lock/state` ? LockMessage :
  Topic extends `cs/${number}/spindle/state` ? SpindleMessage :
  Topic extends `cs/${number}/tool/state` ? ToolMessage :
  Topic extends `cs/${number}/override/state` ? OverridesMessage :
  Topic extends `cs/${number}/lease/state` ? LeaseStateMessage :
  Topic extends `cs/${number}/run` ? RunStateMessage :
  Topic extends `cs/${number}/time_left` ? TimeLeftMessage :
  Topic extends `cs/${number}/start_conditions` ? StartConditionsMessage :
  Topic extends `cs/${number}/variables` ? PublishedVariablesMessage :
  Topic extends `cs/${number}/work_offsets` ? WorkOffsetValuesMessage :
  Topic extends `cs/${number}/m_code/${number}/output` ? OutputNoticeMessage :
  Topic extends `cs/${number}/m_code/${number}/result` ? HandshakeResultMessage :
  Topic extends `cs/${number}/m_code/${number}/cancel` ? CancelMessage :
  Topic extends `cs/${number}/m_code/${number}/validate` ? ValidateMessage :
  WebSocketMessage;
