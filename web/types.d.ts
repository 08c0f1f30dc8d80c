// Shapes of the interface, version 1: the messages of the WebSocket and the answers of REST, as plc-api's types say them.

export type Execution =
  | "READY" | "ACTIVE" | "WAIT" | "FEED_HOLD" | "PROGRAM_STOPPED" | "OPTIONAL_STOP" | "INTERRUPTED" | "STOPPED"
  | "PROGRAM_COMPLETED";

export type Reason =
  | "HANDLER_LOST" | "SINGLE_BLOCK" | "INTERLOCK" | "BUS_LOST" | "BACK_TRACE" | "BACK_TRACE_END" | "ALARM" | "STOP" | "ABORTED"
  | "NO_PROGRAM" | "RESTARTED";

export type Verb = "load" | "start" | "hold" | "resume" | "back_trace" | "stop" | "abort" | "reset" | "mdi" | "home";

export interface Envelope { v: number; boot_id: string; ts: string; rev?: number }

export interface Progress { text: string; percent?: number }

/** What a handler asks the operator. */
export interface Question { id: string; text: string; choices: string[]; since: string; answer?: string }

export interface WaitingOn { m: number; seq: number; since: string; progress?: Progress; question?: Question }

export interface State extends Envelope {
  execution: Execution;
  transition: "STARTING" | "HOLDING" | "STOPPING" | "RESUMING" | "RESETTING" | null;
  reason: Reason | null;
  wait_state: string | null;
  waiting_on: WaitingOn | null;
  program: number | null;
  run_id: string | null;
  single_block: boolean;
  dry_run: boolean;
  optional_stop: boolean;
  optional_skip: number[];
  alarm_count: number;
  last_command_id: string | null;
}

export interface ProgramPlace extends Envelope {
  number: number | null;
  nest_level: number;
  stack: { program: number; line: number }[];
  line: number;
  block: string;
  interpreted_line: number;
}

/** Axis letter to mm or degrees. */
export type AxisValues = Record<string, number>;

export interface Position extends Envelope {
  machine: AxisValues;
  work: AxisValues;
  distance_to_go: AxisValues;
  feedrate: number;
  spindle_rpm: number;
}

export interface Modal extends Envelope {
  g: Record<string, string>;
  f: number;
  s: number;
  tool: number;
  work_offset: string | null;
}

export interface PendingOutput {
  seq: number;
  run_id: string;
  m: number;
  params: Record<string, number>;
  timing: "after_motion" | "with_motion";
  program: number;
  line: number;
  attempt: number;
  redelivered: boolean;
  state: "QUEUED" | "OUTPUT" | "CLAIMED";
  handler_id: string | null;
  since: string;
  /** The handler that had it has gone. */
  lost: boolean;
  progress?: Progress;
  question?: Question;
  how?: "redo" | "verify";
}

export interface Pending extends Envelope { outputs: PendingOutput[] }
export interface Overrides extends Envelope { feed: number; rapid: number; spindle: number }
/** Who holds the control lease; all null: nobody does. */
export interface Lease extends Envelope { holder: string | null; fence: number | null; expires_at: string | null }
export interface Switch extends Envelope { value: boolean }
export interface Lock { value: boolean; text: string }
export interface LockInput extends Envelope, Lock {}
export interface OptionalSkip extends Envelope { requested: number[]; effective: number[]; effective_from_line: number }
export interface Presence extends Envelope { online: boolean; started_at: string; version: string }

export interface CoordinateSystemInfo {
  number: number;
  axes: Record<string, number>;
  spindle: number | null;
  dialect: string;
  units: string;
}

export interface MotorInfo {
  number: number;
  kind: "linear" | "rotary" | "spindle";
  soft_limits: [number, number] | null;
  max_velocity: number;
}

export interface Birth extends Envelope {
  machine: string;
  servo_period_us: number;
  coordinate_systems: CoordinateSystemInfo[];
  motors: MotorInfo[];
  m_codes: Record<string, { timing: string; timeout_ms: number | null; wait_state: string | null }>;
}

export interface Alarm {
  id: number;
  severity: "warning" | "alarm";
  number: number;
  text: string;
  remedy?: string | null;
  cs: number | null;
  program: number | null;
  line: number | null;
  column?: number;
  raised_at: string;
  cleared_at: string | null;
  acknowledged_by: string | null;
}

export interface ActiveAlarms extends Envelope { alarms: Alarm[] }

export interface ProgramInfo { number: number; title: string; bytes: number; errors: number; warnings: number }

export interface Diagnostic {
  code: string;
  severity: "error" | "warning";
  line: number;
  column: number;
  message: string;
  help: string;
}

/** The last run before this start of the runtime. */
export interface LastRun {
  run_id: string;
  program: number | null;
  running: number | null;
  line: number;
  execution: Execution;
  outputs: PendingOutput[];
  at: string;
}

/** A refusal as problem+json (RFC 9457). */
export interface Problem {
  title?: string;
  status?: number;
  detail?: string;
  code?: string;
  state?: Execution;
  allowed?: string[];
  diagnostics?: Diagnostic[];
}
