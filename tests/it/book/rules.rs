//! Pages of the rules, generated from the rows next to the code.

use std::fmt::Write;

use tandem_runtime::stops::{StopCause, StopReaction, StoppedMotion};

use super::generated::check;

#[test]
fn the_page_of_motion_is_that_of_its_rules() {
    let mut page = String::from(
        "# Rules of motion\n\nHow blocks move. Tests and comments refer to the numbers. Reasons: \
         [Motion](../explanation/motion.md).\n",
    );
    for (number, text) in tandem_motion::rules::RULES {
        if number.contains('.') {
            writeln!(page, "- **{number}** {text}").unwrap();
        } else {
            write!(page, "\n## {number}: {text}\n\n").unwrap();
        }
    }
    check("docs/src/reference/motion.md", &page);
}

#[test]
fn the_page_of_stops_is_that_of_their_table() {
    let mut page = String::from(
        "# What stops a motion\n\nFor each cause and each kind of motion: the reaction. Tests play each cell at several moments.\n\n\
         | cause |",
    );
    for motion in StoppedMotion::ALL {
        write!(page, " {} |", motion.name()).unwrap();
    }
    page.push_str("\n| --- |");
    page.push_str(&" --- |".repeat(StoppedMotion::ALL.len()));
    page.push('\n');
    for cause in StopCause::ALL {
        write!(page, "| {} |", cause.name()).unwrap();
        for motion in StoppedMotion::ALL {
            write!(page, " {} |", cause.reaction(motion).name()).unwrap();
        }
        page.push('\n');
    }
    page.push_str("\n| reaction | what happens, and its time limit |\n| --- | --- |\n");
    for reaction in StopReaction::ALL {
        writeln!(page, "| {} | {} |", reaction.name(), reaction.text()).unwrap();
    }
    page.push_str(
        "\nThe time limits begin when the cause is detected: `SERVO_LATE` in the first servo cycle after the gap, `CLIENT_LOST` when\n\
         the `ttl_ms` of the client is over, a lost source when the loss of its owner is known. With `BUS_LOST` the motion continues,\n\
         and the run is held where it next waits for an M code. A reversal is the turning point of an axis between two blocks; the\n\
         next block does not start. Stops after a fault of the runtime itself:\n\
         [When something is lost](../explanation/failures.md#internal-faults).\n",
    );
    check("docs/src/reference/stops.md", &page);
}

#[test]
fn the_page_of_the_handshake_is_that_of_its_rules() {
    let mut page = String::from(
        "# Rules of the handshake\n\nThese rules apply to the output of an M code on every transport. Tests and comments \
         name their numbers. Reasons:\n[The handshake](../explanation/handshake.md).\n\n",
    );
    for (number, text) in plc_protocol::handshake::rules::RULES {
        writeln!(page, "- **{number}** {text}").unwrap();
    }
    check("docs/src/reference/handshake.md", &page);
}
