//! S word of dialect dgshape: from 100 on a speed in r/min, below 100 the number of a speed (2-4).

use crate::execution::Limits;

/// Smallest S that is a speed in r/min.
const SPEED_MIN: f64 = 100.0;

/// Speed code of the slowest speed of the spindle.
const SLOWEST: usize = 0;

/// Speed code of the fastest speed of the spindle.
const FASTEST: usize = 99;

/// Speeds of codes 1 to 20, r/min. The speeds of each further 20 codes are ten times those of the 20 codes
/// before.
const SPEEDS: [f64; 20] = [
    1.12, 1.25, 1.40, 1.60, 1.80, 2.00, 2.24, 2.50, 2.80, 3.15, 3.55, 4.00, 4.50, 5.00, 5.60, 6.30, 7.10,
    8.00, 9.00, 10.0,
];

/// Returns the spindle speed for a whole S, limited to the range of the spindle, r/min.
pub(super) fn speed(programmed: f64, limits: &Limits) -> f64 {
    let slowest = limits.options.min_spindle_speed_r_min;
    let configured = limits.options.max_spindle_speed_r_min;
    let motor = limits.max_spindle_speed_r_min.unwrap_or(f64::INFINITY);
    let fastest = if configured > 0.0 {
        configured.min(motor)
    } else {
        motor
    };
    let wanted = if programmed < SPEED_MIN {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "the range is tested"
        )]
        speed_from_code(programmed as usize, slowest, fastest)
    } else {
        programmed
    };
    limits.options.spindle_speed_within(wanted).min(motor)
}

fn speed_from_code(code: usize, slowest: f64, fastest: f64) -> f64 {
    match code {
        SLOWEST => slowest,
        FASTEST if fastest.is_finite() => fastest,
        _ => {
            let decade = (code - 1) / SPEEDS.len();
            let factor = [1.0, 10.0, 100.0, 1000.0, 10_000.0];
            // rounds to the two decimals of the manual's table
            (SPEEDS[(code - 1) % SPEEDS.len()] * 100.0).round() * factor[decade.min(4)] / 100.0
        }
    }
}

#[cfg(test)]
mod tests {
    use tandem_model::settings::NcOptions;

    use super::*;

    fn limits(min: f64, max: f64) -> Limits {
        Limits {
            max_feedrate_mm_min: 0.0,
            default_feedrate_mm_min: 0.0,
            max_spindle_speed_r_min: Some(max),
            has_spindle: true,
            arc_radius_tolerance_mm: 0.0,
            blocks_without_motion_max: 1000,
            options: NcOptions {
                min_spindle_speed_r_min: min,
                ..NcOptions::default()
            },
        }
    }

    #[test]
    #[expect(clippy::float_cmp, reason = "the table is exact")]
    fn dgshape_2_4_codes_mean_the_speeds_of_the_manuals_table() {
        // codes 00, 01, 10, 13, 19 of each column of the manual's table, and single entries from its middle
        for (code, r_min) in [
            (1.0, 1.12),
            (3.0, 1.40),
            (10.0, 3.15),
            (19.0, 9.00),
            (20.0, 10.0),
            (21.0, 11.2),
            (33.0, 45.0),
            (39.0, 90.0),
            (40.0, 100.0),
            (47.0, 224.0),
            (59.0, 900.0),
            (60.0, 1000.0),
            (71.0, 3550.0),
            (79.0, 9000.0),
            (80.0, 10_000.0),
            (81.0, 11_200.0),
            (98.0, 80_000.0),
        ] {
            assert_eq!(speed(code, &limits(0.0, 1e6)), r_min, "S{code}");
        }
        assert_eq!(speed(0.0, &limits(400.0, 12_000.0)), 400.0, "the slowest");
        assert_eq!(speed(99.0, &limits(400.0, 12_000.0)), 12_000.0, "the fastest");
    }

    #[test]
    #[expect(clippy::float_cmp, reason = "speeds are held within exact limits")]
    fn dgshape_2_4_speeds_are_held_within_those_of_the_spindle() {
        let limits = limits(400.0, 12_000.0);
        let speeds = [100.0, 8000.0, 20_000.0, 1.0, 98.0].map(|s| speed(s, &limits));
        assert_eq!(speeds, [400.0, 8000.0, 12_000.0, 400.0, 12_000.0]);
    }
}
