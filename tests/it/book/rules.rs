//! Pages of the rules, written from the rows beside the code.

use std::fmt::Write;

use super::generated::check;

#[test]
fn the_page_of_motion_is_that_of_its_rules() {
    let mut page = String::from(
        "# Rules of motion\n\nHow blocks move, by the numbers that tests and comments name. Why it is so: \
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
fn the_page_of_the_handshake_is_that_of_its_rules() {
    let mut page = String::from(
        "# Rules of the handshake\n\nWhat holds for the output of an M code on every transport, by the numbers that tests and \
         comments name. Why it is\nso: [The handshake](../explanation/handshake.md).\n\n",
    );
    for (number, text) in plc_api::handshake::rules::RULES {
        writeln!(page, "- **{number}** {text}").unwrap();
    }
    check("docs/src/reference/handshake.md", &page);
}
