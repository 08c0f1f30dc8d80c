//! State words of a coordinate system, and the reasons of states.

use serde::{Deserialize, Serialize};

use super::explained::explained;

explained! {
    "state of a coordinate system"
    /// State words, after MTConnect Execution.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize)]
    #[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
    pub enum Execution {
        /// A program is loaded, at line 1.
        Ready = "READY",
            "Start runs the program from its head.";
        /// A program, manual data input or a jog runs.
        Active = "ACTIVE",
            "Hold holds it on its path, stop ends the run.";
        /// Waits for the reset of an auxiliary function output.
        Wait = "WAIT",
            "The handler of the M code resets the output; waiting_on names it, and m_code/pending says who owns it. Stop ends the run.";
        /// Held by the operator.
        FeedHold = "FEED_HOLD",
            "Resume continues from where it is; the reason, where there is one, says what to look at first.";
        /// Stopped by M00.
        ProgramStopped = "PROGRAM_STOPPED",
            "Resume continues behind M00.";
        /// Stopped by M01.
        OptionalStop = "OPTIONAL_STOP",
            "Resume continues behind M01. Without the optional stop input M01 does nothing.";
        /// Stopped between blocks, or held by an input; see the reason.
        Interrupted = "INTERRUPTED",
            "Single block: resume carries out the next block. Interlock: end it, then resume.";
        @default
        /// Ended before its end; see the reason.
        Stopped = "STOPPED",
            "Reset, then start runs the program from its head. The reason says why it ended.";
        /// M02 or M30 has been reached and no output is open.
        ProgramCompleted = "PROGRAM_COMPLETED",
            "Start runs it once more, load takes another one.";
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
            "Start the handler again and look at what it had done; then redeliver the M code, or reset it by hand. See alarm 302.";
        /// INTERRUPTED: single block.
        SingleBlock = "SINGLE_BLOCK",
            "Resume carries out the next block; without the single block input the program runs on.";
        /// INTERRUPTED: the interlock input is on.
        Interlock = "INTERLOCK",
            "The text of the input says why. Whoever has set it ends it; then resume.";
        /// `FEED_HOLD`: the connection to the MQTT broker was lost while the program waited for an output, or before.
        BusLost = "BUS_LOST",
            "Look at the broker and the network. When it is connected again, look at the open outputs, and resume.";
        /// `FEED_HOLD`: the servo was late while its motors moved.
        ServoLate = "SERVO_LATE",
            "Look at what kept the processor busy, and at the machine; then resume. See alarm 209.";
        /// `FEED_HOLD`: a watched client is no longer received.
        ClientLost = "CLIENT_LOST",
            "Look at the client and its connection, and at the machine; then resume. See alarm 421.";
        /// ACTIVE, `FEED_HOLD`: moving backward in a back trace.
        BackTrace = "BACK_TRACE",
            "Hold stops on the way; ending the back trace goes forward again.";
        /// `FEED_HOLD`: the back trace has reached the end of its path.
        BackTraceEnd = "BACK_TRACE_END",
            "End the back trace, and resume goes forward again.";
        /// ACTIVE: an override of 0 percent stops the motion.
        OverrideZero = "OVERRIDE_ZERO",
            "The override of the motion that runs is 0: the feed override at feedrate, the rapid override in a rapid motion. Raise it, and the motion goes on.";
        /// STOPPED: an alarm.
        Alarm = "ALARM",
            "Look at the alarm; when its cause is removed, reset clears it.";
        /// STOPPED: the stop command.
        Stop = "STOP",
            "Reset, then start runs the program from its head.";
        /// STOPPED: the abort command.
        Aborted = "ABORTED",
            "The motors have braked each on its own and are off the path: look where they are, then reset.";
        /// STOPPED: no program is loaded.
        NoProgram = "NO_PROGRAM",
            "Load a program.";
        /// STOPPED: the runtime was started again; nothing goes on by itself.
        Restarted = "RESTARTED",
            "Look at the machine and at what was open (last_run), then reset. See alarm 401.";
    }
}
