//! The alarm table. An alarm stops its coordinate system; the alarm text describes the event, its block and
//! its cause.

use std::fmt::Display;

use crate::span::Origin;

/// An alarm raised by the runtime itself.
#[derive(Debug, Clone, PartialEq)]
pub struct Alarm {
    /// Entry of the alarm in the table.
    pub entry: &'static AlarmEntry,
    /// Description of the event, with its values.
    pub text: String,
    /// Block that raised the alarm. `None` if no block raised it.
    pub origin: Option<Origin>,
    /// Letters of the words that cause the alarm; empty if the whole block causes it. A letter may be missing
    /// from the block.
    pub words: String,
}

/// One line of the alarm table.
#[derive(Debug, PartialEq, Eq)]
pub struct AlarmEntry {
    /// Number of the alarm, 1 to 9999.
    pub number: u16,
    /// Name of the alarm.
    pub title: &'static str,
    /// Effect on the program after the alarm.
    pub after: After,
    /// Causes of the alarm.
    pub cause: &'static str,
    /// Remedies for the alarm.
    pub remedy: &'static str,
}

/// Effect of an alarm on the machine, and the way to continue.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum After {
    /// The alarm has stopped its coordinate system.
    Reset,
    /// The run is held, and can be resumed.
    Held,
    /// The program waits for the reset of an output.
    Lost,
    /// Nothing has stopped; the event has ended.
    Notice,
    /// Nothing has stopped; the cause persists.
    Standing,
    /// The coordinate system has stopped, and continues only after a restart of the runtime.
    Restart,
    /// A simulation has ended.
    Simulated,
}

impl After {
    /// Returns the effect on the machine and the way to continue, as a text for the operator.
    pub const fn text(self) -> &'static str {
        match self {
            After::Reset => {
                "The coordinate system has stopped and its outputs are cancelled. After the cause is \
                 removed, reset clears the alarm, and start runs the program from line 1."
            }
            After::Held => {
                "The run is held on its path, and can continue without loss. When the machine is in order, \
                 acknowledge the warning and resume the run. The next reset clears the warning."
            }
            After::Lost => {
                "The program waits for its output (WAIT, HANDLER_LOST). After the output is reset, the \
                 program continues; stop ends the run."
            }
            After::Notice => {
                "Nothing has stopped. The history of alarms keeps the warning. If the warning is also \
                 active, the next reset clears it."
            }
            After::Standing => {
                "Nothing has stopped. If the runtime watches the cause, the warning is active until the \
                 cause is removed, otherwise until the next reset. Acknowledging the warning does not clear \
                 it."
            }
            After::Restart => {
                "Motion has stopped and outputs are cancelled. Reset does not clear the alarm; hold, stop \
                 and abort are still answered. A restart of the runtime clears the alarm."
            }
            After::Simulated => "The simulation has ended at this point; a machine would continue to wait.",
        }
    }
}

impl Alarm {
    /// Creates an alarm of this entry, without a block.
    pub fn new(entry: &'static AlarmEntry, text: impl Into<String>) -> Self {
        Self {
            entry,
            text: text.into(),
            origin: None,
            words: String::new(),
        }
    }

    /// Adds the letters of the words that cause the alarm, for example `IJ`.
    #[must_use]
    pub fn of_words(mut self, words: impl Into<String>) -> Self {
        self.words = words.into();
        self
    }

    /// Adds the block that raised the alarm.
    #[must_use]
    pub fn at(mut self, origin: Origin) -> Self {
        self.origin = Some(origin);
        self
    }
}

