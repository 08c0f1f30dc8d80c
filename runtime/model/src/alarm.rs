//! The alarm table. An alarm stops its coordinate system; it has a number, and says what happened, where and why.

use std::fmt::Display;

use crate::span::Origin;

/// An alarm raised by the runtime itself.
#[derive(Debug, Clone, PartialEq)]
pub struct Alarm {
    /// Entry of the alarm table.
    pub entry: &'static AlarmEntry,
    /// What happened, with values.
    pub text: String,
    /// The block it belongs to.
    pub origin: Option<Origin>,
    /// Letters of the words to blame, as far as the block has them; empty: the block as a whole.
    pub words: String,
}

/// One line of the alarm table.
#[derive(Debug, PartialEq, Eq)]
pub struct AlarmEntry {
    /// 1 to 9999.
    pub number: u16,
    /// Its name.
    pub title: &'static str,
    /// What to do.
    pub remedy: &'static str,
}

impl Alarm {
    /// An alarm of this entry, without a place.
    pub fn new(entry: &'static AlarmEntry, text: impl Into<String>) -> Self {
        Self {
            entry,
            text: text.into(),
            origin: None,
            words: String::new(),
        }
    }

    /// The same alarm, with the letters of the words to blame: `IJ`.
    #[must_use]
    pub fn of_words(mut self, words: impl Into<String>) -> Self {
        self.words = words.into();
        self
    }

    /// The same alarm at a block.
    #[must_use]
    pub fn at(mut self, origin: Origin) -> Self {
        self.origin = Some(origin);
        self
    }
}

/// Checks a value; `name` begins the alarm's text: "The feedrate".
///
/// # Errors
/// `VALUE_NOT_FINITE` when it is not a finite number.
pub fn check_finite(name: impl Display, value: f64) -> Result<(), Alarm> {
    if value.is_finite() {
        return Ok(());
    }
    Err(Alarm::new(&VALUE_NOT_FINITE, format!("{name} is {value}")))
}

macro_rules! alarms {
    ($($name:ident = $number:literal, $title:literal, $remedy:literal;)*) => {
        $(#[doc = concat!("Alarm ", $number, ": ", $title, ".")]
        pub static $name: AlarmEntry = AlarmEntry { number: $number, title: $title, remedy: $remedy };)*

        /// All alarms, ascending by number.
        pub static ALARMS: &[&AlarmEntry] = &[$(&$name),*];
    };
}

