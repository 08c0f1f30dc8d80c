//! Words that are modal without a code: F, S, ta, td, ts. They belong to no modal group.

use tandem_model::Alarm;
use tandem_model::alarm::VALUE_OUT_OF_RANGE;
use tandem_syntax::Address;

use super::{WordSpec, speed_codes};
use crate::dialect::SpindleWord;
use crate::execution::Execution;

/// Smallest feedrate, mm/min (manual, table of instruction parameters).
const FEEDRATE_MIN: f64 = 0.000_000_001;

/// F, S, ta, td and ts with their ranges. The configuration gives the upper limits of F and S (D11).
pub static FEED_WORDS: [WordSpec; 5] = [
    WordSpec::new(Address::F, "feedrate", "mm/min", FEEDRATE_MIN, f64::INFINITY),
    WordSpec::new(Address::S, "spindle speed", "r/min", 0.0, f64::INFINITY),
    WordSpec::new(Address::Ta, "acceleration time", "ms", 0.0, 250_000.0),
    WordSpec::new(Address::Td, "deceleration time", "ms", 0.0, 250_000.0),
    WordSpec::new(Address::Ts, "jerk time", "ms", 0.0, 125_000.0),
];

/// F and S of dialect dgshape. The least feedrate or speed of the machine replaces a smaller value (2-4,
/// 2-5).
pub static FEED_AND_SPEED: [WordSpec; 2] = [
    WordSpec::new(Address::F, "feedrate", "mm/min", FEEDRATE_MIN, f64::INFINITY),
    WordSpec::new(
        Address::S,
        "spindle speed",
        "r/min",
        f64::NEG_INFINITY,
        f64::INFINITY,
    )
    .whole(),
];

/// Stores F, S, ta, td and ts of a block, unless a code of the block takes the word. F above the maximum
/// gives a warning, S above the spindle's maximum is an alarm (D11). F keeps its written value, since F
/// determines the pitch of a thread (M1h); no motion is faster than the maximum.
pub(crate) fn store_feed_words(execution: &mut Execution<'_>) {
    if let Some(programmed) = execution.free_word(Address::F) {
        let max = execution.limits.max_feedrate_mm_min;
        if programmed > max {
            let unit = execution.modal.unit_text();
            execution.warn(format!(
                "F{programmed} is above the maximum feedrate: {max} {unit}/min is used"
            ));
        }
        let feedrate = programmed * execution.modal.unit();
        execution.modal.is_feed_programmed = true;
        let least = execution.dialect.policy.least_feedrate(&execution.limits.options);
        execution.modal.feedrate_mm_min = feedrate.max(least);
        execution.modal.feedrate_deg_min = programmed.max(least);
    } else if !execution.modal.is_feed_programmed {
        execution.modal.feedrate_mm_min = execution.limits.default_feedrate_mm_min * execution.modal.unit();
    }
    if let Some(programmed) = execution.free_word(Address::S) {
        let speed = match execution.dialect.policy.spindle_word {
            SpindleWord::Speed => programmed,
            SpindleWord::SpeedOrCode => speed_codes::speed(programmed, execution.limits),
        };
        if let Some(max) = execution.limits.max_spindle_speed_r_min
            && speed > max
        {
            let text = format!("S{speed} is above the spindle's maximum of {max} r/min");
            execution.refuse(Alarm::new(&VALUE_OUT_OF_RANGE, text).of_words("S"));
        }
        execution.modal.spindle_speed_r_min = speed;
    }
    if let Some(time) = execution.free_word(Address::Ta) {
        execution.modal.ta_ms = time;
    }
    if let Some(time) = execution.free_word(Address::Td) {
        execution.modal.td_ms = time;
    }
    if let Some(time) = execution.free_word(Address::Ts) {
        execution.modal.ts_ms = time;
    }
}
