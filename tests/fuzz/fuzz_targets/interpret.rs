//! Interpreter: every text runs for a number of items without a panic, and ends or stops with an alarm.
#![no_main]

use std::collections::BTreeMap;
use std::sync::Arc;

use libfuzzer_sys::fuzz_target;
use tandem_interp::{Inputs, Interpreter};
use tandem_model::AxisVector;
use tandem_model::flow::Item;
use tandem_model::settings::{CoordinateSystemSettings, Tool, WorkOffsets};
use tandem_model::variables::{VariableArray, Variables};
use tandem_syntax::{Grammar, parse};

const ITEMS: usize = 200;

fuzz_target!(|data: &[u8]| {
    let text = String::from_utf8_lossy(data);
    let program = Arc::new(parse(text.as_ref(), Grammar::nj()).0);
    let programs = BTreeMap::from([(1000, Arc::clone(&program))]);
    let variables = Variables {
        global: VariableArray::new(64),
        coordinate_system: VariableArray::new(64),
    };
    let mut interpreter = Interpreter::new(&CoordinateSystemSettings {
        number: 1,
        motors: [const { None }; 8],
        spindle: None,
        max_feedrate_mm_min: 10_000.0,
        default_feedrate_mm_min: 0.0,
        default_ta_ms: 100.0,
        default_td_ms: 100.0,
        default_ts_ms: 50.0,
        rotary_feedrate_deg_min: 0.0,
        override_slew_ms: 1000.0,
        hold_slew_ms: 200.0,
        servo_period_s: 0.001,
    });
    interpreter.start(program, 1);
    for _ in 0..ITEMS {
        let item = interpreter.next(&Inputs {
            programs: &programs,
            optional_skip: 1,
            work_offsets: &WorkOffsets::default(),
            variables: &variables,
            tool: Tool::default(),
            captured: [0.0; 8],
            position: AxisVector::ZERO,
        });
        if matches!(item, Ok(Item::End(_)) | Err(_)) {
            break;
        }
    }
});