alarms! {
    // 1 to 99: the program
    VALUE_NOT_FINITE = 10, "A word's value is not a number", "Look at the calculation that gives the value (D07).";
    VALUE_OUT_OF_RANGE = 11, "A word's value is out of its range", "Write a value within the range that the text names.";
    PROGRAM_NOT_FOUND = 20, "The program is not in the store", "Load the program, or correct its number.";
    STEP_LIMIT = 21, "The program makes no progress", "Look for a loop that neither moves nor waits.";
    PROGRAM_END_MISSING = 22, "The program ran past its last block", "End a main program with M30, a subprogram with M99.";
    PROGRAM_HAS_ERRORS = 23, "The program has an error", "Check the program, and correct what is found.";
    PROGRAM_WARNING = 30, "The program was not carried out as written", "Look at the line that the text names.";
    COMPENSATION_REFUSED = 40, "Not allowed with cutter compensation", "End the compensation with G40 before the block, and look at the rules of G41.";
    OFFSET_REFUSED = 41, "Not allowed with an offset of the tool", "Write G40 and G49 before G28, G30 and G53 (D23).";
    FIXED_CYCLE_REFUSED = 42, "Not allowed in a fixed cycle", "End the cycle with G80 before the block.";
    ARC_REFUSED = 43, "The arc cannot be made", "Look at I, J, K and R of the block (D26).";
    // 100 to 199: path and motion
    AXIS_MISSING = 100, "The coordinate system does not have this axis", "Remove the word, or assign a motor to the axis.";
    FEEDRATE_MISSING = 101, "No feedrate is programmed", "Write F before the first cutting block, or set default_feedrate.";
    SOFT_LIMIT = 102, "The target is beyond a soft limit", "Correct the position or the work offset; nothing has moved.";
    LIMIT_ZERO = 103, "A motor's velocity or acceleration limit is zero", "Set a limit above zero in the configuration.";
    OFFSET_IN_FORCE = 110, "Cutter compensation or a tool offset is on", "Cancel it with G40 or G49 before G53, G28 and G30 (D23).";
    ARC_IMPOSSIBLE = 111, "There is no such arc", "Correct the target, the centre (I, J, K) or the radius (R).";
    ARC_DISTORTED = 112, "The transforms in force leave no circle", "Scale both axes of the plane alike, and rotate in the arc's plane (D21).";
    SPINDLE_SPEED_MISSING = 113, "No spindle speed is programmed", "Write S before the tapping cycle: its pitch is F / S.";
    TAP_OFF_AXIS = 114, "The tap would leave the Z axis", "End the rotation with G69 before the tapping cycle.";
    COMPENSATION_LEAD_SHORT = 115, "The way into or out of cutter compensation is too short", "Lead in and out over at least the tool's radius.";
    COMPENSATION_ARC_SMALL = 116, "The tool does not fit into the arc", "Use a smaller tool, or replace the arc by a line.";
    COMPENSATION_CORNER = 117, "The compensated blocks do not meet", "Use a smaller tool, or look at the corner between the blocks.";
    COMPENSATION_SPIRAL = 118, "A spiral has no cutter compensation", "Write an arc with one radius, or raise arc_radius_tolerance if the difference is rounding.";
    COMPENSATION_LOOK_AHEAD = 119, "Too many blocks in a row without a move in the plane of the compensation", "Write G40 and a lead-out before them.";
    OVERCUT = 120, "The tool would cut into another block", "Use a smaller tool, change the blocks, or set overcut = \"prevent\".";
    // 200 to 299: servo
    IN_POSITION_TIMEOUT = 200, "A motor did not come into position in time", "Look at the drive, in_position and in_position_timeout_ms.";
    MOTION_RAN_OUT = 201, "The motion prepared ran out within a blended chain", "Reset; report the log if it happens again.";
    POSITION_JUMP = 202, "A motion does not begin where the machine is", "Reset; report the log if it happens again.";
    SPINDLE_MISSING = 203, "The coordinate system has no spindle", "Assign a spindle motor in the configuration.";
    SPINDLE_TURNS = 204, "The spindle does not rest where a thread begins", "Reset M19 when the spindle rests at its position.";
    DRIVE_FAULT = 205, "A drive reports a fault", "Look up the code in the drive's manual and remove the cause; reset clears the fault and enables the drives.";
    DRIVE_BUS_LOST = 206, "The bus to the drives is lost", "Look at cables, power and the load of the computer; reset enables the drives.";
    DRIVE_NOT_ENABLED = 207, "A drive has no power", "Look at the emergency stop, the drive's supply and its enable input; reset enables the drives.";
    MOTOR_NOT_HOMED = 208, "A motor does not know its position", "Home the motor by the drive's own means before it moves, or use an absolute encoder; then reset.";
    SERVO_LATE = 209, "The servo was late in motion", "Look at what stopped the runtime or kept the processor busy, and at the machine; then resume.";
    // 300 to 399: sequence control
    M_CODE_UNHANDLED = 300, "No handler is registered for this M code", "Connect a handler, or set unhandled for the M code.";
    M_CODE_TIMEOUT = 301, "The M code was not reset in time", "Look at the handler, or raise timeout_ms.";
    HANDLER_LOST = 302, "The handler of an M code has gone", "Start it again; then redeliver the M code, or reset it by hand, unless the handler goes on by itself.";
    REQUEST_REFUSED = 310, "A request from outside was refused", "Look at who sends it; the text says what is wrong with it.";
    // 390 to 499: runtime
    SIMULATION_STALLED = 390, "The program waits for something that never comes", "Look at what it waits for; give the M code a handler or unhandled = \"auto_reset\".";
    SIMULATION_LIMIT = 391, "The program did not end within the time limit", "Look for a loop, or raise --max-time-s.";
    RUNTIME_FAULT = 400, "The coordinate system's task failed", "Reset; report the log if it happens again.";
    RESTARTED_IN_RUN = 401, "The runtime ended while a program ran", "Look at the machine and at what was open before anything is started; acknowledge or reset.";
    STORE_FAILED = 402, "What is kept cannot be written", "Look at the disk of data_dir; it is tried again by itself.";
    JOURNAL_FAILED = 403, "The journal cannot be written", "Look at the folder journal of data_dir; it is tried again by itself, and the machine does not need it.";
    PROGRAMS_FAILED = 404, "Programs cannot be written", "Look at the folder programs of data_dir; it is tried again by itself.";
    DATA_FOLDER_FAILED = 405, "The data folder is gone, full or not writable", "Put the folder back or make room; it is looked at every second.";
    VALUES_LOST = 406, "Values that were kept are damaged and count as no values", "Write each of them anew, or stop the runtime and look at tandem store repair.";
    PROGRAM_DAMAGED = 407, "A program is damaged", "Store it again, or stop the runtime and look at tandem store repair.";
    PROGRAM_CHANGED = 408, "A program was changed outside of the runtime", "Look at the program, and load it again.";
    NOT_READ = 409, "Something in the data folder is not read", "Move it away, or give it the name and the form that the text says.";
    STORE_DAMAGED = 410, "The store was damaged, or cannot be verified", "Look at the disk; tandem store verify looks at all that is kept.";
    JOURNAL_DAMAGED = 411, "Lines of the journal are damaged", "Look at the disk; the machine does not need them.";
    VALUE_LOST = 412, "A value that the program needs is damaged and counts as no value", "Look at the machine and write the value anew; alarm 406 lists all of them.";
    CLIENT_LOST = 421, "A client that asked to be watched is not heard any more", "Look at the client and at its connection, and at the machine; then resume.";
    MESSAGES_NOT_KEPT = 422, "Retained messages of MQTT clients are not kept", "Clear topics of the embedded broker by empty retained messages; the text says which are full.";
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn alarm_numbers_are_unique_and_ascend() {
        assert!(ALARMS.windows(2).all(|pair| pair[0].number < pair[1].number));
        assert!(ALARMS.iter().all(|entry| (1..=9999).contains(&entry.number)));
    }
}
