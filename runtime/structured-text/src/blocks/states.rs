//! Function blocks that show the state of the machine before the scan.

use plc_api::Execution;
use plc_protocol::types::io::{IoPoint, IoValue};
use plc_protocol::types::state::SpindleDirection;

use super::Direction::{Constant, Input, Output};
use super::{BuiltIn, Direction, Ports, ports};
use crate::machine::{Machine, system};
use crate::state::State;

const CS: Direction = Constant(1, 8, Some(1));
const NOTHING: fn() -> State = || State::Nothing;

pub(super) static BLOCKS: &[BuiltIn] = &[
    BuiltIn {
        name: "CS_STATE",
        about: "the state of a coordinate system",
        ports: ports! {
            CS, "CS": Usint, "the coordinate system";
            Output, "State": String, "the state word, such as `ACTIVE`; empty before the machine has reported the state";
            Output, "Ready": Bool, "READY"; Output, "Active": Bool, "ACTIVE"; Output, "Wait": Bool, "WAIT";
            Output, "FeedHold": Bool, "FEED_HOLD"; Output, "ProgramStopped": Bool, "PROGRAM_STOPPED (M00)";
            Output, "OptionalStopped": Bool, "OPTIONAL_STOP (M01)"; Output, "Interrupted": Bool, "INTERRUPTED";
            Output, "Stopped": Bool, "STOPPED"; Output, "ProgramCompleted": Bool, "PROGRAM_COMPLETED";
            Output, "Program": Uint, "the loaded NC program; 0: no program"; Output, "Alarms": Udint, "number of active alarms";
            Output, "SingleBlock": Bool, "the single block input"; Output, "DryRun": Bool, "the dry run input";
            Output, "OptionalStop": Bool, "the optional stop input"; Output, "Interlock": Bool, "the interlock";
            Output, "StartLock": Bool, "the start lock";
            Output, "FeedOverride": Lreal, "percent"; Output, "RapidOverride": Lreal, "percent";
            Output, "SpindleOverride": Lreal, "percent"; Output, "Tool": Uint, "tool in the spindle; 0: no tool";
            Output, "SpindleSpeed": Lreal, "commanded speed, r/min; below 0 counter-clockwise";
        },
        state: NOTHING,
        run: cs_state,
    },
    BuiltIn {
        name: "POSITION",
        about: "the position of an axis",
        ports: ports! {
            CS, "CS": Usint, "the coordinate system"; Input, "Axis": String, "its letter";
            Output, "Valid": Bool, "the machine has reported the position"; Output, "Machine": Lreal, "commanded machine position, mm or degrees";
            Output, "Work": Lreal, "commanded position in work coordinates"; Output, "Actual": Lreal, "actual machine position";
            Output, "Feedrate": Lreal, "feedrate on the path, mm/min"; Output, "SpindleSpeed": Lreal, "actual speed, r/min; below 0 counter-clockwise";
        },
        state: NOTHING,
        run: position,
    },
    BuiltIn {
        name: "CAPTURED",
        about: "the position that the last G31 has captured",
        ports: ports! {
            CS, "CS": Usint, "the coordinate system"; Input, "Motor": Uint, "its CNC motor number";
            Output, "Valid": Bool, "a G31 has moved this motor"; Output, "Captured": Bool, "the skip input has turned on";
            Output, "Position": Lreal, "captured machine position, mm or degrees"; Output, "Line": Udint, "the line of the G31";
        },
        state: NOTHING,
        run: captured,
    },
    BuiltIn {
        name: "IO_IN",
        about: "an input of the plant",
        ports: ports! {
            Input, "Name": String, "NAME of `[io.in.NAME]`";
            Output, "On": Bool, "value of an input that is on or off"; Output, "Number": Lreal, "value of an input that is a number";
            Output, "Valid": Bool, "the configuration declares the input";
            Output, "Lost": Bool, "the writer of the input is lost, and the input has its safe value";
            Output, "Forced": Bool, "an operator has forced another value";
        },
        state: NOTHING,
        run: io_in,
    },
    BuiltIn {
        name: "ALARM_STATE",
        about: "the active alarms of the machine",
        ports: ports! {
            Output, "Count": Udint, "number of active alarms"; Output, "Number": Uint, "number of the first; 0: no alarm"; Output, "Text": String, "text of the first";
        },
        state: NOTHING,
        run: |ports, machine| {
            let alarms = machine.image.alarms();
            let first = alarms
                .first()
                .map(|alarm| (alarm.number, alarm.text.as_str()))
                .unwrap_or_default();
            ports.set_int(0, u32::try_from(alarms.len()).unwrap_or(u32::MAX));
            ports.set_int(1, first.0);
            ports.set_text(2, first.1);
        },
    },
    BuiltIn {
        name: "SCAN_STATE",
        about: "the scan itself",
        ports: ports! {
            Output, "First": Bool, "true in the first scan"; Output, "Count": Ulint, "number of scans before this one";
            Output, "Time": Time, "the machine's clock"; Output, "LastTime": Time, "duration of the scan before";
            Output, "LongestTime": Time, "duration of the longest scan"; Output, "Late": Ulint, "number of scans that took longer than the period";
            Output, "Overruns": Ulint, "number of omitted periods"; Output, "Refusals": Udint, "number of writes of the scan before that the machine rejected";
            Output, "RefusalText": String, "text of the first rejection";
        },
        state: NOTHING,
        run: scan_state,
    },
];

