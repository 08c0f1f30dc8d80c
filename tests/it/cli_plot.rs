//! `tandem plot`: the tool path as a picture.

use crate::support::machine::Machine;
use crate::support::simulated::run;

/// Points of all lines of a class, in picture units, line by line.
fn lines(svg: &str, class: &str) -> Vec<Vec<[f64; 2]>> {
    let begin = format!("<polyline class=\"{class}\" points=\"");
    svg.lines()
        .filter_map(|line| line.strip_prefix(begin.as_str())?.strip_suffix("\"/>"))
        .map(|points| {
            let pair = |pair: &str| {
                let (x, y) = pair.split_once(',').expect("x,y");
                [x.parse().expect("a number"), y.parse().expect("a number")]
            };
            points.split(' ').map(pair).collect()
        })
        .collect()
}

#[test]
fn rapid_and_feed_are_drawn_apart_and_an_arc_is_round() {
    let machine = Machine::new("");
    machine.write(
        "part.nc",
        "ta20 td20 ts0 G61 G00 X10\nG01 X40 F6000\nG03 X40 Y60 J30\nG01 X10\nG00 X0 Y0\nM30\n",
    );
    let ran = run(
        machine.folder(),
        &["plot", "part.nc", "-o", "part.svg", "--config", "tandem.toml"],
    );
    assert_eq!((ran.code, ran.stderr.as_str()), (0, ""));
    let svg = std::fs::read_to_string(machine.folder().join("part.svg")).unwrap();
    assert_eq!(lines(&svg, "rapid").len(), 2, "{svg}");
    let [feed] = lines(&svg, "feed").try_into().expect("one line of feed");
    // X from 0 to 70 and Y from 0 to 60: 70 mm are 1000 units. The arc's centre is (40, 30), its radius 30.
    let unit = 1000.0 / 70.0;
    let [cx, cy] = [60.0 + 40.0 * unit, 60.0 + 30.0 * unit];
    let on_arc: Vec<f64> = feed
        .iter()
        .filter(|[x, _]| *x > cx + unit)
        .map(|[x, y]| (x - cx).hypot(y - cy) / unit)
        .collect();
    assert!(on_arc.len() > 100, "{}", on_arc.len());
    for radius in on_arc {
        assert!((radius - 30.0).abs() < 0.002, "{radius}");
    }
}

#[test]
fn an_alarm_is_told_and_the_way_up_to_it_is_drawn() {
    let machine = Machine::new("");
    machine.write("part.nc", "G00 X5\nG00 X9999\nM30\n");
    let ran = run(
        machine.folder(),
        &["plot", "part.nc", "-o", "part.svg", "--config", "tandem.toml"],
    );
    assert_eq!(ran.code, 1);
    assert!(ran.stderr.contains("line 2"), "{}", ran.stderr);
    let svg = std::fs::read_to_string(machine.folder().join("part.svg")).unwrap();
    assert_eq!(lines(&svg, "rapid"), [[[60.0, 60.0], [1060.0, 60.0]]]);
}

#[test]
fn errors_in_the_program_draw_nothing() {
    let machine = Machine::new("");
    machine.write("part.nc", "G01 G00 X5\nM30\n");
    let ran = run(machine.folder(), &["plot", "part.nc", "-o", "part.svg"]);
    assert_eq!(ran.code, 1);
    assert!(!machine.folder().join("part.svg").exists());
}
