//! Settings of the machine that a program was written for.

use tandem_interp::dialects::convert::{Settings, Source, convert};
use tandem_interp::dialects::{dgshape, nj};
use tandem_model::settings::{CoordinateSystemSettings, Unit};

use super::{Random, blocks};
use crate::dgshape::{MACHINE, machine_settings, settings, steps};

/// For each setting of dialect dgshape and the unit, a converted program runs as the native one does, or a
/// finding states the difference.
#[test]
fn every_setting_of_dgshape_is_converted_or_reported() {
    let keys = [
        "calculator = \"all\"",
        "calculator = \"f\"",
        "calculator = \"ijkrxyza\"",
        "angle_increment = 1.0",
        "min_feedrate = 60.0",
        "min_spindle_speed = 900.0",
        "max_spindle_speed = 700.0",
        "peck_clearance = 0.2",
        "compensation_start = \"b\"",
        "external_offset = { X = 3.0, Z = -1.0 }",
    ];
    let mut random = Random(0x0c0d_e000_0000_0003);
    let mut machines: Vec<_> = keys.iter().map(|key| (*key, settings(key))).collect();
    let inch = CoordinateSystemSettings {
        unit: Unit::Inch,
        ..settings("")
    };
    machines.push(("units = \"inch\"", inch));
    let mut slow = settings("");
    slow.spindle.as_mut().unwrap().max_velocity = 700.0;
    machines.push(("max_velocity = 700 of the spindle", slow));
    let of_nj = machine_settings(&MACHINE.replace("dialect = \"dgshape\"\n", ""));
    for (key, settings) in machines {
        let mut compared = 0;
        for _ in 0..60 {
            let body = blocks(&mut random);
            let text = format!("%\nO0001(a)\nG90\nG00X0Y0Z0.4\nG01X.3F6.\n{body}\nM05\nM30\n%\n");
            let from = Settings::from(&settings);
            let converted = convert(&text, Source::Dgshape, from);
            let Ok(wanted) = steps(&text, dgshape(), &settings) else {
                continue;
            };
            compared += 1;
            if converted.left.is_empty() {
                let moves = steps(&converted.text, nj(), &of_nj);
                let moves =
                    moves.unwrap_or_else(|alarm| panic!("{key}: {alarm:?}\n{text}\n{}", converted.text));
                assert_eq!(moves, wanted, "{key}\n{text}\n{}", converted.text);
            }
        }
        assert!(compared > 5, "{key}: only {compared} programs run");
    }
}
