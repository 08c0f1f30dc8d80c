//! Function blocks that act on the machine.

use plc_api::Alarm;
use plc_api::function_blocks::RisingEdge;
use plc_protocol::types::command::Command;
use plc_protocol::types::io::{IoPoint, IoValue};
use plc_protocol::types::request::OverrideChange;
use plc_protocol::types::state::SpindleDirection;

use super::Direction::{Constant, Input, InputOr, Output};
use super::{BuiltIn, Direction, Ports, ports};
use crate::machine::{Lock, LockKind, Machine, system};
use crate::state::State;

const CS: Direction = Constant(1, 8, Some(1));
const M: Direction = Constant(1, 191, None);
const NOTHING: fn() -> State = || State::Nothing;

pub(super) static BLOCKS: &[BuiltIn] = &[
    BuiltIn {
        name: "MCODE",
        about: "serves one M code: the NC program waits for `Done` or `Error`",
        ports: ports! {
            M, "M": Uint, "the M number";
            CS, "CS": Usint, "the coordinate system";
            Input, "Done": Bool, "the M code is done: the NC program continues";
            Input, "Error": Bool, "the M code has failed: an alarm stops the NC program; has priority over `Done`";
            Input, "ErrorText": String, "text of the alarm, for the operator";
            Input, "ErrorCode": Uint, "the number of the alarm is 10000 plus this value; 0 selects the M number";
            InputOr(-1.0), "Progress": Lreal, "progress in percent; below 0: unknown";
            Input, "ProgressText": String, "present step, for the operator; empty: no progress is reported";
            Output, "Active": Bool, "the M code is output, and the NC program waits";
            Output, "A": Lreal, "parameter VA; 0 if not given";
            Output, "B": Lreal, "VB"; Output, "C": Lreal, "VC"; Output, "D": Lreal, "VD"; Output, "E": Lreal, "VE";
            Output, "F": Lreal, "VF"; Output, "G": Lreal, "VG"; Output, "H": Lreal, "VH";
            Output, "HasA": Bool, "the NC program has given VA";
            Output, "HasB": Bool, "VB"; Output, "HasC": Bool, "VC"; Output, "HasD": Bool, "VD"; Output, "HasE": Bool, "VE";
            Output, "HasF": Bool, "VF"; Output, "HasG": Bool, "VG"; Output, "HasH": Bool, "VH";
            Output, "Program": Uint, "number of the NC program";
            Output, "Line": Udint, "its line";
            Output, "Redelivered": Bool, "the M code was output before: a part of the work may be done";
        },
        state: || State::Progress(None),
        run: m_code,
    },
    BuiltIn {
        name: "QUESTION",
        about: "asks the operator a question about an M code that an `MCODE` serves",
        ports: ports! {
            M, "M": Uint, "the M number";
            CS, "CS": Usint, "the coordinate system";
            Input, "Ask": Bool, "the question is shown while this input is on and the M code is active";
            Input, "Text": String, "the question, 1 to 200 characters";
            Input, "Choice1": String, "an answer, 1 to 40 characters; empty answers are omitted";
            Input, "Choice2": String, "an answer"; Input, "Choice3": String, "an answer"; Input, "Choice4": String, "an answer";
            Output, "Answered": Bool, "the operator has answered";
            Output, "Answer": Usint, "number of the answer, 1 to 4; 0: no answer yet";
        },
        state: NOTHING,
        run: question,
    },
    BuiltIn {
        name: "INTERLOCK",
        about: "an interlock: while `On` is on, motion is held and no motion starts; a source is on while any of its instances is on",
        ports: LOCK,
        state: NOTHING,
        run: |ports, machine| lock(ports, machine, LockKind::Interlock),
    },
    BuiltIn {
        name: "START_LOCK",
        about: "a start lock: while `On` is on, no NC program starts; a source is on while any of its instances is on",
        ports: LOCK,
        state: NOTHING,
        run: |ports, machine| lock(ports, machine, LockKind::StartLock),
    },
    BuiltIn {
        name: "ALARM",
        about: "raises an alarm while `On` is on; the alarm stops the machine and stays until a reset",
        ports: ports! {
            Constant(1, 9_996, None), "Code": Uint, "the number of the alarm is 10000 plus this value";
            Constant(0, 8, Some(0)), "CS": Usint, "the coordinate system; 0: the whole machine";
            Input, "On": Bool, "the alarm is raised while this input is on";
            Input, "Text": String, "text of the alarm, for the operator";
        },
        state: NOTHING,
        run: |ports, machine| {
            // both are constants in these ranges
            let (code, cs) = (
                u16::try_from(ports.int(0)).unwrap_or_default(),
                system(&ports.slots[1]),
            );
            let level = (
                ports.bool(2),
                text_or(ports.text(3), "an alarm of the sequence program"),
            );
            machine
                .levels
                .alarm(Some(cs).filter(|cs| *cs != 0), code, ports.instance, level);
        },
    },
    BuiltIn {
        name: "OVERRIDE",
        about: "sets overrides, percent, in each call; an override with a value below 0 is not set",
        ports: ports! {
            CS, "CS": Usint, "the coordinate system";
            InputOr(-1.0), "Feed": Lreal, "0 to 200"; InputOr(-1.0), "Rapid": Lreal, "0 to 100";
            InputOr(-1.0), "Spindle": Lreal, "0 to 200";
        },
        state: NOTHING,
        run: |ports, machine| {
            let given = |port| Some(ports.real(port)).filter(|value| *value >= 0.0);
            let change = OverrideChange {
                feed: given(1),
                rapid: given(2),
                spindle: given(3),
            };
            if change != OverrideChange::default() {
                machine.image.set_overrides(system(&ports.slots[0]), change);
            }
        },
    },
    BuiltIn {
        name: "OPTIONAL_SKIP",
        about: "sets an optional block skip input in each call",
        ports: ports! {
            Constant(1, 31, None), "Number": Usint, "the input"; CS, "CS": Usint, "the coordinate system";
            Input, "On": Bool, "its value";
        },
        state: NOTHING,
        run: |ports, machine| {
            let number = u8::try_from(ports.int(0)).unwrap_or_default();
            machine
                .image
                .set_optional_skip(system(&ports.slots[1]), number, ports.bool(2));
        },
    },
    BuiltIn {
        name: "OPTIONAL_STOP",
        about: "sets the optional stop input (M01) in each call",
        ports: SWITCH,
        state: NOTHING,
        run: |ports, machine| {
            machine
                .image
                .set_optional_stop(system(&ports.slots[0]), ports.bool(1));
        },
    },
    BuiltIn {
        name: "SINGLE_BLOCK",
        about: "sets the single block input in each call",
        ports: SWITCH,
        state: NOTHING,
        run: |ports, machine| {
            machine
                .image
                .set_single_block(system(&ports.slots[0]), ports.bool(1));
        },
    },
    BuiltIn {
        name: "SKIP_INPUT",
        about: "sets the skip input of a motor (G31) in each call",
        ports: ports! { Input, "Motor": Uint, "its CNC motor number"; Input, "On": Bool, "its value"; },
        state: NOTHING,
        run: |ports, machine| {
            let motor = u16::try_from(ports.int(0)).unwrap_or_default();
            machine.image.set_skip_input(motor, ports.bool(1));
        },
    },
    BuiltIn {
        name: "SELECT_TOOL",
        about: "sets the tool in the spindle while `Enable` is on",
        ports: ports! {
            CS, "CS": Usint, "the coordinate system"; Input, "Enable": Bool, "true to set the tool";
            Input, "Tool": Uint, "number of the tool; 0: no tool";
        },
        state: NOTHING,
        run: |ports, machine| {
            if ports.bool(1) {
                let tool = u16::try_from(ports.int(2)).unwrap_or_default();
                machine.image.select_tool(system(&ports.slots[0]), tool);
            }
        },
    },
    BuiltIn {
        name: "SPINDLE",
        about: "commands the spindle while `Enable` is on; without a direction, the spindle stops",
        ports: ports! {
            CS, "CS": Usint, "the coordinate system"; Input, "Enable": Bool, "true to command the spindle";
            Input, "Clockwise": Bool, "as M03"; Input, "CounterClockwise": Bool, "as M04"; Input, "Orient": Bool, "as M19";
            Input, "Speed": Lreal, "r/min";
        },
        state: NOTHING,
        run: |ports, machine| {
            let direction = match (ports.bool(2), ports.bool(3), ports.bool(4)) {
                (true, false, false) => SpindleDirection::Cw,
                (false, true, false) => SpindleDirection::Ccw,
                (false, false, true) => SpindleDirection::Orient,
                _ => SpindleDirection::Stop,
            };
            if ports.bool(1) {
                machine
                    .image
                    .set_spindle(system(&ports.slots[0]), direction, ports.real(5));
            }
        },
    },
    BuiltIn {
        name: "IO_OUT",
        about: "writes an output of the plant in each call; the first call makes the program the writer of the output",
        ports: ports! {
            Input, "Name": String, "NAME of `[io.out.NAME]`"; Input, "On": Bool, "value of an output that is on or off";
            Input, "Number": Lreal, "value of an output that is a number";
            Output, "Valid": Bool, "the configuration declares the output"; Output, "Forced": Bool, "an operator has forced another value";
        },
        state: NOTHING,
        run: io_out,
    },
    BuiltIn {
        name: "CS_COMMAND",
        about: "commands a coordinate system; each command at the rising edge of its input",
        ports: ports! {
            CS, "CS": Usint, "the coordinate system";
            Input, "Load": Bool, "loads the NC program `Program`"; Input, "Start": Bool, "starts it"; Input, "Hold": Bool, "holds it";
            Input, "Resume": Bool, "resumes it"; Input, "Stop": Bool, "stops it"; Input, "Abort": Bool, "aborts it";
            Input, "Reset": Bool, "resets alarms, and sets the program to line 1"; Input, "Program": Uint, "1 to 9999";
        },
        state: || State::Edges([RisingEdge::default(); 7]),
        run: command,
    },
];

