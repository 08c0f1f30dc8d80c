//! A plan that replaces another plan (M1d, M1i): overrides above 100 percent in G500. The commanded samples
//! respect every limit, and lie on the path of the chain without look-ahead.

use std::cell::Cell;

use proptest::prelude::*;
use tandem_model::flow::SegmentFeed;
use tandem_model::settings::LowOverride;
use tandem_servo::Control;

use crate::look_ahead::{Feeds, feeds, is_fault, jerks, machine, soft_machine, ways};
use crate::planned::Machine;
use crate::rig::{T, close, vector};

/// Plan time between the motion and the start of a new plan, s.
const AHEAD_S: f64 = 0.02;

#[derive(Debug, Clone, Copy)]
enum Act {
    Override(f64),
    Hold,
    Resume,
}

fn acts() -> impl Strategy<Value = Vec<(u32, Act)>> {
    let act = prop_oneof![
        3 => (0.0..=2.0).prop_map(Act::Override),
        2 => (1.0..=2.0).prop_map(Act::Override),
        1 => Just(Act::Override(2.0)),
        1 => Just(Act::Hold),
        2 => Just(Act::Resume),
    ];
    prop::collection::vec((0_u32..150, act), 1..12)
}

/// Executes these acts, each followed by a wait, and sends a new plan with each override. Returns the number
/// of changes to a new plan.
/// has changed to a new plan.
fn run(machine: &mut Machine, acts: impl IntoIterator<Item = (u32, Act)>) -> Result<u32, TestCaseError> {
    let mut pending = None;
    let mut taken = 0;
    for (wait, act) in acts {
        match act {
            Act::Override(factor) => {
                machine.rig.control(Control::Override {
                    feed: factor,
                    rapid: 1.0,
                });
                if pending.is_none() {
                    let is_replanned = machine.planner.settings().motion.low_override == LowOverride::Replan;
                    let planned = if is_replanned { factor } else { factor.max(1.0) };
                    machine.planner.set_feed_override(planned);
                    if let Some(place) = machine.planner.place_ahead(machine.place(), AHEAD_S) {
                        let new = machine.planner.replan(place, false);
                        machine.splice(Some(place), new.profiles.clone());
                        pending = Some(new);
                    }
                }
            }
            Act::Hold => machine.rig.control(Control::Hold),
            Act::Resume => machine.rig.control(Control::Resume),
        }
        for _ in 0..=wait {
            machine.cycles(1);
            let off = machine.off_the_path();
            prop_assert!(off < 1e-9, "{off} off the path");
            if let Some(is_taken) = machine.settled()
                && let Some(new) = pending.take()
                && is_taken
            {
                machine.planner.adopt(new);
                taken += 1;
            }
        }
    }
    Ok(taken)
}

#[test]
fn m1d_override_up_to_200_percent_keeps_motor_limits_and_the_path() {
    let taken = Cell::new(0);
    let accelerations = prop_oneof![Just(300.0), Just(2000.0), Just(10_000.0)];
    let slews_ms = prop_oneof![Just(0.0), Just(50.0), Just(500.0)];
    proptest!(ProptestConfig::with_cases(100), |(
        ways in ways(),
        feed in feeds(),
        acceleration in accelerations,
        jerk in jerks(),
        slew_ms in slews_ms,
        acts in acts(),
    )| {
        let mut settings = soft_machine(acceleration, jerk);
        settings.hold_slew_ms = slew_ms;
        settings.override_slew_ms = slew_ms;
        settings.max_feedrate_mm_min = 30_000.0;
        let last = ways.len() as u64;
        let mut machine = Machine::new(&settings, &ways, feed);
        let acts = acts.into_iter().chain([(0, Act::Override(1.5)), (50, Act::Resume)]);
        taken.set(taken.get() + run(&mut machine, acts)?);
        machine.until_finished(last);
        let (worst, fastest) = (machine.watch.worst, machine.watch.fastest);
        prop_assert!(worst <= acceleration * (1.0 + 1e-6), "{worst} of {acceleration}");
        prop_assert!(fastest <= 500.0 * (1.0 + 1e-6), "{fastest} of 500");
        prop_assert!(!machine.events.iter().any(is_fault), "{:?}", machine.events);
        prop_assert_eq!(machine.rig.position(), machine.profiles[machine.profiles.len() - 1].end_position());
    });
    assert!(taken.get() > 0, "no case has taken another plan");
}

pub fn slow_feed() -> SegmentFeed {
    SegmentFeed {
        feedrate_mm_min: 6000.0,
        ta_ms: 100.0,
        td_ms: 100.0,
        ts_ms: 0.0,
        ..SegmentFeed::default()
    }
}

