//! A ring too short for the path to rest (M1d: the known profiles always end in a planned stop). The motion
//! is slower, stays on its path and within its limits, and never runs out of profiles.

use proptest::prelude::*;
use tandem_model::flow::{Path, Segment, SegmentEnd, SegmentFeed, SegmentMotion};
use tandem_model::profile::Profile;
use tandem_model::settings::CoordinateSystemSettings;
use tandem_servo::{Control, Event};

use crate::look_ahead::{BlockDistance, Watch, is_fault, jerks, machine, plan, soft_machine};
use crate::rig::{Rig, T, close, is_finished, settings};

/// Runs profiles through a ring that is refilled before each cycle; returns the number of cycles.
fn run(
    settings: &CoordinateSystemSettings,
    room: usize,
    feed_override: f64,
    profiles: &[Profile],
) -> (u32, Watch) {
    let last = profiles[profiles.len() - 1].segment;
    let mut rig = Rig::with_room(settings, room);
    rig.control(Control::Override {
        feed: feed_override,
        rapid: 1.0,
    });
    let mut watch = Watch::new();
    let mut waiting = profiles.iter().cloned().peekable();
    for cycle in 1..1_000_000 {
        while rig.handle.profiles.slots() > 0
            && let Some(profile) = waiting.next()
        {
            rig.push(profile);
        }
        let events: Vec<Event> = watch.cycle(&mut rig);
        assert!(
            !events.iter().any(is_fault),
            "{events:?} at {}",
            rig.position().0[0]
        );
        if events.iter().any(is_finished(last)) {
            assert_eq!(rig.position(), profiles[profiles.len() - 1].end_position());
            return (cycle, watch);
        }
    }
    panic!("it never ends");
}

fn fast() -> SegmentFeed {
    SegmentFeed {
        feedrate_mm_min: 9000.0,
        ta_ms: 20.0,
        td_ms: 20.0,
        ts_ms: 0.0,
        ..SegmentFeed::default()
    }
}

/// Returns lines along X with small changes of Y.
fn lines(n: usize, length: f64) -> Vec<BlockDistance> {
    (0..n)
        .map(|k| (length, if k % 2 == 0 { 0.1 } else { -0.1 } * length, false))
        .collect()
}

#[test]
fn m1d_g500_ring_shorter_than_the_stopping_distance_only_slows_motion() {
    let acceleration = 1000.0;
    let settings = machine(acceleration);
    for length in [1e-3, 0.02, 0.5] {
        let profiles = plan(&settings, &lines(600, length), fast());
        let (long, _) = run(&settings, 100_000, 1.0, &profiles);
        let (short, watch) = run(&settings, 16, 1.0, &profiles);
        assert!(short > long, "{length}: {short} {long}");
        assert!(
            watch.worst <= acceleration * (1.0 + 1e-6),
            "{length}: {}",
            watch.worst
        );
    }
}

/// The same blocks with G501.
fn with_g501(settings: &CoordinateSystemSettings, ways: &[BlockDistance], feed: SegmentFeed) -> Vec<Profile> {
    let mut planner = tandem_motion::Planner::new(settings);
    let mut out = std::collections::VecDeque::new();
    let mut from = tandem_model::AxisVector::ZERO;
    for (n, (x, y, _)) in (1..).zip(ways) {
        let to = from.plus(crate::rig::vector(&[*x, *y]));
        let length = to.minus(from).orthogonal_length();
        let motion = SegmentMotion::Feed {
            path: Path::Line { from, to, length },
            feed,
        };
        let segment = Segment {
            origin: crate::rig::origin(n),
            motion,
            end: SegmentEnd::Continuous,
            multi_block: tandem_model::flow::MultiBlock::Off,
            serial: 0,
        };
        planner.push(&segment, &mut out).unwrap();
        from = to;
    }
    planner.flush(&mut out);
    out.into()
}

#[test]
fn m1b_g501_ring_shorter_than_the_stopping_distance_only_slows_motion() {
    let settings = settings();
    for length in [1e-4, 1e-3, 0.02, 0.5] {
        let profiles = with_g501(&settings, &lines(600, length), fast());
        for feed_override in [0.3, 1.0, 2.0] {
            let (long, _) = run(&settings, 100_000, feed_override, &profiles);
            let (short, _) = run(&settings, 16, feed_override, &profiles);
            assert!(short >= long, "{length}: {short} {long}");
        }
    }
}

#[test]
fn m1d_a_chain_of_which_the_ring_holds_only_picoseconds_comes_to_its_end() {
    let settings = settings();
    for length in [1e-12, 1e-9, 1e-7] {
        let ways = lines(100, length);
        for profiles in [
            plan(&settings, &ways, fast()),
            with_g501(&settings, &ways, fast()),
        ] {
            for room in [1, 2, 4] {
                let (_, watch) = run(&settings, room, 1.0, &profiles);
                assert!(watch.worst <= 5000.0, "{length}, {room}: {}", watch.worst);
            }
        }
    }
}

#[test]
fn m1b_chain_beyond_the_blocks_per_period_limit_slows_and_never_jumps() {
    // At F a period contains 10,000 blocks of 2e-5 mm, at 200 percent 20,000; 4,096 are passed. Then a block
    // of 20 mm follows.
    let settings = settings();
    let ways: Vec<BlockDistance> = std::iter::repeat_n((2e-5, 0.0, false), 60_000)
        .chain([(20.0, 0.0, false)])
        .collect();
    let mut feed = fast();
    feed.feedrate_mm_min = 12_000.0;
    for feed_override in [1.0, 2.0] {
        let profiles = with_g501(&settings, &ways, feed);
        let mut rig = Rig::with_room(&settings, profiles.len());
        rig.control(Control::Override {
            feed: feed_override,
            rapid: 1.0,
        });
        let last = profiles[profiles.len() - 1].segment;
        for profile in profiles {
            rig.push(profile);
        }
        let step = feed.feedrate_mm_min / 60.0 * feed_override * T;
        for _ in 0..10_000 {
            let before = rig.x();
            let ended = rig.cycle().iter().any(is_finished(last));
            let gone = rig.x() - before;
            assert!((-1e-9..=step + 1e-9).contains(&gone), "{gone} mm in a period");
            if ended {
                break;
            }
        }
        close(rig.x(), 21.2);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    #[test]
    fn m1d_in_a_ring_of_any_size_chains_never_run_out_or_exceed_limits(
        ways in prop::collection::vec((-1.0..1.0, -1.0..1.0, prop::bool::weighted(0.2)), 20..60),
        size in prop_oneof![Just(5.0), Just(0.2), Just(0.01), Just(0.001)],
        room in 2_usize..200,
        acceleration in prop_oneof![Just(300.0), Just(5000.0)],
        jerk in jerks(),
        feed_override in 0.1..1.0,
    ) {
        let ways: Vec<BlockDistance> = ways
            .into_iter()
            .map(|(x, y, bends): (f64, f64, bool)| (x * size, (y + 0.01) * size, bends))
            .collect();
        let settings = soft_machine(acceleration, jerk);
        let profiles = plan(&settings, &ways, fast());
        let (_, watch) = run(&settings, room, feed_override, &profiles);
        prop_assert!(watch.worst <= acceleration * (1.0 + 1e-6), "{} of {acceleration}", watch.worst);
    }
}