const LOCK: &[super::Port] = ports! {
    CS, "CS": Usint, "the coordinate system"; Input, "On": Bool, "its level"; Input, "Text": String, "reason, for the operator";
    Input, "Source": String, "source of the lock, such as NAME of `[input.interlock.source.NAME]`; empty: `default`";
};

const SWITCH: &[super::Port] = ports! {
    CS, "CS": Usint, "the coordinate system"; Input, "On": Bool, "its value";
};

fn text_or(text: &str, otherwise: &str) -> String {
    if text.is_empty() { otherwise } else { text }.to_owned()
}

fn lock(ports: &mut Ports, machine: &mut Machine, kind: LockKind) {
    let level = Lock {
        is_on: ports.bool(1),
        text: text_or(ports.text(2), "the sequence program has set it"),
        source: ports.text(3).to_owned(),
    };
    machine
        .levels
        .lock(kind, system(&ports.slots[0]), ports.instance, level);
}

fn m_code(ports: &mut Ports, machine: &mut Machine) {
    // the check has admitted only constants from 1 to 191 for M, and from 1 to 8 for CS
    let (m, cs) = (
        u16::try_from(ports.int(0)).unwrap_or_default(),
        system(&ports.slots[1]),
    );
    let output = machine.image.output(cs, m);
    let params = output.map(|output| *output.params()).unwrap_or_default();
    let place = output.map(|output| (output.program(), output.line(), output.redelivered()));
    ports.set_bool(8, output.is_some());
    let values = [
        params.a(),
        params.b(),
        params.c(),
        params.d(),
        params.e(),
        params.f(),
        params.g(),
        params.h(),
    ];
    for (number, value) in values.into_iter().enumerate() {
        ports.set_real(9 + number, value.unwrap_or(0.0));
        ports.set_bool(17 + number, value.is_some());
    }
    let (program, line, redelivered) = place.unwrap_or_default();
    ports.set_int(25, program);
    ports.set_int(26, line);
    ports.set_bool(27, redelivered);
    if ports.bool(3) {
        let code = match ports.int(5) {
            0 => m,
            code => u16::try_from(code).unwrap_or(u16::MAX),
        };
        let text = text_or(ports.text(4), &format!("M{m:02} has failed"));
        machine.image.fail(cs, m, Alarm::user(code, text));
    } else if ports.bool(2) {
        machine.image.reset(cs, m);
    } else {
        progress(ports, machine, cs, m);
    }
}