#[test]
fn m1d_straight_path_at_200_percent_runs_at_twice_its_feedrate() {
    let mut machine = Machine::new(&machine(2000.0), &[(400.0, 0.0, false)], slow_feed());
    machine.rig.control(Control::Override {
        feed: 2.0,
        rapid: 1.0,
    });
    machine.planner.set_feed_override(2.0);
    machine.cycles(500);
    let place = machine.planner.place_ahead(machine.place(), AHEAD_S).unwrap();
    let new = machine.planner.replan(place, false);
    machine.splice(Some(place), new.profiles);
    machine.cycles(1500);
    assert_eq!(machine.settled(), Some(true));
    // F6000 is 100 mm/s.
    let before = machine.rig.x();
    machine.cycles(100);
    close((machine.rig.x() - before) / (100.0 * T), 200.0);
    machine.until_finished(1);
    assert_eq!(machine.rig.position(), vector(&[400.0]));
}

#[test]
fn a_splice_at_a_place_that_was_passed_is_refused_and_the_plan_goes_on() {
    let mut machine = Machine::new(
        &machine(2000.0),
        &[(40.0, 0.0, false), (0.0, 40.0, false)],
        slow_feed(),
    );
    let place = machine.planner.place_ahead(machine.place(), 0.0).unwrap();
    machine.cycles(550);
    let new = machine.planner.replan(place, false);
    machine.splice(Some(place), new.profiles);
    machine.cycles(1);
    assert_eq!(machine.settled(), Some(false));
    machine.until_finished(2);
}

/// The motion switches within a profile that still waits when the cycle begins, and brakes in this profile.
#[test]
fn m1d_motor_reserve_holds_beyond_a_joint_inside_the_next_profile() {
    let ways = [
        (-5.642_462_133_969_372, 2.121_901_928_205_308, false),
        (0.0, -0.098_640_607_440_271_02, false),
        (0.0, -0.000_447_152_430_459_286_36, false),
        (0.0, -0.004_171_090_578_906_256, false),
        (0.0, -0.002_457_003_740_044_554_4, false),
        (0.0, 13.906_204_736_275_857, false),
        (0.0, 0.020_496_013_273_529_75, false),
        (0.0, 0.000_215_746_784_709_557_56, false),
        (-18.834_760_552_182_694, 7.178_908_512_507_611, true),
        (-0.908_082_539_516_207_9, 0.0, false),
    ];
    let feed = SegmentFeed {
        feedrate_mm_min: 22_484.411_134_740_116,
        ta_ms: 0.0,
        td_ms: 0.0,
        ts_ms: 20.0,
        ..SegmentFeed::default()
    };
    let mut settings = machine(10_000.0);
    settings.motion.low_override = LowOverride::TimeBase;
    settings.hold_slew_ms = 0.0;
    settings.override_slew_ms = 0.0;
    settings.max_feedrate_mm_min = 30_000.0;
    let mut machine = Machine::new(&settings, &ways, feed);
    machine.cycles(34);
    let acts = [
        (31, Act::Override(0.853_428_328_172_644_7)),
        (101, Act::Override(1.633_936_764_157_459_6)),
        (24, Act::Override(0.0)),
        (0, Act::Override(1.5)),
    ];
    assert!(run(&mut machine, acts).unwrap() > 0);
    machine.cycles(50);
    let worst = machine.watch.worst;
    assert!(worst <= 10_000.0 * (1.0 + 1e-6), "{worst} of 10000");
}

/// The new plan is too slow at its position, so the previous plan continues, and begins to brake in that
/// cycle.
#[test]
fn m1d_what_the_motors_leave_counts_beyond_a_joint_that_is_not_taken() {
    let ways = [
        1e-5,
        1e-5,
        0.575_004_872_492_585_3,
        0.013_046_212_132_387_599,
        0.017_416_348_355_887_64,
        0.790_190_810_471_544_9,
        0.893_676_196_346_224_7,
        12.889_086_737_073_278,
        1e-5,
        15.263_361_061_549_388,
    ];
    let feeds = Feeds {
        feed: SegmentFeed {
            feedrate_mm_min: 4_387.144_858_601_284,
            ta_ms: 0.0,
            td_ms: 0.0,
            ts_ms: 0.0,
            ..SegmentFeed::default()
        },
        shares: [
            0.159_835_947_443_025_23,
            0.290_483_633_901_503_2,
            0.381_213_824_696_106_43,
        ],
    };
    let mut settings = machine(300.0);
    settings.hold_slew_ms = 0.0;
    settings.override_slew_ms = 0.0;
    settings.max_feedrate_mm_min = 30_000.0;
    let mut machine = Machine::new(&settings, &ways.map(|x| (x, 0.0, false)), feeds);
    machine.cycles(217);
    let acts = [
        (14, Act::Override(1.0)),
        (63, Act::Override(0.823_436_806_033_084_4)),
        (91, Act::Override(0.096_912_700_785_529_38)),
        (57, Act::Resume),
        (108, Act::Override(0.792_834_821_365_274_8)),
        (97, Act::Override(0.862_478_985_465_089_3)),
        (136, Act::Override(2.0)),
    ];
    assert!(run(&mut machine, acts).unwrap() > 0);
    let acts = [(0, Act::Override(1.5)), (50, Act::Resume)];
    run(&mut machine, acts).unwrap();
    machine.until_finished(10);
    let worst = machine.watch.worst;
    assert!(worst <= 300.0 * (1.0 + 1e-6), "{worst} of 300");
}