/// State words, in the order of their outputs.
const WORDS: [(Execution, &str); 9] = [
    (Execution::Ready, "READY"),
    (Execution::Active, "ACTIVE"),
    (Execution::Wait, "WAIT"),
    (Execution::FeedHold, "FEED_HOLD"),
    (Execution::ProgramStopped, "PROGRAM_STOPPED"),
    (Execution::OptionalStop, "OPTIONAL_STOP"),
    (Execution::Interrupted, "INTERRUPTED"),
    (Execution::Stopped, "STOPPED"),
    (Execution::ProgramCompleted, "PROGRAM_COMPLETED"),
];

fn cs_state(ports: &mut Ports, machine: &mut Machine) {
    let (cs, image) = (system(&ports.slots[0]), &*machine.image);
    let state = image.state(cs);
    let execution = state.map(|state| state.execution);
    let mut word = "";
    for (place, (of, text)) in WORDS.into_iter().enumerate() {
        ports.set_bool(2 + place, execution == Some(of));
        if execution == Some(of) {
            word = text;
        }
    }
    ports.set_text(1, word);
    ports.set_int(11, state.and_then(|state| state.program).unwrap_or(0));
    ports.set_int(12, state.map_or(0, |state| state.alarm_count));
    ports.set_bool(13, image.is_single_block(cs));
    ports.set_bool(14, image.is_dry_run(cs));
    ports.set_bool(15, image.is_optional_stop(cs));
    ports.set_bool(16, image.interlock(cs).is_some_and(|lock| lock.value));
    ports.set_bool(17, image.start_lock(cs).is_some_and(|lock| lock.value));
    let overrides = image.overrides(cs).copied().unwrap_or_default();
    ports.set_real(18, overrides.feed);
    ports.set_real(19, overrides.rapid);
    ports.set_real(20, overrides.spindle);
    ports.set_int(21, image.tool(cs).unwrap_or(0));
    let spindle = image.spindle(cs).copied().unwrap_or_default();
    let speed = match spindle.direction {
        SpindleDirection::Cw => spindle.rpm,
        SpindleDirection::Ccw => -spindle.rpm,
        SpindleDirection::Stop | SpindleDirection::Orient => 0.0,
    };
    ports.set_real(22, speed);
}

fn position(ports: &mut Ports, machine: &mut Machine) {
    let axis = ports.text(1).to_ascii_uppercase();
    let position = machine.image.position(system(&ports.slots[0]));
    let of = |values: &std::collections::BTreeMap<String, f64>| values.get(&axis).copied().unwrap_or(0.0);
    ports.set_bool(
        2,
        position.is_some_and(|position| position.machine.contains_key(&axis)),
    );
    ports.set_real(3, position.map_or(0.0, |position| of(&position.machine)));
    ports.set_real(4, position.map_or(0.0, |position| of(&position.work)));
    ports.set_real(5, position.map_or(0.0, |position| of(&position.actual)));
    ports.set_real(6, position.map_or(0.0, |position| position.feedrate));
    ports.set_real(7, position.map_or(0.0, |position| position.spindle_rpm));
}

fn captured(ports: &mut Ports, machine: &mut Machine) {
    let motor = ports.int(1);
    let captured = machine.image.captured(system(&ports.slots[0]));
    let place = captured.and_then(|captured| captured.motors.iter().position(|of| i128::from(*of) == motor));
    let found = captured.zip(place);
    ports.set_bool(2, found.is_some());
    let has_come = found.and_then(|(captured, place)| captured.captured.get(place).copied());
    ports.set_bool(3, has_come.unwrap_or(false));
    let position = found.and_then(|(captured, place)| captured.positions.get(place).copied());
    ports.set_real(4, position.unwrap_or(0.0));
    ports.set_int(5, found.map_or(0, |(captured, _)| captured.line));
}

fn io_in(ports: &mut Ports, machine: &mut Machine) {
    let state = machine.image.io(&IoPoint::input(ports.text(0)));
    let value = state.map(|state| state.value);
    ports.set_bool(1, value.is_some_and(IoValue::is_on));
    ports.set_real(2, value.and_then(IoValue::as_number).unwrap_or(0.0));
    ports.set_bool(3, value.is_some());
    ports.set_bool(4, state.is_some_and(|state| state.lost));
    ports.set_bool(5, state.is_some_and(|state| state.forced.is_some()));
}

fn scan_state(ports: &mut Ports, machine: &mut Machine) {
    let image = &*machine.image;
    #[expect(clippy::cast_possible_truncation, reason = "it saturates")]
    let ns = |time_s: f64| (time_s * 1e9) as i64;
    ports.set_bool(0, image.scans() == 0);
    ports.set_int(1, image.scans());
    ports.set_int(2, i64::try_from(image.now().as_nanos()).unwrap_or(i64::MAX));
    ports.set_int(3, ns(image.last_scan_s()));
    ports.set_int(4, ns(image.longest_scan_s()));
    ports.set_int(5, image.late_scans());
    ports.set_int(6, image.overruns());
    ports.set_int(7, u32::try_from(image.refusals().len()).unwrap_or(u32::MAX));
    let first = image
        .refusals()
        .first()
        .map(ToString::to_string)
        .unwrap_or_default();
    ports.set_text(8, &first);
}
