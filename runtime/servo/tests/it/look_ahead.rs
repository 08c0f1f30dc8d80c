//! G500 in the servo cycle (M1d, M1i): limits at any override up to 100 percent, through holds, and when
//! profiles come late. The tests of the motion crate prove the plan. Here the commanded samples are checked:
//! their second difference is a mean of the acceleration, so it never exceeds the bound of the acceleration.

use std::collections::VecDeque;

use proptest::prelude::*;
use tandem_model::flow::{MultiBlock, Path, Segment, SegmentEnd, SegmentFeed, SegmentMotion};
use tandem_model::plane::{Plane, Turn};
use tandem_model::profile::{Law, Profile};
use tandem_model::settings::CoordinateSystemSettings;
use tandem_model::{ArcPath, AxisVector};
use tandem_motion::Planner;
use tandem_servo::{Control, Event};

use crate::rig::{Rig, T, close, is_finished, is_stopped, origin, settings, vector};

/// Distance of each block in X and Y, mm, and whether the block is an arc.
pub type BlockDistance = (f64, f64, bool);

/// Feeds of a program: each block in turn runs at its share of a feedrate, and at F600 at least.
#[derive(Debug, Clone, Copy)]
pub struct Feeds {
    pub feed: SegmentFeed,
    pub shares: [f64; 3],
}

impl From<SegmentFeed> for Feeds {
    fn from(feed: SegmentFeed) -> Self {
        Self {
            feed,
            shares: [1.0; 3],
        }
    }
}

impl Feeds {
    /// Returns the feed of block n.
    pub fn of(&self, n: usize) -> SegmentFeed {
        SegmentFeed {
            feedrate_mm_min: (self.feed.feedrate_mm_min * self.shares[n % self.shares.len()]).max(600.0),
            ..self.feed
        }
    }
}

pub fn machine(acceleration: f64) -> CoordinateSystemSettings {
    let mut settings = settings();
    for motor in settings.motors.iter_mut().flatten() {
        motor.max_acceleration = acceleration;
    }
    settings
}

/// Returns a machine with a maximum jerk.
pub fn soft_machine(acceleration: f64, jerk: Option<f64>) -> CoordinateSystemSettings {
    let mut settings = machine(acceleration);
    for motor in settings.motors.iter_mut().flatten() {
        motor.max_jerk = jerk;
    }
    settings
}

/// Number of blocks for motors with a maximum jerk.
const BLOCKS_WITHIN_JERK: usize = 10;

/// Largest number of cycles of a motion.
const CYCLES_MAX: u32 = 1_000_000;

/// Maximum jerks: none, or jerks with which 2000 mm/s^2 take half a second or 50 ms.
pub fn jerks() -> impl Strategy<Value = Option<f64>> {
    prop_oneof![2 => Just(None), 1 => Just(Some(4000.0)), 1 => Just(Some(40_000.0))]
}

/// Returns distances for motors with this maximum jerk. Their motion takes long, so fewer blocks are sufficient.
fn within_jerk(mut ways: Vec<BlockDistance>, jerk: Option<f64>) -> Vec<BlockDistance> {
    if jerk.is_some() {
        ways.truncate(BLOCKS_WITHIN_JERK);
    }
    ways
}

pub fn plan(
    settings: &CoordinateSystemSettings,
    ways: &[BlockDistance],
    feeds: impl Into<Feeds>,
) -> Vec<Profile> {
    let mut planner = Planner::new(settings);
    let mut out = VecDeque::new();
    push(&mut planner, ways, feeds, &mut out);
    out.into()
}

/// Pushes blocks with these distances, starting at zero; the last block ends at rest.
pub fn push(
    planner: &mut Planner,
    ways: &[BlockDistance],
    feeds: impl Into<Feeds>,
    out: &mut VecDeque<Profile>,
) {
    let feeds = feeds.into();
    let mut at = AxisVector::ZERO;
    for (n, (x, y, bends)) in ways.iter().enumerate() {
        let to = at.plus(vector(&[*x, *y]));
        let length = to.minus(at).orthogonal_length();
        let path = if *bends {
            // A half circle.
            let centre = [at.0[0] + x / 2.0, at.0[1] + y / 2.0];
            Path::Arc(ArcPath::new(at, to, Plane::Xy, centre, Turn::Clockwise))
        } else {
            Path::Line { from: at, to, length }
        };
        let segment = Segment {
            origin: origin(n as u64 + 1),
            motion: SegmentMotion::Feed {
                path,
                feed: feeds.of(n),
            },
            end: SegmentEnd::Continuous,
            multi_block: MultiBlock::On,
            serial: 0,
        };
        planner.push(&segment, out).unwrap();
        at = to;
    }
    planner.flush(out);
}

