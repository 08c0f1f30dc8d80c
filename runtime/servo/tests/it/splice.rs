//! A plan in place of another one (motion-semantics 1d, 1i): overrides above 100 percent in G500, and back trace. The
//! commanded samples keep every limit, and lie on the path that the chain has without look-ahead.

use std::cell::Cell;
use std::collections::VecDeque;

use proptest::prelude::*;
use rtrb::RingBuffer;
use tandem_model::flow::Feed;
use tandem_model::profile::{Law, PathPlace, Profile};
use tandem_model::settings::CoordinateSystemSettings;
use tandem_motion::Planner;
use tandem_servo::{Control, Event, Splice};

use crate::look_ahead::{Watch, Way, feeds, is_fault, machine, push, ways};
use crate::rig::{Rig, T, close, is_finished, vector};

/// Plan time that a new plan begins ahead of the motion, s.
const AHEAD_S: f64 = 0.02;

/// A machine that runs a planned chain, and can be given new plans.
struct Machine {
    rig: Rig,
    planner: Planner,
    watch: Watch,
    events: Vec<Event>,
    profiles: Vec<Profile>,
}

impl Machine {
    fn new(settings: &CoordinateSystemSettings, ways: &[Way], feed: Feed) -> Self {
        let mut planner = Planner::new(settings);
        let mut out = VecDeque::new();
        push(&mut planner, ways, feed, &mut out);
        let mut rig = Rig::with_room(settings, 100_000);
        let profiles: Vec<Profile> = out.into();
        for profile in &profiles {
            rig.push(profile.clone());
        }
        Self {
            rig,
            planner,
            watch: Watch::new(),
            events: Vec::new(),
            profiles,
        }
    }

    fn cycles(&mut self, n: u32) {
        for _ in 0..n {
            self.events.extend(self.watch.cycle(&mut self.rig));
        }
    }

    fn splice(&mut self, at: Option<PathPlace>, profiles: VecDeque<Profile>) {
        let (mut ring, consumer) = RingBuffer::new(100_000);
        for profile in profiles {
            ring.push(profile).unwrap();
        }
        let splice = Splice {
            at,
            profiles: consumer,
        };
        self.rig.handle.splices.push(splice).unwrap();
        self.rig.control(Control::Splice);
    }

    /// Runs until a splice has been taken or refused.
    fn settled(&mut self) -> Option<bool> {
        let spliced = self.events.iter().rev().find_map(|event| match event {
            Event::Spliced { taken } => Some(*taken),
            _ => None,
        });
        if spliced.is_some() {
            self.events
                .retain(|event| !matches!(event, Event::Spliced { .. }));
            drop(self.rig.handle.unread.pop());
        }
        spliced
    }

    fn place(&self) -> PathPlace {
        let reading = self.rig.reading();
        PathPlace {
            segment: reading.segment,
            plan_s: reading.plan_s,
        }
    }

    fn hold(&mut self) -> PathPlace {
        self.rig.control(Control::Hold);
        for _ in 0..100_000 {
            self.cycles(1);
            let held = self.events.iter().find_map(|event| match event {
                Event::Held { at } => Some(*at),
                _ => None,
            });
            if let Some(at) = held {
                self.events.retain(|event| !matches!(event, Event::Held { .. }));
                return at;
            }
        }
        panic!("not at rest")
    }

    fn until_finished(&mut self, last: u64) {
        for _ in 0..400_000 {
            self.cycles(1);
            if self.events.iter().any(is_finished(last)) {
                return;
            }
        }
        panic!("never finished");
    }

    /// Distance of the command from the way of its block, at the plan time that the servo reads.
    fn off_the_path(&self) -> f64 {
        let place = self.place();
        let block = self
            .profiles
            .iter()
            .find(|profile| profile.segment == place.segment);
        let Some((block, Law::Paced { pace, .. })) = block.map(|block| (block, &block.law)) else {
            return 0.0;
        };
        if place.plan_s.is_infinite() {
            return 0.0;
        }
        let mut law = block.law.clone();
        if let Law::Paced { pace: own, .. } = &mut law {
            // As planned without look-ahead: the rate is 1.
            let mut piece = pace.pieces()[0];
            (piece.begins_s, piece.plan_s, piece.rate, piece.rate_change) = (0.0, 0.0, 1.0, 0.0);
            *own = tandem_model::profile::Pace::new([piece], f64::INFINITY, 1.0, 0);
        }
        let programmed = Profile {
            law,
            duration_s: f64::INFINITY,
            ..block.clone()
        };
        let off = programmed.position(place.plan_s).minus(self.rig.position());
        off.orthogonal_length()
    }
}

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