/// Reports changed progress.
fn progress(ports: &mut Ports, machine: &mut Machine, cs: u8, m: u16) {
    let is_active = ports.bool(8) && !ports.text(7).is_empty();
    let now = is_active.then(|| (ports.text(7).to_owned(), ports.real(6)));
    let Some(State::Progress(told)) = ports.state() else {
        return;
    };
    if *told != now {
        if let Some((text, percent)) = now.clone() {
            let percent = Some(percent.min(100.0)).filter(|percent| *percent >= 0.0);
            machine.image.progress(cs, m, text, percent);
        }
        *told = now;
    }
}

fn question(ports: &mut Ports, machine: &mut Machine) {
    let (m, cs) = (
        u16::try_from(ports.int(0)).unwrap_or_default(),
        system(&ports.slots[1]),
    );
    let mut answer = 0;
    if ports.bool(2) {
        let choices: Vec<String> = (4..8).map(|port| ports.text(port).to_owned()).collect();
        let offered = choices.iter().filter(|choice| !choice.is_empty()).cloned();
        if let Some(said) = machine.image.ask(cs, m, ports.text(3), offered) {
            answer = choices
                .iter()
                .position(|choice| *choice == said)
                .map_or(0, |place| place + 1);
        }
    }
    ports.set_bool(8, answer > 0);
    ports.set_int(9, u8::try_from(answer).unwrap_or_default());
}

fn io_out(ports: &mut Ports, machine: &mut Machine) {
    let name = ports.text(0);
    let state = machine.image.io(&IoPoint::output(name));
    let (kind, is_forced) = (
        state.map(|state| state.value),
        state.is_some_and(|state| state.forced.is_some()),
    );
    match kind {
        Some(IoValue::Bool(_)) => machine.image.set_io_out(name, ports.bool(1)),
        Some(IoValue::Number(_)) => machine.image.set_io_out(name, ports.real(2)),
        None => {}
    }
    ports.set_bool(3, kind.is_some());
    ports.set_bool(4, is_forced);
}

fn command(ports: &mut Ports, machine: &mut Machine) {
    let program = u16::try_from(ports.int(8)).unwrap_or_default();
    let wanted: [bool; 7] = std::array::from_fn(|place| ports.bool(1 + place));
    let cs = system(&ports.slots[0]);
    let Some(State::Edges(edges)) = ports.state() else {
        return;
    };
    let commands = [
        Command::Load { program },
        Command::Start,
        Command::Hold,
        Command::Resume,
        Command::Stop,
        Command::Abort,
        Command::Reset,
    ];
    for ((edge, wanted), command) in edges.iter_mut().zip(wanted).zip(commands) {
        if edge.update(wanted) {
            machine.image.command(cs, command);
        }
    }
}
