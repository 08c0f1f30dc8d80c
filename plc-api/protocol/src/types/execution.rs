//! State words of a coordinate system, and the reasons of states.

use serde::{Deserialize, Serialize};

use super::explained::explained;

explained! {
    "state of a coordinate system"
    /// State word of a coordinate system, named as in MTConnect Execution.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize)]
    #[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
    pub enum Execution {
        /// A program is loaded, at line 1.
        Ready = "READY",
            "Start runs the program from its beginning.";
        /// A program, manual data input or a jog runs.
        Active = "ACTIVE",
            "Hold holds the motion on its path, stop ends the run.";
        /// Waits for the reset of an auxiliary function output.
        Wait = "WAIT",
            "The handler of the M code resets the output. waiting_on names the output, and m_code/pending names its owner. Stop ends the run.";
        /// Held by the operator.
        FeedHold = "FEED_HOLD",
            "Resume continues from the current position. If the state has a reason, its explanation names what to check first.";
        /// Stopped by M00.
        ProgramStopped = "PROGRAM_STOPPED",
            "Resume continues after M00.";
        /// Stopped by M01.
        OptionalStop = "OPTIONAL_STOP",
            "Resume continues after M01. If the optional stop input is off, M01 has no effect.";
        /// Stopped between blocks, or held by an input; see the reason.
        Interrupted = "INTERRUPTED",
            "Single block: resume executes the next block. Interlock: remove its cause, then resume.";
        @default
        /// The run ended before the end of the program; see the reason.
        Stopped = "STOPPED",
            "Reset, then start runs the program from its beginning. The reason shows why the run ended.";
        /// M02 or M30 has been reached and no output is open.
        ProgramCompleted = "PROGRAM_COMPLETED",
            "Start runs the program again, load loads another program.";
    }
}

explained! {
    "reason of a state"
    /// Reason of a state.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
    #[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
    #[non_exhaustive]
    pub enum Reason {
        /// WAIT: the handler that owned the output was lost.
        HandlerLost = "HANDLER_LOST",
            "Start the handler again, and check how far its work had progressed. Then redeliver the M code, or reset it by hand. See alarm 302.";
        /// INTERRUPTED: single block.
        SingleBlock = "SINGLE_BLOCK",
            "Resume executes the next block. If the single block input is off, the program continues.";
        /// INTERRUPTED: the interlock input is on.
        Interlock = "INTERLOCK",
            "The text of the input gives the reason. The program or the operator that has set the interlock must clear it; then resume.";
        /// `FEED_HOLD`: the connection to the MQTT broker was lost while the program waited for an output, or
        /// before.
        BusLost = "BUS_LOST",
            "Check the broker and the network. When the broker is connected again, check the open outputs, and resume.";
        /// `FEED_HOLD`: the servo was late while its motors moved.
        ServoLate = "SERVO_LATE",
            "Find the process that kept the processor busy, and check the machine; then resume. See alarm 209.";
        /// `FEED_HOLD`: a watched client is no longer received.
        ClientLost = "CLIENT_LOST",
            "Check the client, its connection and the machine; then resume. See alarm 421.";
        /// ACTIVE, `FEED_HOLD`: moving backward in a back trace.
        BackTrace = "BACK_TRACE",
            "Hold stops the motion. The end of the back trace moves forward again.";
        /// `FEED_HOLD`: the back trace has reached the end of its path.
        BackTraceEnd = "BACK_TRACE_END",
            "End the back trace; resume then moves forward again.";
        /// ACTIVE: an override of 0 percent stops the motion. WAIT: it stops the spindle whose speed the
        /// program awaits.
        OverrideZero = "OVERRIDE_ZERO",
            "The override of the current motion is 0: the feed override at feedrate, the rapid override in a rapid motion, the spindle override in M03 and M04. Raise this override, and the run continues.";
        /// STOPPED: an alarm.
        Alarm = "ALARM",
            "Remove the cause of the alarm; then reset clears the alarm.";
        /// STOPPED: the stop command.
        Stop = "STOP",
            "Reset, then start runs the program from its beginning.";
        /// STOPPED: the abort command.
        Aborted = "ABORTED",
            "Each motor has braked independently, and the axes have left the path: check their positions, then reset.";
        /// STOPPED: no program is loaded.
        NoProgram = "NO_PROGRAM",
            "Load a program.";
        /// STOPPED: the runtime was restarted; nothing continues automatically.
        Restarted = "RESTARTED",
            "Check the machine and the outputs that were open (last_run), then reset. See alarm 401.";
    }
}
