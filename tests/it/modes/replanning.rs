//! G500 is replanned while it runs: feed override above 100 percent.

use plc_api::Execution;
use plc_protocol::types::request::OverrideChange;

use super::rig::{Rig, close, on_machine};
use super::stairs::{STAIRS, assert_on_stairs};
use crate::support::formula::PERIOD_S;

/// Maximum accelerations of X and Y, mm/s^2.
const ACCELERATION: f64 = 5000.0;

async fn feed_override(rig: &Rig, percent: f64) {
    let change = OverrideChange {
        feed: Some(percent),
        ..OverrideChange::default()
    };
    rig.cs.set_overrides(change).await.unwrap();
}

/// Largest velocity of X and Y, and largest acceleration of both, from the trace since the last call.
fn limits(rig: &Rig) -> ([f64; 2], f64) {
    let trace = rig.trace();
    let velocity = |axis: usize| {
        let steps = trace.windows(2).map(|two| (two[1][axis] - two[0][axis]).abs());
        steps.fold(0.0, f64::max) / PERIOD_S
    };
    let acceleration = |axis: usize| {
        let second = |three: &[[f64; 3]]| (three[2][axis] - 2.0 * three[1][axis] + three[0][axis]).abs();
        trace.windows(3).map(second).fold(0.0, f64::max) / PERIOD_S.powi(2)
    };
    let most = acceleration(0).max(acceleration(1));
    ([velocity(0), velocity(1)], most)
}

fn g500(program: &str) -> String {
    format!("G64 G500 {program}")
}

#[test]
fn m1d_override_200_percent_doubles_the_feedrate_within_motor_limits() {
    on_machine("", |rig| async move {
        // X is limited to 500 mm/s, Y to 50: F3000 is 50 mm/s.
        rig.start(&g500("ta50 td50 ts0 G01 F3000\nX200\nY40\nM30\n"))
            .await;
        rig.sleep(0.3).await;
        feed_override(&rig, 200.0).await;
        rig.until(Execution::ProgramCompleted).await;
        close(rig.at().await, [200.0, 40.0, 0.0]);
        let ([x, y], acceleration) = limits(&rig);
        assert!((x - 100.0).abs() < 1e-6, "{x}");
        assert!(y <= 50.0 * (1.0 + 1e-6), "{y}");
        assert!(acceleration <= ACCELERATION * (1.0 + 1e-6), "{acceleration}");
        // A program that starts at 200 percent is planned for it from its beginning.
        rig.cs.mdi("G90 G00 X0 Y0").await.unwrap();
        rig.trace();
        rig.start(&g500("ta50 td50 ts0 G01 F3000\nX100\nM30\n")).await;
        rig.until(Execution::ProgramCompleted).await;
        let ([x, _], _) = limits(&rig);
        assert!((x - 100.0).abs() < 1e-6, "{x}");
    });
}

#[test]
fn m1d_after_a_high_override_the_motion_is_planned_for_100_percent_again() {
    on_machine("", |rig| async move {
        feed_override(&rig, 200.0).await;
        rig.start(&g500("ta50 td50 ts0 G01 F3000\nX290\nM30\n")).await;
        rig.sleep(0.8).await;
        feed_override(&rig, 100.0).await;
        rig.sleep(2.2).await;
        rig.trace();
        rig.sleep(0.1).await;
        let ([x, _], _) = limits(&rig);
        assert!((x - 50.0).abs() < 1e-6, "{x}");
        rig.until(Execution::ProgramCompleted).await;
        close(rig.at().await, [290.0, 0.0, 0.0]);
        assert_eq!(rig.alarms().await, [0_u16; 0]);
    });
}

#[test]
fn m1i_overrides_to_200_percent_at_any_moment_stay_on_the_g500_path() {
    on_machine("", |rig| async move {
        for n in 0..12 {
            rig.start(&g500(STAIRS)).await;
            for feed in [150.0, 90.0, 200.0, 0.0, 130.0, 100.0, 200.0]
                .into_iter()
                .cycle()
                .skip(n)
                .take(7)
            {
                rig.sleep(0.0137 * (n + 1) as f64).await;
                feed_override(&rig, feed).await;
                if n % 3 == 0 {
                    rig.cs.hold().await.unwrap();
                    if rig.state().await.0 == Execution::FeedHold {
                        rig.cs.resume().await.unwrap();
                    }
                }
            }
            feed_override(&rig, 120.0).await;
            rig.until(Execution::ProgramCompleted).await;
            close(rig.at().await, [40.0, 40.0, 0.0]);
            rig.trace().into_iter().for_each(assert_on_stairs);
            rig.cs.mdi("G90 G00 X0 Y0").await.unwrap();
            rig.trace();
        }
        assert_eq!(rig.alarms().await, [0_u16; 0]);
    });
}

#[test]
fn in_dry_run_blocks_move_at_its_feedrate_from_the_next_block_on() {
    on_machine("", |rig| async move {
        let program = "G64 G501 ta50 td50 ts0 G01 F1200\nX10\nM00\nX30\nM30\n";
        rig.start(program).await;
        rig.until(Execution::ProgramStopped).await;
        let ([x, _], _) = limits(&rig);
        assert!((x - 20.0).abs() < 1e-6, "{x}");
        rig.cs.set_dry_run(true).await.unwrap();
        assert!(rig.cs.state().await.unwrap().dry_run);
        rig.cs.resume().await.unwrap();
        rig.until(Execution::ProgramCompleted).await;
        let ([x, _], _) = limits(&rig);
        // Without a configured feedrate, dry run moves at the maximum, 12000 mm/min.
        assert!((x - 200.0).abs() < 1e-6, "{x}");
        rig.cs.set_dry_run(false).await.unwrap();
        assert!(!rig.cs.state().await.unwrap().dry_run);
    });
}
