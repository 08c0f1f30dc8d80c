//! The alarm table. An alarm stops its coordinate system. It has a number, and a text on what happened, where and why.

use std::fmt::Display;

use crate::span::Origin;

/// An alarm raised by the runtime itself.
#[derive(Debug, Clone, PartialEq)]
pub struct Alarm {
    /// Entry of the alarm table.
    pub entry: &'static AlarmEntry,
    /// Description of the event, with values.
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
    /// Effect on the program after the alarm.
    pub after: After,
    /// Its causes.
    pub cause: &'static str,
    /// Its remedies.
    pub remedy: &'static str,
}

/// How the machine continues after an alarm.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum After {
    /// It has stopped its coordinate system.
    Reset,
    /// The run is held.
    Held,
    /// The program waits for an output.
    Lost,
    /// Nothing has stopped, and it happened once.
    Notice,
    /// Nothing has stopped, and it lasts.
    Standing,
    /// The coordinate system has stopped, and continues only after a restart of the runtime.
    Restart,
    /// A simulation has ended.
    Simulated,
}

impl After {
    /// In words.
    pub const fn text(self) -> &'static str {
        match self {
            After::Reset => {
                "The coordinate system has stopped and its outputs are cancelled. When the cause is removed, reset clears \
                 the alarm, and start runs the program from its head."
            }
            After::Held => {
                "The run is held on its path, and nothing is lost. When the machine is in order, acknowledge the alarm and \
                 resume."
            }
            After::Lost => {
                "The program waits for its output (WAIT, HANDLER_LOST). It goes on when the output is reset; stop ends the \
                 run."
            }
            After::Notice => "Nothing has stopped. Acknowledging takes it off the list.",
            After::Standing => {
                "Nothing has stopped. It is looked at again and again, and ends when its cause is gone; acknowledging takes \
                 it off the list."
            }
            After::Restart => {
                "Motion has stopped and outputs are cancelled. No reset clears the alarm; hold, stop and abort still answer. \
                 After a restart of the runtime the alarm is cleared."
            }
            After::Simulated => "The simulation has ended there; a machine would have waited on.",
        }
    }
}

impl Alarm {
    /// Creates an alarm of this entry, without a place.
    pub fn new(entry: &'static AlarmEntry, text: impl Into<String>) -> Self {
        Self {
            entry,
            text: text.into(),
            origin: None,
            words: String::new(),
        }
    }

    /// Adds the letters of the words that cause the alarm: `IJ`.
    #[must_use]
    pub fn of_words(mut self, words: impl Into<String>) -> Self {
        self.words = words.into();
        self
    }

    /// Adds the block of the alarm.
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
    ($($name:ident = $number:literal, $after:ident, $title:literal, $cause:literal, $remedy:literal;)*) => {
        $(#[doc = concat!("Alarm ", $number, ": ", $title, ".")]
        pub static $name: AlarmEntry = AlarmEntry {
            number: $number, title: $title, after: After::$after, cause: $cause, remedy: $remedy,
        };)*

        /// All alarms, ascending by number.
        pub static ALARMS: &[&AlarmEntry] = &[$(&$name),*];
    };
}

