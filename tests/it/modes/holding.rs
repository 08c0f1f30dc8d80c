//! Feed hold, override, stop and abort at any moment of chains, arcs and G31: the path stays, the position is kept.

use plc_api::Execution;
use plc_protocol::types::request::OverrideChange;
use plc_protocol::types::state::Reason;

use super::rig::{Point, Rig, close, on_machine};
use super::stairs::{STAIRS, assert_on_stairs, stairs_end_s};
use crate::support::formula::PERIOD_S;

/// Moves to X0 Y0 Z0, and clears the trace.
async fn back(rig: &Rig) {
    rig.cs.mdi("G90 G00 X0 Y0 Z0").await.unwrap();
    rig.trace();
}

/// Moments during a motion, s, at an interval that fits no other period.
fn moments(end_s: f64) -> impl Iterator<Item = f64> {
    (0..)
        .map(|n| 0.004 + f64::from(n) * 0.0833)
        .take_while(move |at| *at < end_s)
}

#[test]
fn m1i_feed_hold_at_any_moment_of_a_chain_leaves_its_path_as_it_is() {
    on_machine("", |rig| async move {
        for moment_s in moments(stairs_end_s()) {
            rig.start(STAIRS).await;
            rig.sleep(moment_s).await;
            rig.cs.hold().await.unwrap();
            let held = rig.state().await;
            // Late holds arrive after the end of the program.
            if held.0 == Execution::FeedHold {
                let at = rig.at().await;
                rig.sleep(0.3).await;
                close(rig.at().await, at);
                rig.cs.resume().await.unwrap();
            }
            rig.until(Execution::ProgramCompleted).await;
            close(rig.at().await, [40.0, 40.0, 0.0]);
            rig.trace().into_iter().for_each(assert_on_stairs);
            back(&rig).await;
        }
    });
}

#[test]
fn m1i_override_changes_at_any_moment_leave_the_path_as_it_is() {
    on_machine("", |rig| async move {
        for (n, moment_s) in moments(stairs_end_s()).enumerate() {
            rig.start(STAIRS).await;
            for feed in [30.0, 200.0, 0.0, 75.0, 120.0, 100.0]
                .into_iter()
                .cycle()
                .skip(n)
                .take(6)
            {
                rig.sleep(moment_s / 3.0).await;
                let change = OverrideChange {
                    feed: Some(feed),
                    ..OverrideChange::default()
                };
                rig.cs.set_overrides(change).await.unwrap();
            }
            let change = OverrideChange {
                feed: Some(100.0),
                ..OverrideChange::default()
            };
            rig.cs.set_overrides(change).await.unwrap();
            rig.until(Execution::ProgramCompleted).await;
            close(rig.at().await, [40.0, 40.0, 0.0]);
            rig.trace().into_iter().for_each(assert_on_stairs);
            back(&rig).await;
        }
    });
}

#[test]
fn m1i_stop_at_any_moment_ends_on_the_path_and_keeps_the_position() {
    on_machine("", |rig| async move {
        for moment_s in moments(stairs_end_s() - 0.05) {
            rig.start(STAIRS).await;
            rig.sleep(moment_s).await;
            rig.cs.stop().await.unwrap();
            assert_eq!(rig.state().await, (Execution::Stopped, Some(Reason::Stop)));
            let at = rig.at().await;
            rig.trace().into_iter().for_each(assert_on_stairs);
            rig.cs.reset().await.unwrap();
            assert_eq!(rig.state().await, (Execution::Ready, None));
            rig.sleep(0.2).await;
            close(rig.at().await, at);
            // The position is known: the next motion begins there.
            rig.cs.mdi("G91 G00 X1").await.unwrap();
            close(rig.at().await, [at[0] + 1.0, at[1], 0.0]);
            back(&rig).await;
        }
        assert_eq!(rig.alarms().await, [0_u16; 0]);
    });
}

