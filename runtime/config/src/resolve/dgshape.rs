//! `[coordinate_system.dgshape]`: checks the settings of dialect dgshape.

use tandem_model::AxisVector;
use tandem_model::settings::{MCodeSet, NcOptions};

use super::super::{CoordinateSystemConfig, POSITION_MAX};
use super::TableCheck;
use super::coordinate_system::axis;

/// Name of the dialect and of its table.
const DGSHAPE: &str = "dgshape";

impl CoordinateSystemConfig {
    /// Returns the settings that the dialect leaves to the machine; without the table, their defaults.
    pub(super) fn nc_options(&self, m_codes: MCodeSet, checked: &mut TableCheck<'_, '_>) -> NcOptions {
        if self.dgshape.is_some() && self.dialect.name != DGSHAPE {
            let text =
                format!("dgshape: this table has no effect; remove it, or write dialect = \"{DGSHAPE}\"");
            checked.problem(DGSHAPE, text);
        }
        let config = self.dgshape.clone().unwrap_or_default();
        let path = format!("{}.{DGSHAPE}", checked.path);
        let name = format!("{}dgshape: ", checked.name);
        checked
            .problems
            .check_table(path, name)
            .check_ranges(&config, &[]);
        let mut external_offset = AxisVector::ZERO;
        for (letter, value) in &config.external_offset {
            match axis(letter).filter(|_| self.axes.contains_key(letter) && value.abs() <= POSITION_MAX) {
                Some(axis) => external_offset[axis] = *value,
                None => checked.problem(
                    &format!("dgshape.external_offset.{letter}"),
                    format!(
                        "external_offset: {letter} = {value}: write an axis of this coordinate system and a number"
                    ),
                ),
            }
        }
        NcOptions {
            calculator: config.calculator,
            angle_increment_deg: config.angle_increment,
            min_feedrate_mm_min: config.min_feedrate,
            min_spindle_speed_r_min: config.min_spindle_speed,
            max_spindle_speed_r_min: config.max_spindle_speed,
            peck_clearance_mm: config.peck_clearance,
            compensation_start: config.compensation_start,
            external_offset,
            m_codes,
        }
    }
}