/// Checks of the commanded samples.
pub struct Watch {
    before: [AxisVector; 2],
    pub worst: f64,
    /// Largest velocity.
    pub fastest: f64,
}

impl Watch {
    pub fn new() -> Self {
        Self {
            before: [AxisVector::ZERO; 2],
            worst: 0.0,
            fastest: 0.0,
        }
    }

    pub fn cycle(&mut self, rig: &mut Rig) -> Vec<Event> {
        let events = rig.cycle();
        let at = rig.position();
        let [one, two] = self.before;
        for axis in 0..3 {
            let second = (at.0[axis] - 2.0 * one.0[axis] + two.0[axis]) / (T * T);
            self.worst = self.worst.max(second.abs());
            self.fastest = self.fastest.max((at.0[axis] - one.0[axis]).abs() / T);
        }
        self.before = [at, one];
        events
    }
}

pub fn is_fault(event: &Event) -> bool {
    matches!(event, Event::Fault(_))
}

pub fn ways() -> impl Strategy<Value = Vec<BlockDistance>> {
    let size = prop_oneof![Just(20.0), Just(1.0), Just(0.05), Just(0.001)];
    let way = (-1.0..1.0, -1.0..1.0, size, prop::bool::weighted(0.2))
        .prop_map(|(x, y, size, bends): (f64, f64, f64, bool)| (x * size, y * size, bends))
        .prop_filter("moves", |(x, y, _)| x.hypot(*y) > 1e-5);
    let straight = |ways: Vec<BlockDistance>| {
        ways.iter()
            .map(|(x, _, _)| (x.abs() + 1e-5, 0.0, false))
            .collect()
    };
    (prop::collection::vec(way, 1..50), prop::bool::weighted(0.3)).prop_map(move |(ways, is_straight)| {
        if is_straight { straight(ways) } else { ways }
    })
}

