//! Dialect dgshape by hand: manual data input and homing.

use std::sync::{Arc, Mutex};

use tandem_model::Axis;
use tandem_runtime::Config;
use tandem_testing::Bench;

use super::MACHINE;

#[test]
fn dgshape_manual_input_needs_no_mark_and_home_moves_what_g28_can() {
    let machine = Config::from_toml(&MACHINE, "").unwrap().resolve().unwrap();
    let at = Arc::<Mutex<[f64; 4]>>::default();
    let (seen, sink) = (Arc::clone(&at), Arc::clone(&at));
    let bench = Bench::on_machine(machine).on_cycle(move |servo| {
        let setpoint = servo.channel(0).setpoint();
        *sink.lock().unwrap() = [Axis::X, Axis::Y, Axis::Z, Axis::A].map(|axis| setpoint[axis]);
    });
    let played = bench.play(async move |scene, _| {
        let cs = scene.cs(1);
        let at = || *seen.lock().unwrap();
        cs.mdi("G00X10000Y5.0A30.").await.unwrap();
        assert_eq!(at(), [10.0, 5.0, 0.0, 30.0]);
        cs.mdi("G91G01X2.0F600.").await.unwrap();
        assert_eq!(at(), [12.0, 5.0, 0.0, 30.0], "it goes on in what is in force");
        cs.home(&['Y']).await.unwrap();
        assert_eq!(at(), [12.0, -80.0, 0.0, 30.0]);
        cs.home(&[]).await.unwrap();
        assert_eq!(at(), [-90.0, -80.0, 100.0, 30.0], "G28 does not move A");
        let refused = cs.home(&['A']).await.unwrap_err().to_string();
        assert!(
            refused.contains("G28 of dialect dgshape does not move it"),
            "{refused}"
        );
    });
    played.unwrap();
}
