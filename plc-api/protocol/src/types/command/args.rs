//! Arguments of commands as JSON. Each verb with several forms of arguments has its own reader.

use serde::Deserialize;
use serde_json::Value;

use super::Command;
use crate::types::line_start::{Approach, LineStart};
use crate::types::run::{PARTS_MAX, RunOrder};

/// Largest number of characters of a `refresh_id`.
const REFRESH_ID_MAX: usize = 128;

/// Largest distance of a jog, mm or degrees.
const JOG_DISTANCE_MAX: f64 = 1_000_000.0;

/// Rejects arguments that are not an object, or that contain a name unknown to the verb.
pub(super) fn check_names(verb: &str, known: &[&str], args: &Value) -> Result<(), String> {
    let args = match args {
        Value::Null => return Ok(()),
        Value::Object(args) => args,
        _ => return Err(format!("{verb}: write its arguments as an object: {{...}}")),
    };
    let Some(unknown) = args.keys().find(|name| !known.contains(&name.as_str())) else {
        return Ok(());
    };
    Err(match known {
        [] => format!("{verb} takes no arguments; {unknown:.64?} is not known"),
        _ => format!(
            "{verb} has no argument {unknown:.64?}; it takes {}",
            known.join(", ")
        ),
    })
}

pub(super) fn axis(value: &Value) -> Option<char> {
    let mut letters = value.as_str()?.chars();
    letters.next().filter(|_| letters.next().is_none())
}

/// Reads the arguments of `run`: the program and the number of parts.
pub(super) fn run(args: &Value) -> Result<Command, String> {
    let given = |key: &str| args.get(key).filter(|value| !value.is_null());
    let program = given("program").map(|value| {
        let number = value.as_u64().and_then(|number| u16::try_from(number).ok());
        number.ok_or_else(|| {
            "run: \"program\" is a program number, 1 to 9999; without it, the loaded program runs".to_owned()
        })
    });
    let parts = given("parts").map_or(Some(1), |value| {
        let parts = value.as_u64().and_then(|parts| u32::try_from(parts).ok());
        parts.filter(|parts| (1..=PARTS_MAX).contains(parts))
    });
    Ok(Command::Run(RunOrder {
        program: program.transpose()?,
        parts: parts.ok_or_else(|| format!("run: \"parts\" is the number of parts, 1 to {PARTS_MAX}"))?,
    }))
}

/// Reads the arguments of `start`: the beginning of the program, or a line.
pub(super) fn start(args: &Value) -> Result<Command, String> {
    let given = |key: &str| args.get(key).filter(|value| !value.is_null());
    let number = |key: &str, of: &str| match given(key) {
        None => Ok(None),
        Some(value) => (value.as_u64())
            .and_then(|number| u32::try_from(number).ok().filter(|number| *number > 0))
            .map(Some)
            .ok_or_else(|| format!("start: \"{key}\" is {of}: a whole number from 1")),
    };
    let from_line = number("from_line", "the line of the first block")?;
    let program = number("program", "the program that contains the line")?;
    let occurrence = number("occurrence", "the number of the pass over the line")?;
    let wrong = "start: \"approach\" is plane_first, infeed_first or direct";
    let approach = given("approach").map(|value| Approach::deserialize(value).map_err(|_| wrong));
    let approach = approach.transpose()?;
    let Some(from_line) = from_line else {
        return match (program, occurrence, approach) {
            (None, None, None) => Ok(Command::Start),
            _ => Err("start: program, occurrence and approach go with \"from_line\"".to_owned()),
        };
    };
    let program = program.map(|number| {
        u16::try_from(number)
            .map_err(|_| format!("program {number} is not a program number; write 1 to 9999"))
    });
    Ok(Command::StartFrom(LineStart {
        from_line,
        program: program.transpose()?,
        occurrence,
        approach: approach.unwrap_or_default(),
    }))
}

pub(super) fn mdi(args: &Value) -> Result<Command, String> {
    let given = |key: &str| args.get(key).filter(|value| !value.is_null());
    let text = given("text").and_then(Value::as_str);
    let text = text
        .filter(|text| !text.trim().is_empty())
        .ok_or("mdi needs \"text\": one or several lines of a program")?;
    let is_macro = given("macro").map_or(Some(false), Value::as_bool);
    Ok(Command::Mdi {
        text: text.to_owned(),
        is_macro: is_macro.ok_or("mdi: \"macro\" is true to restore the modal state at its end, or false")?,
    })
}

pub(super) fn jog(args: &Value) -> Result<Command, String> {
    let given = |key: &str| args.get(key).filter(|value| !value.is_null());
    let needs_axis = "jog needs \"axis\": one letter";
    let needs_velocity = "jog needs \"velocity\": mm/min or deg/min, not 0; its sign is the direction";
    let refresh_id = args.get("refresh_id").and_then(Value::as_str).unwrap_or_default();
    if refresh_id.is_empty() || refresh_id.chars().count() > REFRESH_ID_MAX {
        let text = "jog needs \"refresh_id\", the name of this jog in its refreshes";
        return Err(format!("{text}: 1 to {REFRESH_ID_MAX} characters"));
    }
    let refresh_id = refresh_id.to_owned();
    let axis = given("axis")
        .map(|value| axis(value).ok_or(needs_axis))
        .transpose()?;
    let velocity = given("velocity")
        .map(|value| value.as_f64().ok_or(needs_velocity))
        .transpose()?;
    let distance = given("distance").map(|value| {
        (value
            .as_f64()
            .filter(|distance| *distance > 0.0 && *distance <= JOG_DISTANCE_MAX))
        .ok_or_else(|| format!("jog: \"distance\" is above 0 and at most {JOG_DISTANCE_MAX}"))
    });
    let distance = distance.transpose()?;
    let end = given("end").map(|value| {
        let wrong = "jog: \"end\" is true for the end of the jog that refresh_id names, or false";
        value.as_bool().ok_or(wrong)
    });
    if end.transpose()? == Some(true) {
        return Ok(Command::JogEnd { refresh_id });
    }
    Ok(Command::Jog {
        axis: axis.ok_or(needs_axis)?,
        velocity: velocity
            .filter(|velocity| *velocity != 0.0)
            .ok_or(needs_velocity)?,
        distance,
        refresh_id,
    })
}
