// Sequence programs for Tandem, the PLC side of a CNC machine, over MQTT.

export { UserAlarm } from "./alarms.js";
export { CoordinateSystem, Run } from "./coordinate_system.js";
export {
  AddressError,
  Alarm,
  CommandFailed,
  ConnectError,
  NoAnswer,
  NotConnected,
  OutputEnded,
  ProgramError,
  RequestRefused,
  TakenOver,
  TandemError,
} from "./errors.js";
export { Io } from "./io.js";
export { Output } from "./output.js";
export { Params } from "./params.js";
export { Plc } from "./plc.js";
export { Level, SequenceProgram, Serving, stopSignal } from "./program.js";