/// Checks a value. The alarm text begins with `name`, for example "The feedrate".
///
/// # Errors
/// Returns `VALUE_NOT_FINITE` if the value is not a finite number.
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
    // 1 to 99: alarms of the program
    VALUE_NOT_FINITE = 10, Reset, "A word's value is not a number",
        "A calculation or a variable gives no finite number: an argument outside a function's domain, a division by 0, or a variable without a value.",
        "Check the calculation that gives the value (D07).";
    VALUE_OUT_OF_RANGE = 11, Reset, "A word's value is out of its range",
        "A value that the program calculates or reads while it runs is outside the range of its word. A constant out of range is found when the program is checked.",
        "Write a value within the range that the alarm text names.";
    PROGRAM_NOT_FOUND = 20, Reset, "The program is not in the store",
        "The store has no program with the number that was started, or that M98 calls.",
        "Load the program, or correct its number.";
    STEP_LIMIT = 21, Reset, "The program makes no progress",
        "Too many blocks in a row neither move, dwell, wait nor make an output. The usual cause is a loop whose condition never changes.",
        "Look for a loop that neither moves, waits nor reads P or Q, or raise blocks_without_motion_max.";
    PROGRAM_END_MISSING = 22, Reset, "The program ran past its last block",
        "The program has executed its last block without M02, M30 or M99. That block is missing, or a block skip or a jump has passed over it.",
        "End a main program with M30, a subprogram with M99.";
    PROGRAM_HAS_ERRORS = 23, Reset, "The program has an error",
        "The run has reached a block with an error that a check of the program also finds. The block was not executed.",
        "Check the program, and correct the errors.";
    PROGRAM_REFUSED = 24, Reset, "The program may not be called here",
        "The number of a call is calculated, and this coordinate system may not run that program: it is of another dialect, or lacks the signature that the machine requires.",
        "Correct the called program as the alarm text says, and load it again.";
    TOOL_DIFFERS = 25, Reset, "The tool in the spindle is not that of the line",
        "At the start from a line, the M codes before the line were output. Afterwards, the tool in the spindle is not the one that the program has at the line.",
        "Check the tool change. Bring the right tool into the spindle, report it to the runtime, and start from the line again.";
    PROGRAM_WARNING = 30, Notice, "The program was not executed as written",
        "A word has no effect in the present state, or a value was limited to the maximum of the machine.",
        "Look at the line that the warning names.";
    COMPENSATION_REFUSED = 40, Reset, "Not allowed with cutter compensation",
        "While cutter compensation is on, the block needs the motion before it to be finished, or its own motion has no compensated path.",
        "End the compensation with G40 before the block. The rules are explained for G41.";
    OFFSET_REFUSED = 41, Reset, "Not allowed with an offset of the tool",
        "The block moves to a position of the machine (G28, G30, G53), which an offset of the tool would shift.",
        "Before G28, G30 and G53, write G40, or G49 with G90 and a motion to a free Z. Under G91, Z would come down by the offset (D23).";
    FIXED_CYCLE_REFUSED = 42, Reset, "Not allowed in a fixed cycle",
        "Between the first block of a fixed cycle and its end, there is a code that is neither a position of the cycle nor its end.",
        "End the cycle with G80 before the block.";
    ARC_REFUSED = 43, Reset, "The arc cannot be made",
        "No circle goes through the start and the target: the centre or the radius does not fit them, or the block has neither.",
        "Check I, J, K and R of the block (D26).";
    // 100 to 199: alarms of path and motion
    AXIS_MISSING = 100, Reset, "The coordinate system does not have this axis",
        "A word names an axis to which the coordinate system has assigned no motor.",
        "Remove the word, or assign a motor to the axis.";
    FEEDRATE_MISSING = 101, Reset, "No feedrate is programmed",
        "A block moves at the feedrate before any F, and the configuration has no default_feedrate.",
        "Write F before the first such block, or set default_feedrate.";
    SOFT_LIMIT = 102, Reset, "The target is beyond a soft limit",
        "The target, or a point of an arc, is beyond a soft limit of its motor. The usual causes are a wrong work offset, tool length or sign.",
        "Correct the position or the work offset; the block has not moved.";
    LIMIT_ZERO = 103, Reset, "A motor's velocity or acceleration limit is zero",
        "The maximum velocity or acceleration of the motor is 0, so that it would never arrive.",
        "Set a limit above zero in the configuration.";
    OFFSET_IN_FORCE = 110, Reset, "Cutter compensation or a tool offset is on",
        "Cutter compensation or a tool offset is in force in a block that moves to a position of the machine (G28, G30, G53).",
        "Cancel it before the block: with G40, or with G49, G90 and a motion to a free Z (D23).";
    ARC_IMPOSSIBLE = 111, Reset, "There is no such arc",
        "Start, target, centre and radius do not belong to one circle, within arc_radius_tolerance.",
        "Correct the target, the centre (I, J, K) or the radius (R).";
    ARC_DISTORTED = 112, Reset, "The transforms in force leave no circle",
        "Scaling or rotation in force would turn the arc into an ellipse, or out of its plane.",
        "Scale both axes of the plane by one factor, and rotate in the arc's plane (D21).";
    SPINDLE_SPEED_MISSING = 113, Reset, "No spindle speed is programmed",
        "A tapping cycle begins while S is 0 or was never programmed.",
        "Write S before the tapping cycle: its pitch is F / S.";
    TAP_OFF_AXIS = 114, Reset, "The tap would leave the Z axis",
        "A rotation in force turns the path of the tap out of the Z axis.",
        "End the rotation with G69 before the tapping cycle.";
    COMPENSATION_LEAD_SHORT = 115, Reset, "The path into or out of cutter compensation is too short",
        "The block that switches compensation on or off is shorter than the radius of the tool.",
        "Lead in and out over at least the tool's radius.";
    COMPENSATION_ARC_SMALL = 116, Reset, "The tool does not fit into the arc",
        "The tool runs inside an arc, and its radius is larger than the radius of the arc.",
        "Use a smaller tool, or replace the arc by a line.";
    COMPENSATION_CORNER = 117, Reset, "The compensated blocks do not meet",
        "Two blocks have no common point after compensation has shifted them by the radius of the tool. Usually one of them is shorter than the radius.",
        "Use a smaller tool, or change the corner between the blocks.";
    COMPENSATION_SPIRAL = 118, Reset, "A spiral has no cutter compensation",
        "The radius of the arc at its start differs from its radius at its end.",
        "Write an arc with one radius, or raise arc_radius_tolerance if the difference is rounding.";
    COMPENSATION_LOOK_AHEAD = 119, Reset, "Too many blocks in a row without a move in the plane of the compensation",
        "Compensation needs the next move in its plane to calculate a path, and too many blocks in a row have none.",
        "Write G40 and a lead-out before them.";
    OVERCUT = 120, Reset, "The tool would cut into another block",
        "The compensated path of the tool crosses another block: there, the contour is narrower than the tool.",
        "Use a smaller tool, change the blocks, or set overcut = \"prevent\".";
    // 200 to 299: alarms of the servo
    IN_POSITION_TIMEOUT = 200, Reset, "A motor did not come into position in time",
        "The motor has not come within in_position of its target: it is blocked, its following error is too large, or the tolerance too small.",
        "Check the drive, in_position and in_position_timeout_ms.";
    MOTION_RAN_OUT = 201, Reset, "The prepared motion ran out within a blended chain",
        "The servo had no further block within a blended chain: an error of the runtime.",
        "Reset. If the alarm returns, send the log to the maintainers.";
    POSITION_JUMP = 202, Reset, "A motion does not begin at the position of the machine",
        "The planned motion does not begin at the position of the motors: an error of the runtime, or motors that were moved in the meantime.",
        "Reset. If the alarm returns, send the log to the maintainers.";
    SPINDLE_MISSING = 203, Reset, "The coordinate system has no spindle",
        "The program turns a spindle, or cuts a thread, and the configuration assigns no spindle.",
        "Assign a spindle motor in the configuration.";
    SPINDLE_TURNS = 204, Reset, "The spindle does not rest at the start of a thread",
        "When M19 was reset, the spindle still turned, or was not at its position.",
        "Let the handler reset M19 only after the spindle rests at its position.";
    DRIVE_FAULT = 205, Reset, "A drive reports a fault",
        "The drive itself has reported a fault; the alarm text contains its code.",
        "Look up the code in the drive's manual and remove the cause; reset clears the fault and enables the drives.";
    DRIVE_BUS_LOST = 206, Reset, "The bus to the drives is lost",
        "More frames of the bus in a row were lost than the drives may miss.",
        "Check the cables, the power supply and the load of the computer; reset enables the drives.";
    DRIVE_NOT_ENABLED = 207, Reset, "A drive has no power",
        "The drive does not report that it is enabled: an emergency stop, a missing supply, or an enable input that is off.",
        "Check the emergency stop, the drive's supply and its enable input; reset enables the drives.";
    MOTOR_NOT_HOMED = 208, Reset, "The position of a motor is unknown",
        "The drive has no absolute position, and was not homed since it was switched on.",
        "Home the motor with the functions of the drive before it moves, or use an absolute encoder; then reset.";
    SERVO_LATE = 209, Held, "The servo thread was late while motors moved",
        "While motors moved, the servo thread did not run for longer than servo_late_ms.",
        "Look for the program that stopped the runtime or kept the processor busy. Check the machine, then resume.";
    // 300 to 399: alarms of sequence control
    M_CODE_UNHANDLED = 300, Reset, "No handler is registered for this M code",
        "The program has output an M code that no handler serves, and unhandled is not auto_reset.",
        "Connect a handler, or set unhandled for the M code.";
    M_CODE_TIMEOUT = 301, Reset, "The M code was not reset in time",
        "The output was pending for longer than timeout_ms: its handler is slow or stuck, or its message was lost.",
        "Check the handler, or raise timeout_ms.";
    HANDLER_LOST = 302, Lost, "The handler of an M code is lost",
        "The connection of the handler that owned the output has ended, or its process has.",
        "Start the handler again. If it does not continue the output, redeliver the M code, or reset it by hand.";
    REQUEST_REFUSED = 310, Notice, "A request from outside was rejected",
        "A message from a client was malformed, not allowed, or had the retain flag.",
        "Look at the client; the warning names the error.";
    // 390 to 499: alarms of the runtime
    SIMULATION_STALLED = 390, Simulated, "The program waits for an event that never comes",
        "Nothing moves and no event is due, but the program has not ended. Usually no handler resets an M code.",
        "Check the event that the program waits for; give the M code a handler or unhandled = \"auto_reset\".";
    SIMULATION_LIMIT = 391, Simulated, "The program did not end within the time limit",
        "The simulated time has reached --max-time-s.",
        "Look for a loop, or raise --max-time-s.";
    RUNTIME_FAULT = 400, Reset, "An internal fault has stopped the coordinate system",
        "The runtime, or code of the machine builder in its process, has failed in a task of the coordinate system; the alarm text names the fault.",
        "Check the machine, then reset; if the alarm returns, send the log to the maintainers.";
    RESTARTED_IN_RUN = 401, Reset, "The runtime ended while a program ran",
        "The runtime was killed, or the power failed, during a run.",
        "Before you start a program, check the machine and the outputs that the warning lists; acknowledge or reset.";
    STORE_FAILED = 402, Standing, "Variables, tools and offsets cannot be stored",
        "The operating system refuses to write the store of variables, tools and offsets: the disk is full or broken, or rights are missing.",
        "Check the disk of data_dir. The runtime repeats the attempt.";
    JOURNAL_FAILED = 403, Standing, "The journal cannot be written",
        "The operating system refuses to write the journal: the disk is full or broken, or rights are missing.",
        "Check the folder journal of data_dir. The runtime repeats the attempt; the machine can run without the journal.";
    PROGRAMS_FAILED = 404, Standing, "Programs cannot be written",
        "The operating system refuses to write programs: the disk is full or broken, or rights are missing.",
        "Check the folder programs of data_dir. The runtime repeats the attempt.";
    DATA_FOLDER_FAILED = 405, Standing, "The data folder is missing, full or not writable",
        "The folder data_dir does not exist, its disk is full, or the runtime may not write to it.",
        "Restore the folder, or free space on the disk. The runtime checks the folder every second.";
    VALUES_LOST = 406, Standing, "Stored values are damaged and are not used",
        "The checksums of values in the store do not match: the disk has returned wrong data, or the file was changed outside the runtime.",
        "Write each of the values again, or stop the runtime and use tandem store repair.";
    PROGRAM_DAMAGED = 407, Standing, "A program is damaged",
        "The checksum of a program's file does not match: the disk has returned wrong data, or the file was changed outside the runtime.",
        "Store the program again, or stop the runtime and use tandem store repair.";
    PROGRAM_CHANGED = 408, Standing, "A program was changed outside the runtime",
        "The file of a program in data_dir is not the file that the runtime has written.",
        "Check the program, and load it again.";
    NOT_READ = 409, Standing, "A file in the data folder is not read",
        "The data folder contains a file whose name or content is not that of a program.",
        "Move the file away, or correct its name or content as the warning says.";
    STORE_DAMAGED = 410, Standing, "The store was damaged, or cannot be verified",
        "When the runtime started, files of the data folder or their checksums did not match, or were missing.",
        "Check the disk; tandem store verify inspects all stored data.";
    JOURNAL_DAMAGED = 411, Standing, "Lines of the journal are damaged",
        "The chain of hashes of the journal is broken: lines are missing or were changed.",
        "Check the disk; the machine can run without these lines.";
    VALUE_LOST = 412, Reset, "A value that the program needs is damaged and is not used",
        "The store was damaged, and this value with it. The program now reads the value, and a guessed value could damage the machine.",
        "Check the machine and write the value again; alarm 406 lists all damaged values.";
    FAULT_LASTS = 413, Reset, "An internal fault keeps the coordinate system stopped",
        "A second internal fault occurred before a reset, or the recovery from a fault failed.",
        "Make the machine safe, then reset, and send the log to the maintainers. If the alarm returns, restart the runtime.";
    SERVO_FAILED = 414, Restart, "The servo has failed and the drives are switched off",
        "The servo thread, the bus to the drives or a spindle has failed, or a servo cycle does not end; the alarm text names the fault.",
        "Make the machine safe, examine the drives and their bus, and restart the runtime.";
    TASK_FAILED = 415, Notice, "A task of the runtime has failed",
        "A task or a thread that is not part of the motion has failed; the warning names the task and the consequences. GET /health lists all failed tasks.",
        "Send the log to the maintainers. Restart the runtime if the warning requires it.";
    STORED_DATA_QUESTION = 416, Standing, "Stored files do not belong together",
        "Files in data_dir are older than the other files, or belong to another machine: a backup was restored in part, or the disk has lost written data.",
        "Compare the time of the newest journal entry with the backup. Then accept or refuse the files; refused values are lost. Until then, no program starts.";
    CLIENT_LOST = 421, Held, "The heartbeat of a watched client is missing",
        "The client has asked the machine to watch it, and has then sent no heartbeat within its ttl_ms.",
        "Check the client, its connection and the machine; then resume.";
    MESSAGES_NOT_KEPT = 422, Standing, "Retained messages of MQTT clients are not kept",
        "The embedded broker has no room for further retained messages of clients.",
        "Clear topics of the embedded broker by empty retained messages; the warning names the limit that is reached.";
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
