//! The function blocks of IEC 61131-3, implemented by those of `plc_api::function_blocks`.

use std::time::Duration;

use plc_api::function_blocks::{
    DownCounter, FallingEdge, OffDelay, OnDelay, Pulse, ResetDominant, RisingEdge, SetDominant, UpCounter,
    UpDownCounter,
};

use super::Direction::{Input, Output, OutputOn};
use super::{BuiltIn, Ports, ports};
use crate::machine::Machine;
use crate::state::State;
use crate::value::Value;

pub(super) static BLOCKS: &[BuiltIn] = &[
    BuiltIn {
        name: "R_TRIG",
        about: "on for one call after each rising edge",
        ports: ports! { Input, "CLK": Bool, "the input"; Output, "Q": Bool, "the edge"; },
        state: || State::RisingEdge(RisingEdge::default()),
        run: |ports, _| {
            let clk = ports.bool(0);
            if let Some(State::RisingEdge(edge)) = ports.state() {
                let q = edge.update(clk);
                ports.set_bool(1, q);
            }
        },
    },
    BuiltIn {
        name: "F_TRIG",
        about: "on for one call after each falling edge",
        ports: ports! { Input, "CLK": Bool, "the input"; Output, "Q": Bool, "the edge"; },
        state: || State::FallingEdge(FallingEdge::default()),
        run: |ports, _| {
            let clk = ports.bool(0);
            if let Some(State::FallingEdge(edge)) = ports.state() {
                let q = edge.update(clk);
                ports.set_bool(1, q);
            }
        },
    },
    BuiltIn {
        name: "SR",
        about: "a flag; set has priority over reset",
        ports: ports! { Input, "S1": Bool, "set"; Input, "R": Bool, "reset"; Output, "Q1": Bool, "the flag"; },
        state: || State::SetDominant(SetDominant::default()),
        run: |ports, _| {
            let (set, reset) = (ports.bool(0), ports.bool(1));
            if let Some(State::SetDominant(flag)) = ports.state() {
                let q = flag.update(set, reset);
                ports.set_bool(2, q);
            }
        },
    },
    BuiltIn {
        name: "RS",
        about: "a flag; reset has priority over set",
        ports: ports! { Input, "S": Bool, "set"; Input, "R1": Bool, "reset"; Output, "Q1": Bool, "the flag"; },
        state: || State::ResetDominant(ResetDominant::default()),
        run: |ports, _| {
            let (set, reset) = (ports.bool(0), ports.bool(1));
            if let Some(State::ResetDominant(flag)) = ports.state() {
                let q = flag.update(set, reset);
                ports.set_bool(2, q);
            }
        },
    },
    BuiltIn {
        name: "TON",
        about: "turns on after its input has been on for the preset time",
        ports: TIMER,
        state: || State::OnDelay(OnDelay::new(Duration::ZERO)),
        run: timer,
    },
    BuiltIn {
        name: "TOF",
        about: "turns off after its input has been off for the preset time",
        ports: TIMER,
        state: || State::OffDelay(OffDelay::new(Duration::ZERO)),
        run: timer,
    },
    BuiltIn {
        name: "TP",
        about: "is on for the preset time after its input turns on",
        ports: TIMER,
        state: || State::Pulse(Pulse::new(Duration::ZERO)),
        run: timer,
    },
    BuiltIn {
        name: "CTU",
        about: "counts up",
        ports: ports! {
            Input, "CU": Bool, "input whose rising edges are counted"; Input, "R": Bool, "sets the value to 0";
            Input, "PV": Lint, "the preset value"; OutputOn, "Q": Bool, "CV is at least PV"; Output, "CV": Lint, "the value";
        },
        state: || State::UpCounter(UpCounter::new(0)),
        run: |ports, _| {
            let (up, reset, preset) = (ports.bool(0), ports.bool(1), lint(ports, 2));
            if let Some(State::UpCounter(counter)) = ports.state() {
                counter.set_preset(preset);
                let (q, value) = (counter.update(up, reset), counter.value());
                ports.set_bool(3, q);
                ports.set_int(4, value);
            }
        },
    },
    BuiltIn {
        name: "CTD",
        about: "counts down",
        ports: ports! {
            Input, "CD": Bool, "input whose rising edges are counted"; Input, "LD": Bool, "sets the value to PV";
            Input, "PV": Lint, "the preset value"; OutputOn, "Q": Bool, "CV is 0 or less"; Output, "CV": Lint, "the value";
        },
        state: || State::DownCounter(DownCounter::new(0)),
        run: |ports, _| {
            let (down, load, preset) = (ports.bool(0), ports.bool(1), lint(ports, 2));
            if let Some(State::DownCounter(counter)) = ports.state() {
                counter.set_preset(preset);
                let (q, value) = (counter.update(down, load), counter.value());
                ports.set_bool(3, q);
                ports.set_int(4, value);
            }
        },
    },
    BuiltIn {
        name: "CTUD",
        about: "counts up and down",
        ports: ports! {
            Input, "CU": Bool, "input whose rising edges count up"; Input, "CD": Bool, "input whose rising edges count down";
            Input, "R": Bool, "sets the value to 0"; Input, "LD": Bool, "sets the value to PV";
            Input, "PV": Lint, "the preset value"; OutputOn, "QU": Bool, "CV is at least PV";
            OutputOn, "QD": Bool, "CV is 0 or less"; Output, "CV": Lint, "the value";
        },
        state: || State::UpDownCounter(UpDownCounter::new(0)),
        run: |ports, _| {
            let (up, down) = (ports.bool(0), ports.bool(1));
            let (reset, load, preset) = (ports.bool(2), ports.bool(3), lint(ports, 4));
            if let Some(State::UpDownCounter(counter)) = ports.state() {
                counter.set_preset(preset);
                counter.update(up, down, reset, load);
                let (q_up, q_down, value) = (counter.q_up(), counter.q_down(), counter.value());
                ports.set_bool(5, q_up);
                ports.set_bool(6, q_down);
                ports.set_int(7, value);
            }
        },
    },
];

const TIMER: &[super::Port] = ports! {
    Input, "IN": Bool, "the input"; Input, "PT": Time, "the preset time";
    Output, "Q": Bool, "the output"; Output, "ET": Time, "the elapsed time";
};

fn lint(ports: &Ports, port: usize) -> i64 {
    // the port is an LINT
    i64::try_from(ports.int(port)).unwrap_or_default()
}

fn timer(ports: &mut Ports, machine: &mut Machine) {
    let input = ports.bool(0);
    // a preset time below 0 is over at once
    let preset = Duration::from_nanos(u64::try_from(ports.int(1)).unwrap_or_default());
    let now = machine.image.now();
    let (q, elapsed) = match ports.state() {
        Some(State::OnDelay(timer)) => {
            timer.set_preset(preset);
            (timer.update(input, now), timer.elapsed())
        }
        Some(State::OffDelay(timer)) => {
            timer.set_preset(preset);
            (timer.update(input, now), timer.elapsed())
        }
        Some(State::Pulse(timer)) => {
            timer.set_preset(preset);
            (timer.update(input, now), timer.elapsed())
        }
        _ => return,
    };
    ports.set_bool(2, q);
    ports.set(
        3,
        Value::Int(i128::try_from(elapsed.as_nanos()).unwrap_or(i128::MAX)),
    );
}