pub fn feeds() -> impl Strategy<Value = Feeds> {
    let time = prop_oneof![Just(0.0), Just(1.0), Just(20.0), Just(100.0)];
    let shares = prop_oneof![Just([1.0; 3]), prop::array::uniform3(0.01..1.0)];
    (600.0..30_000.0, time.clone(), time, shares).prop_map(|(feedrate_mm_min, ta_ms, ts_ms, shares)| Feeds {
        feed: SegmentFeed {
            feedrate_mm_min,
            ta_ms,
            td_ms: ta_ms,
            ts_ms,
            ..SegmentFeed::default()
        },
        shares,
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(100))]

    #[test]
    fn m1i_motor_limits_hold_at_any_override_through_holds_and_a_stop(
        ways in ways(),
        feed in feeds(),
        acceleration in prop_oneof![Just(300.0), Just(2000.0), Just(10_000.0)],
        jerk in jerks(),
        hold_slew_ms in prop_oneof![Just(0.0), Just(50.0), Just(500.0)],
        controls in prop::collection::vec((0_u32..200, prop_oneof![
            Just(Control::Hold),
            Just(Control::Resume),
            (0.0..=1.0).prop_map(|feed| Control::Override { feed, rapid: 1.0 }),
            Just(Control::Override { feed: 2.0, rapid: 1.0 }),
        ]), 0..10),
        stops in any::<bool>(),
    ) {
        let mut settings = soft_machine(acceleration, jerk);
        settings.hold_slew_ms = hold_slew_ms;
        settings.override_slew_ms = hold_slew_ms;
        let ways = within_jerk(ways, jerk);
        let profiles = plan(&settings, &ways, feed);
        let end = profiles[profiles.len() - 1].end_position();
        let mut rig = Rig::with_room(&settings, 100_000);
        for profile in profiles {
            rig.push(profile);
        }
        let mut watch = Watch::new();
        for (wait, control) in controls {
            rig.control(control);
            for _ in 0..=wait {
                watch.cycle(&mut rig);
            }
        }
        if stops {
            rig.control(Control::Stop { epoch: 1 });
        }
        rig.control(Control::Resume);
        rig.control(Control::Override { feed: 1.0, rapid: 1.0 });
        let last = ways.len() as u64;
        let mut events = Vec::new();
        for _ in 0..CYCLES_MAX {
            events.extend(watch.cycle(&mut rig));
            if events.iter().any(|event| is_stopped(event) || is_finished(last)(event)) || rig.servo.channel(0).is_idle() {
                break;
            }
        }
        prop_assert!(watch.worst <= acceleration * (1.0 + 1e-6), "{} of {acceleration}", watch.worst);
        prop_assert!(!events.iter().any(is_fault), "{events:?}");
        if !stops {
            prop_assert_eq!(rig.position(), end);
        }
    }

    #[test]
    fn m1d_late_profiles_slow_the_motion_on_its_path_within_the_limits(
        ways in ways(),
        feed in feeds(),
        acceleration in prop_oneof![Just(300.0), Just(2000.0), Just(10_000.0)],
        jerk in jerks(),
        late in prop::collection::vec((1_usize..200, 1_u32..400), 1..20),
    ) {
        let settings = soft_machine(acceleration, jerk);
        // The same distances several times, so that look-ahead outputs them in parts.
        let ways: Vec<BlockDistance> = (0..3).flat_map(|_| within_jerk(ways.clone(), jerk)).collect();
        let profiles = plan(&settings, &ways, feed);
        let end = profiles[profiles.len() - 1].end_position();
        let mut rig = Rig::with_room(&settings, 100_000);
        let mut watch = Watch::new();
        let mut events = Vec::new();
        let mut profiles = profiles.into_iter();
        let mut late = late.into_iter().cycle();
        while profiles.len() > 0 {
            let (some, cycles) = late.next().unwrap();
            for profile in profiles.by_ref().take(some) {
                rig.push(profile);
            }
            for _ in 0..cycles {
                events.extend(watch.cycle(&mut rig));
            }
        }
        for _ in 0..CYCLES_MAX {
            events.extend(watch.cycle(&mut rig));
            if rig.servo.channel(0).is_idle() {
                break;
            }
        }
        prop_assert!(!events.iter().any(is_fault), "{events:?}");
        prop_assert!(watch.worst <= acceleration * (1.0 + 1e-6), "{} of {acceleration}", watch.worst);
        prop_assert_eq!(rig.position(), end);
    }
}

#[test]
fn m1d_what_is_known_always_ends_in_a_stop_on_the_path() {
    let acceleration = 1000.0;
    let settings = machine(acceleration);
    let feed = SegmentFeed {
        feedrate_mm_min: 9000.0,
        ta_ms: 50.0,
        td_ms: 50.0,
        ts_ms: 0.0,
        ..SegmentFeed::default()
    };
    // 400 lines of 2 mm with small changes of Y.
    let ways: Vec<BlockDistance> = (0..400)
        .map(|n| (2.0, if n % 2 == 0 { 0.1 } else { -0.1 }, false))
        .collect();
    let profiles = plan(&settings, &ways, feed);
    let free_to = |profile: &Profile| match &profile.law {
        Law::Paced { pace, .. } => pace.free_to,
        _ => 0,
    };
    let known = profiles
        .iter()
        .position(|profile| (50..400).contains(&free_to(profile)))
        .unwrap();
    let mut rig = Rig::with_room(&settings, 100_000);
    let mut watch = Watch::new();
    for profile in &profiles[..=known] {
        rig.push(profile.clone());
    }
    let mut events = Vec::new();
    for _ in 0..5000 {
        events.extend(watch.cycle(&mut rig));
    }
    let rest = rig.x();
    assert!(rest > 2.0 * free_to(&profiles[known]) as f64, "{rest}");
    assert!(rest < profiles[known].end_position().0[0], "{rest}");
    assert_eq!(watch.cycle(&mut rig), []);
    close(rig.x(), rest);
    for profile in &profiles[known + 1..] {
        rig.push(profile.clone());
    }
    while !events.iter().any(is_finished(400)) {
        events.extend(watch.cycle(&mut rig));
        assert!(!events.iter().any(is_fault));
    }
    assert!(watch.worst <= acceleration * (1.0 + 1e-6), "{}", watch.worst);
    assert_eq!(rig.position(), profiles[profiles.len() - 1].end_position());
}