#[test]
fn an_abort_at_any_moment_brakes_each_motor_within_its_acceleration() {
    on_machine("", |rig| async move {
        for moment_s in moments(stairs_end_s() - 0.05) {
            rig.start(STAIRS).await;
            rig.sleep(moment_s).await;
            rig.cs.abort().await.unwrap();
            assert_eq!(rig.state().await, (Execution::Stopped, Some(Reason::Aborted)));
            for three in rig.trace().windows(3) {
                let second_difference = |axis: usize| three[2][axis] - 2.0 * three[1][axis] + three[0][axis];
                for change in [0, 1].map(|axis| second_difference(axis) / PERIOD_S / PERIOD_S) {
                    assert!(
                        change.abs() < 5000.0 * (1.0 + 1e-6),
                        "{change} mm/s^2 at {moment_s} s"
                    );
                }
            }
            rig.cs.reset().await.unwrap();
            assert_eq!(rig.state().await, (Execution::Ready, None));
            back(&rig).await;
        }
        assert_eq!(rig.alarms().await, [0_u16; 0]);
    });
}

#[test]
fn m1i_hold_and_stop_at_any_moment_of_an_arc_stay_on_its_circle() {
    // A full circle of radius 10 about (10, 0).
    const CIRCLE: &str = "ta50 td50 ts0 G61 G03 I10 F6000\nM30\n";
    let on_circle = |point: Point| {
        let radius = (point[0] - 10.0).hypot(point[1]);
        assert!((radius - 10.0).abs() < 1e-9, "radius {radius}");
    };
    on_machine("", move |rig| async move {
        for (n, moment_s) in moments(0.6).enumerate() {
            rig.start(CIRCLE).await;
            rig.sleep(moment_s).await;
            if n % 2 == 0 {
                rig.cs.hold().await.unwrap();
                assert_eq!(rig.state().await.0, Execution::FeedHold);
                rig.cs.resume().await.unwrap();
                rig.until(Execution::ProgramCompleted).await;
                close(rig.at().await, [0.0; 3]);
            } else {
                rig.cs.stop().await.unwrap();
            }
            rig.trace().into_iter().for_each(on_circle);
            rig.cs.reset().await.unwrap();
            back(&rig).await;
        }
    });
}

#[test]
fn d40_hold_at_any_moment_of_a_g31_changes_nothing_of_what_it_captures() {
    let more = "\n[[simulated_skip]]\nmotor = 1\nabove = 7.25\n";
    on_machine(more, |rig| async move {
        // 10 mm/s for X (a tenth of 500 mm/s would be 50): the input turns on after about 0.2 s.
        for (n, moment_s) in moments(0.4).enumerate() {
            rig.start("G31 X40\nM30\n").await;
            rig.sleep(moment_s).await;
            match n % 3 {
                0 => {
                    rig.cs.hold().await.unwrap();
                    if rig.state().await.0 == Execution::FeedHold {
                        rig.cs.resume().await.unwrap();
                    }
                    rig.until(Execution::ProgramCompleted).await;
                    let captured = rig.cs.captured().await.unwrap();
                    assert_eq!((captured.captured[0], captured.positions[0]), (true, 7.25));
                    close(rig.at().await, [7.25, 0.0, 0.0]);
                }
                1 => {
                    rig.cs.stop().await.unwrap();
                    let at = rig.at().await;
                    rig.sleep(0.5).await;
                    close(rig.at().await, at);
                }
                _ => rig.cs.abort().await.unwrap(),
            }
            rig.cs.reset().await.unwrap();
            assert_eq!(rig.state().await, (Execution::Ready, None));
            back(&rig).await;
        }
        assert_eq!(rig.alarms().await, [0_u16; 0]);
    });
}

#[test]
fn a_hold_or_stop_without_a_run_has_no_effect_and_is_not_remembered() {
    on_machine("", |rig| async move {
        rig.load("G00 X5\nM00\nG00 X10\nM30\n").await;
        rig.cs.hold().await.unwrap();
        rig.cs.stop().await.unwrap();
        rig.cs.abort().await.unwrap();
        assert_eq!(rig.state().await, (Execution::Ready, None));
        rig.cs.start().await.unwrap();
        rig.until(Execution::ProgramStopped).await;
        close(rig.at().await, [5.0, 0.0, 0.0]);
        // nor has a hold during a pause: one resume continues to the end
        rig.cs.hold().await.unwrap();
        assert_eq!(rig.state().await.0, Execution::ProgramStopped);
        rig.cs.resume().await.unwrap();
        rig.until(Execution::ProgramCompleted).await;
        close(rig.at().await, [10.0, 0.0, 0.0]);
    });
}