alarms! {
    // 1 to 99: the program
    VALUE_NOT_FINITE = 10, Reset, "A word's value is not a number",
        "A calculation or variable gives no finite number: an argument outside of a function's domain, a division by 0, or a value that is lost.",
        "Look at the calculation that gives the value (D07).";
    VALUE_OUT_OF_RANGE = 11, Reset, "A word's value is out of its range",
        "A value that is calculated or read while the program runs is beyond the limits of its word; one in the text is found before.",
        "Write a value within the range that the text names.";
    PROGRAM_NOT_FOUND = 20, Reset, "The program is not in the store",
        "A program that is started, or that M98 calls, is not there under its number.",
        "Load the program, or correct its number.";
    STEP_LIMIT = 21, Reset, "The program makes no progress",
        "Blocks follow each other without end, and none of them moves, rests, outputs or waits: mostly a loop whose condition never changes.",
        "Look for a loop that neither moves, waits nor reads P or Q, or raise blocks_without_motion_max.";
    PROGRAM_END_MISSING = 22, Reset, "The program ran past its last block",
        "The last block is carried out and was no M02, M30 or M99: it is missing, or was passed over by a block skip or a jump.",
        "End a main program with M30, a subprogram with M99.";
    PROGRAM_HAS_ERRORS = 23, Reset, "The program has an error",
        "A block that is reached has an error that a check of the program finds, too; nothing of it is carried out.",
        "Check the program, and correct what is found.";
    PROGRAM_REFUSED = 24, Reset, "The program may not be called here",
        "A computed call has come to a program that this coordinate system may not run: it is of another dialect, or not signed as the machine demands.",
        "Do what the text says to the program that is called, and load the program again.";
    TOOL_DIFFERS = 25, Reset, "The tool in the spindle is not that of the line",
        "A run from a line has put out the M codes that its state needs, and another tool is in the spindle than the program has there.",
        "Look at what the tool change has done; bring the tool into the spindle, tell the runtime so, and start from the line again.";
    PROGRAM_WARNING = 30, Notice, "The program was not carried out as written",
        "A word has no effect as things are, or a value was limited to what the machine can do.",
        "Look at the line that the text names.";
    COMPENSATION_REFUSED = 40, Reset, "Not allowed with cutter compensation",
        "While cutter compensation is on, the block needs the end of the one before, or moves in a way that has no compensated path.",
        "End the compensation with G40 before the block, and look at the rules of G41.";
    OFFSET_REFUSED = 41, Reset, "Not allowed with an offset of the tool",
        "The block moves to a place of the machine (G28, G30, G53), which offsets of the tool would shift.",
        "Write G40 before G28, G30 and G53, and G49 with G90 and a motion to a free Z: under G91 Z comes down by the offset (D23).";
    FIXED_CYCLE_REFUSED = 42, Reset, "Not allowed in a fixed cycle",
        "Between the first block of a fixed cycle and its end stands a code that is neither a position of the cycle nor its end.",
        "End the cycle with G80 before the block.";
    ARC_REFUSED = 43, Reset, "The arc cannot be made",
        "No circle goes through both ends: the centre or the radius does not fit the way, or the arc has neither.",
        "Look at I, J, K and R of the block (D26).";
    // 100 to 199: path and motion
    AXIS_MISSING = 100, Reset, "The coordinate system does not have this axis",
        "A word names an axis that no motor of the coordinate system has.",
        "Remove the word, or assign a motor to the axis.";
    FEEDRATE_MISSING = 101, Reset, "No feedrate is programmed",
        "A block cuts before any F, and the configuration has no default_feedrate.",
        "Write F before the first cutting block, or set default_feedrate.";
    SOFT_LIMIT = 102, Reset, "The target is beyond a soft limit",
        "The target, or a point of an arc, lies beyond a soft limit of its motor, mostly by a wrong work offset, tool length or sign.",
        "Correct the position or the work offset; nothing has moved.";
    LIMIT_ZERO = 103, Reset, "A motor's velocity or acceleration limit is zero",
        "The motor would never arrive: its maximum velocity or acceleration is 0.",
        "Set a limit above zero in the configuration.";
    OFFSET_IN_FORCE = 110, Reset, "Cutter compensation or a tool offset is on",
        "Cutter compensation or a tool offset is still in force where the machine's own positions count.",
        "Cancel it before G53, G28 and G30: with G40, or with G49, G90 and a motion to a free Z (D23).";
    ARC_IMPOSSIBLE = 111, Reset, "There is no such arc",
        "Start, target, centre and radius do not belong to one circle, within arc_radius_tolerance.",
        "Correct the target, the centre (I, J, K) or the radius (R).";
    ARC_DISTORTED = 112, Reset, "The transforms in force leave no circle",
        "Scaling or rotation in force would make an ellipse, or turn the arc out of its plane.",
        "Scale both axes of the plane alike, and rotate in the arc's plane (D21).";
    SPINDLE_SPEED_MISSING = 113, Reset, "No spindle speed is programmed",
        "A tapping cycle begins and S is 0 or was never programmed.",
        "Write S before the tapping cycle: its pitch is F / S.";
    TAP_OFF_AXIS = 114, Reset, "The tap would leave the Z axis",
        "A rotation in force turns the tap's way out of the Z axis.",
        "End the rotation with G69 before the tapping cycle.";
    COMPENSATION_LEAD_SHORT = 115, Reset, "The way into or out of cutter compensation is too short",
        "The block that switches compensation on or off is shorter than the radius of the tool.",
        "Lead in and out over at least the tool's radius.";
    COMPENSATION_ARC_SMALL = 116, Reset, "The tool does not fit into the arc",
        "The radius of the tool is larger than that of an arc that it runs inside of.",
        "Use a smaller tool, or replace the arc by a line.";
    COMPENSATION_CORNER = 117, Reset, "The compensated blocks do not meet",
        "Moved aside by the radius of the tool, two blocks have no common point: mostly one is shorter than the radius.",
        "Use a smaller tool, or look at the corner between the blocks.";
    COMPENSATION_SPIRAL = 118, Reset, "A spiral has no cutter compensation",
        "The arc has different radii at its begin and its end.",
        "Write an arc with one radius, or raise arc_radius_tolerance if the difference is rounding.";
    COMPENSATION_LOOK_AHEAD = 119, Reset, "Too many blocks in a row without a move in the plane of the compensation",
        "Compensation reads ahead to the next move in its plane, and so many blocks in a row have none.",
        "Write G40 and a lead-out before them.";
    OVERCUT = 120, Reset, "The tool would cut into another block",
        "The way of the tool, moved aside by its radius, crosses another block: the contour is narrower there than the tool.",
        "Use a smaller tool, change the blocks, or set overcut = \"prevent\".";
    // 200 to 299: servo
    IN_POSITION_TIMEOUT = 200, Reset, "A motor did not come into position in time",
        "The motor has not come within in_position of its target: it is blocked, its following error is too large, or the tolerance too small.",
        "Look at the drive, in_position and in_position_timeout_ms.";
    MOTION_RAN_OUT = 201, Reset, "The motion prepared ran out within a blended chain",
        "The servo had no further block within a blended chain: an error of the runtime.",
        "Reset; report the log if it happens again.";
    POSITION_JUMP = 202, Reset, "A motion does not begin where the machine is",
        "The plan does not begin where the motors are: an error of the runtime, or motors that were moved meanwhile.",
        "Reset; report the log if it happens again.";
    SPINDLE_MISSING = 203, Reset, "The coordinate system has no spindle",
        "The program turns a spindle, or cuts a thread with one, and none is assigned.",
        "Assign a spindle motor in the configuration.";
    SPINDLE_TURNS = 204, Reset, "The spindle does not rest where a thread begins",
        "The spindle still turned, or was away from its position, when M19 was reset.",
        "Reset M19 when the spindle rests at its position.";
    DRIVE_FAULT = 205, Reset, "A drive reports a fault",
        "The drive itself has reported a fault; its code is in the text.",
        "Look up the code in the drive's manual and remove the cause; reset clears the fault and enables the drives.";
    DRIVE_BUS_LOST = 206, Reset, "The bus to the drives is lost",
        "More frames of the bus in a row were lost than the drives may miss.",
        "Look at cables, power and the load of the computer; reset enables the drives.";
    DRIVE_NOT_ENABLED = 207, Reset, "A drive has no power",
        "The drive does not say that it is enabled: an emergency stop, a missing supply, or an enable input that is off.",
        "Look at the emergency stop, the drive's supply and its enable input; reset enables the drives.";
    MOTOR_NOT_HOMED = 208, Reset, "A motor does not know its position",
        "The drive has no absolute position, and has not been homed since it was switched on.",
        "Home the motor by the drive's own means before it moves, or use an absolute encoder; then reset.";
    SERVO_LATE = 209, Held, "The servo was late in motion",
        "The servo thread was kept from its period for longer than servo_late_ms while motors moved.",
        "Look at what stopped the runtime or kept the processor busy, and at the machine; then resume.";
    // 300 to 399: sequence control
    M_CODE_UNHANDLED = 300, Reset, "No handler is registered for this M code",
        "The program has put out an M code that no handler serves, and unhandled is not auto_reset.",
        "Connect a handler, or set unhandled for the M code.";
    M_CODE_TIMEOUT = 301, Reset, "The M code was not reset in time",
        "The output was open for longer than timeout_ms: its handler is slow or stuck, or its message was lost.",
        "Look at the handler, or raise timeout_ms.";
    HANDLER_LOST = 302, Lost, "The handler of an M code has gone",
        "The connection of the handler that owned the output has ended, or its program has.",
        "Start it again; then redeliver the M code, or reset it by hand, unless the handler goes on by itself.";
    REQUEST_REFUSED = 310, Notice, "A request from outside was refused",
        "A message that came in was not well-formed, not allowed, or came with the retain flag.",
        "Look at who sends it; the text says what is wrong with it.";
    // 390 to 499: runtime
    SIMULATION_STALLED = 390, Simulated, "The program waits for something that never comes",
        "Nothing moves and nobody will act any more, but the program has not ended: mostly an M code that no handler resets.",
        "Look at what it waits for; give the M code a handler or unhandled = \"auto_reset\".";
    SIMULATION_LIMIT = 391, Simulated, "The program did not end within the time limit",
        "The simulated time has reached --max-time-s.",
        "Look for a loop, or raise --max-time-s.";
    RUNTIME_FAULT = 400, Reset, "An internal fault has stopped the coordinate system",
        "The runtime, or code of the machine builder in its process, has failed in a task of the coordinate system; the text names the fault.",
        "Check the machine, then reset; if the alarm returns, send the log to the maintainers.";
    RESTARTED_IN_RUN = 401, Reset, "The runtime ended while a program ran",
        "The runtime was killed or the power failed in the middle of a run.",
        "Look at the machine and at what was open before anything is started; acknowledge or reset.";
    STORE_FAILED = 402, Standing, "What is kept cannot be written",
        "The operating system refuses to write the store of variables, tools and offsets: a full or broken disk, or missing rights.",
        "Look at the disk of data_dir; it is tried again by itself.";
    JOURNAL_FAILED = 403, Standing, "The journal cannot be written",
        "The operating system refuses to write the journal: a full or broken disk, or missing rights.",
        "Look at the folder journal of data_dir; it is tried again by itself, and the machine does not need it.";
    PROGRAMS_FAILED = 404, Standing, "Programs cannot be written",
        "The operating system refuses to write programs: a full or broken disk, or missing rights.",
        "Look at the folder programs of data_dir; it is tried again by itself.";
    DATA_FOLDER_FAILED = 405, Standing, "The data folder is gone, full or not writable",
        "data_dir is not there, has no room, or may not be written to.",
        "Put the folder back or make room; it is looked at every second.";
    VALUES_LOST = 406, Standing, "Values that were kept are damaged and count as no values",
        "The sums of values in the store do not fit: a disk that lies, or a change from outside.",
        "Write each of them anew, or stop the runtime and look at tandem store repair.";
    PROGRAM_DAMAGED = 407, Standing, "A program is damaged",
        "The sum of a program's file does not fit: a disk that lies, or a change from outside.",
        "Store it again, or stop the runtime and look at tandem store repair.";
    PROGRAM_CHANGED = 408, Standing, "A program was changed outside of the runtime",
        "The file of a program in data_dir is not what the runtime has written.",
        "Look at the program, and load it again.";
    NOT_READ = 409, Standing, "Something in the data folder is not read",
        "A file lies in the data folder whose name or form is not that of a program.",
        "Move it away, or give it the name and the form that the text says.";
    STORE_DAMAGED = 410, Standing, "The store was damaged, or cannot be verified",
        "The store's file or its sums did not fit when the runtime started.",
        "Look at the disk; tandem store verify looks at all that is kept.";
    JOURNAL_DAMAGED = 411, Standing, "Lines of the journal are damaged",
        "The chain of hashes of the journal is broken: lines are missing or have been changed.",
        "Look at the disk; the machine does not need them.";
    VALUE_LOST = 412, Reset, "A value that the program needs is damaged and counts as no value",
        "The store was damaged, and this value with it; the program reads it now, and a guess could break the machine.",
        "Look at the machine and write the value anew; alarm 406 lists all of them.";
    FAULT_LASTS = 413, Restart, "An internal fault keeps the coordinate system stopped",
        "A second internal fault occurred before a reset, or the recovery from the first one failed.",
        "Make the machine safe, restart the runtime, and send the log to the maintainers.";
    SERVO_FAILED = 414, Restart, "The servo has failed and the drives are switched off",
        "The servo thread, the bus to the drives or a spindle has failed, or a servo cycle does not end; the text names the fault.",
        "Make the machine safe, examine the drives and their bus, and restart the runtime.";
    TASK_FAILED = 415, Notice, "A task of the runtime has failed",
        "A task or a thread beside the motion has failed; the text names it and what follows. GET /health lists all of them.",
        "Send the log to the maintainers; the text says whether the runtime needs a restart.";
    STORED_DATA_QUESTION = 416, Standing, "Stored files do not fit together",
        "Files in data_dir are an older copy than others, or of another machine: a backup was restored in part, or a disk has lost what was written.",
        "Compare the time of the newest journal entry with the backup. Accept the files, or refuse them: then their values count as lost. No program starts before that.";
    CLIENT_LOST = 421, Held, "A client that asked to be watched is not heard any more",
        "The client has promised to be heard from, and was not for longer than it said, while it was in charge.",
        "Look at the client and at its connection, and at the machine; then resume.";
    MESSAGES_NOT_KEPT = 422, Standing, "Retained messages of MQTT clients are not kept",
        "The embedded broker has no room for further retained messages of clients.",
        "Clear topics of the embedded broker by empty retained messages; the text says which are full.";
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