/// Gives these commands, each followed by a wait, and each override with a new plan; gives how often the motion has gone
/// over to a new plan.
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
                    machine.planner.set_feed_override(factor);
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
fn m1d_an_override_up_to_200_percent_never_passes_the_motors_limits_nor_leaves_the_path() {
    let taken = Cell::new(0);
    let accelerations = prop_oneof![Just(300.0), Just(2000.0), Just(10_000.0)];
    let slews_ms = prop_oneof![Just(0.0), Just(50.0), Just(500.0)];
    proptest!(ProptestConfig::with_cases(100), |(
        ways in ways(),
        feed in feeds(),
        acceleration in accelerations,
        slew_ms in slews_ms,
        acts in acts(),
    )| {
        let mut settings = machine(acceleration);
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
        prop_assert_eq!(machine.rig.position(), machine.profiles[machine.profiles.len() - 1].end());
    });
    assert!(taken.get() > 0, "no case has gone over to another plan");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(100))]

    #[test]
    fn back_trace_goes_back_on_the_path_within_the_limits_and_forward_again_to_the_end(
        ways in ways(),
        feed in feeds(),
        acceleration in prop_oneof![Just(300.0), Just(2000.0), Just(10_000.0)],
        turns in prop::collection::vec((0_u32..400, 1_u32..400), 1..5),
    ) {
        let settings = machine(acceleration);
        let last = ways.len() as u64;
        let mut machine = Machine::new(&settings, &ways, feed);
        for (forward, backward) in turns {
            machine.cycles(forward);
            if machine.rig.servo.channel(0).is_idle() {
                break;
            }
            let at = machine.hold();
            let back = machine.planner.retrace(at);
            let begins = machine.rig.position();
            machine.splice(None, back);
            machine.rig.control(Control::Resume);
            for _ in 0..backward {
                machine.cycles(1);
                let off = machine.off_the_path();
                prop_assert!(off < 1e-9, "{off} off the path");
            }
            prop_assert_eq!(machine.settled(), Some(true));
            let at = machine.hold();
            prop_assert!(at.segment <= last, "{begins:?}");
            let new = machine.planner.replan(at, true);
            machine.splice(None, new.profiles.clone());
            machine.planner.adopt(new);
            machine.rig.control(Control::Resume);
            machine.cycles(1);
            prop_assert_eq!(machine.settled(), Some(true));
            machine.events.clear();
        }
        machine.until_finished(last);
        let worst = machine.watch.worst;
        prop_assert!(worst <= acceleration * (1.0 + 1e-6), "{worst} of {acceleration}");
        prop_assert!(!machine.events.iter().any(is_fault), "{:?}", machine.events);
        prop_assert_eq!(machine.rig.position(), machine.profiles[machine.profiles.len() - 1].end());
    }
}

fn slow_feed() -> Feed {
    Feed {
        feedrate_mm_min: 6000.0,
        ta_ms: 100.0,
        td_ms: 100.0,
        ts_ms: 0.0,
    }
}

#[test]
fn m1d_at_200_percent_a_straight_way_runs_at_twice_its_feedrate_within_the_acceleration() {
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
    // F6000 is 100 mm/s
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

#[test]
fn back_trace_ends_at_rest_at_the_begin_of_the_chain_or_at_a_bar() {
    let mut machine = Machine::new(
        &machine(2000.0),
        &[(40.0, 0.0, false), (0.0, 40.0, false)],
        slow_feed(),
    );
    machine.cycles(650);
    let at = machine.hold();
    let back = machine.planner.retrace(at);
    assert!(
        back.iter()
            .all(|profile| profile.exact_stop == (profile.segment == 1))
    );
    machine.splice(None, back);
    machine.rig.control(Control::Resume);
    machine.events.clear();
    machine.until_finished(1);
    assert_eq!(machine.rig.position(), vector(&[0.0, 0.0]));
    machine.planner.bar_way_back();
    assert_eq!(machine.planner.retrace(at), VecDeque::new());
}

/// The motion goes over in a profile that still waits when the cycle begins, and brakes in it.
#[test]
fn m1d_what_the_motors_leave_counts_beyond_a_joint_that_is_in_the_next_profile() {
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
    let feed = Feed {
        feedrate_mm_min: 22_484.411_134_740_116,
        ta_ms: 0.0,
        td_ms: 0.0,
        ts_ms: 20.0,
    };
    let mut settings = machine(10_000.0);
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
