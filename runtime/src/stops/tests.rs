//! Tests of each cell of the table, in simulated time, at moments that a seed determines.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use plc_api::{Alarm, CoordinateSystem, Error, Execution, SequenceProgram};
use plc_protocol::lock_input::LockRules;
use plc_protocol::server::ServerNotice;
use plc_protocol::types::lock::OnLoss;
use plc_protocol::types::state::Reason;
use tandem_runtime::{Config, Machine, Runtime};
use tandem_testing::{Bench, Scene};

use super::*;

/// Maximum delay in s of the published state after the motion, including a servo cycle.
const STATE_S: f64 = 0.01;

/// Time without a heartbeat after which a client is lost.
const TTL: Duration = Duration::from_millis(100);

/// Duration of the omitted servo cycles.
const GAP: Duration = Duration::from_millis(150);

/// Number of moments at which each cell is tested.
const SEEDS: u64 = 3;

const fn ms(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

fn machine() -> Machine {
    let mut machine = Config::demo().resolve().unwrap();
    machine.hold_on_bus_loss = true;
    for system in &mut machine.coordinate_systems {
        system.programs.clear();
        system.locks[0] = LockRules {
            sources: [("door".to_owned(), OnLoss::On)].into(),
            ..LockRules::default()
        };
    }
    machine
}

/// Motion of a cell: one of the motions that a column of the table stands for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum CellMotion {
    Rapid,
    Line,
    Arc,
    Thread,
    Dwell,
    /// A jog without a distance.
    Jog,
    /// A jog with a distance that needs refreshes.
    JogFar,
    /// A step of a jog, without refreshes.
    JogStep,
    Home,
    Compensation,
    RapidReversal,
    LineReversal,
    /// Two arcs, of which the second retraces the first.
    ArcReversal,
}

impl CellMotion {
    /// Returns the column of the table.
    fn column(self) -> StoppedMotion {
        match self {
            Self::Rapid => StoppedMotion::Rapid,
            Self::Line => StoppedMotion::Line,
            Self::Arc => StoppedMotion::Arc,
            Self::Thread => StoppedMotion::Thread,
            Self::Dwell => StoppedMotion::Dwell,
            Self::Jog | Self::JogFar | Self::JogStep => StoppedMotion::Jog,
            Self::Home => StoppedMotion::Home,
            Self::Compensation => StoppedMotion::Compensation,
            Self::RapidReversal | Self::LineReversal | Self::ArcReversal => StoppedMotion::Reversal,
        }
    }

    fn program(self) -> &'static str {
        match self {
            Self::Rapid => "G00 X290\nM30\n",
            Self::Line => "G01 X290 F6000\nM30\n",
            Self::Arc => "G02 X100 Y0 I50 F6000\nM30\n",
            Self::Thread => "S300\nG84 X0 Y0 Z-20 R-5 F300\nG80\nM30\n",
            Self::Dwell => "G04 X3\nM30\n",
            Self::Compensation => "G01 G41 X20 Y0 F6000\nX280\nG40 X290\nM30\n",
            Self::RapidReversal => "G00 X20\nX0\nX20\nX0\nM30\n",
            Self::LineReversal => "G61 G01 X20 F6000\nX0\nX20\nX0\nM30\n",
            Self::ArcReversal => {
                "G61 G02 X20 Y0 I10 F6000\nG03 X0 Y0 I-10\nG02 X20 Y0 I10\nG03 X0 Y0 I-10\nM30\n"
            }
            Self::Jog | Self::JogFar | Self::JogStep | Self::Home => "M30\n",
        }
    }

    /// Returns the speed in mm/min and the distance of a jog.
    fn jog(self) -> (f64, Option<f64>) {
        match self {
            Self::JogStep => (600.0, Some(10.0)),
            Self::JogFar => (6000.0, Some(250.0)),
            _ => (6000.0, None),
        }
    }

    /// Returns X at the end of the motion.
    fn end_x(self) -> f64 {
        match self {
            Self::Rapid | Self::Line | Self::Compensation => 290.0,
            Self::Arc => 100.0,
            Self::Jog => SOFT_LIMIT,
            Self::JogFar => 250.0,
            Self::JogStep => 10.0,
            _ => 0.0,
        }
    }

    /// Returns the distance in mm of a point from the path. `points` are those of the undisturbed motion.
    fn off_path(self, [x, y, z]: [f64; 3], points: &[Setpoint]) -> f64 {
        match self {
            Self::Dwell => x.hypot(y).hypot(z),
            Self::Thread => x.hypot(y),
            Self::Arc => z.hypot((x - 50.0).hypot(y) - 50.0),
            Self::ArcReversal => z.hypot((x - 10.0).hypot(y) - 10.0),
            Self::Compensation => {
                let after = points.partition_point(|point| point.at[0] < x);
                let [from, to] = [after.max(1) - 1, after.min(points.len() - 1)].map(|n| points[n].at);
                let share = if to[0] > from[0] {
                    (x - from[0]) / (to[0] - from[0])
                } else {
                    0.0
                };
                z.hypot(y - from[1] - share * (to[1] - from[1]))
            }
            _ => y.hypot(z),
        }
    }

    /// Returns the state word in which the motion ends if no cause stops it.
    fn ends_in(self) -> Execution {
        match self.column() {
            StoppedMotion::Jog | StoppedMotion::Home => Execution::Ready,
            _ => Execution::ProgramCompleted,
        }
    }
}

/// Upper soft limit of X, at which a jog without a distance ends, mm.
const SOFT_LIMIT: f64 = 500.0;

/// Maximum acceleration of X, Y and Z, mm/s^2.
const ACCELERATION: f64 = 5000.0;

/// Largest distance from the path, mm. The rounded corners of a compensated path are known by their points, which are
/// 0.1 mm apart.
const OFF_PATH_MAX_MM: f64 = 1e-3;

/// Servo period, s.
const PERIOD_S: f64 = 0.001;

/// Pitch of the thread, mm for each turn of the spindle, and its R level.
const THREAD: (f64, f64) = (1.0, -5.0);

/// Setpoints of one servo cycle.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Setpoint {
    at: [f64; 3],
    spindle_deg: f64,
}

/// Setpoints of all servo cycles.
type Setpoints = Arc<Mutex<Vec<Setpoint>>>;

/// Largest speed of a motor between two cycles, mm/s.
fn speed([before, after]: [&Setpoint; 2]) -> f64 {
    let each = std::iter::zip(before.at, after.at).map(|(before, after)| (after - before).abs());
    each.fold(0.0, f64::max) / PERIOD_S
}

fn has_moved([before, after]: [&Setpoint; 2]) -> bool {
    before != after
}

/// Returns the points of a motion without its rests.
fn points(setpoints: &[Setpoint]) -> Vec<Setpoint> {
    let mut points = setpoints.to_vec();
    points.dedup();
    points
}

async fn at(system: &CoordinateSystem, axis: &str) -> f64 {
    system.position().await.unwrap().machine[axis]
}

/// Outcome of a jog: the last command's result.
type JogOutcome = Arc<Mutex<Option<plc_api::Result<()>>>>;

/// Jogs X. A jog that needs no refresh is commanded once, any other is refreshed each millisecond until it has ended.
fn jog(scene: &Scene, motion: CellMotion) -> JogOutcome {
    let (velocity, distance) = motion.jog();
    let outcome = JogOutcome::default();
    let (jogger, refresher, pause) = (scene.cs(1), scene.cs(1), scene.plc().clone());
    let ends = Arc::clone(&outcome);
    tokio::spawn(async move {
        let ended = jogger.jog('X', velocity, distance, "j").await;
        *ends.lock().unwrap() = Some(ended);
    });
    if motion != CellMotion::JogStep {
        tokio::spawn(async move {
            pause.sleep(ms(5)).await;
            while refresher.jog('X', velocity, distance, "j").await.is_ok() {
                pause.sleep(ms(1)).await;
            }
        });
    }
    outcome
}

/// Starts a motion, and returns when it is active.
async fn begin(scene: &Scene, motion: CellMotion, seed: u64, setpoints: &Setpoints) -> JogOutcome {
    let (plc, system) = (scene.plc(), scene.cs(1));
    let mut jogs = JogOutcome::default();
    match motion.column() {
        StoppedMotion::Jog => jogs = jog(scene, motion),
        StoppedMotion::Home => {
            system.mdi("G00 X290").await.unwrap();
            setpoints.lock().unwrap().clear();
            let homing = scene.cs(1);
            tokio::spawn(async move { homing.home(&['X']).await });
        }
        _ => {
            system.select_tool(1).await.unwrap();
            system.load(50).await.unwrap();
            system.start().await.unwrap();
        }
    }
    match motion.column() {
        StoppedMotion::Thread => {
            while at(&system, "Z").await > -6.0 {
                plc.sleep(ms(1)).await;
            }
            plc.sleep(ms(150 * seed)).await;
        }
        StoppedMotion::Reversal => {
            // just before the turning point, at it and just after it
            let turns = |x: f64| x >= 20.0 - [0.5, 1e-9, 1e-9][usize::try_from(seed).unwrap_or(2).min(2)];
            while !turns(at(&system, "X").await) {
                plc.sleep(ms(1)).await;
            }
            plc.sleep(ms(10 * (seed / 2))).await;
        }
        StoppedMotion::Jog => plc.sleep(ms(60 + 20 * seed)).await,
        _ => plc.sleep(ms(150 + 90 * seed)).await,
    }
    jogs
}

async fn raise(scene: &Scene, runtime: &Runtime, cause: StopCause) {
    let system = scene.cs(1);
    match cause {
        StopCause::Interlock => system.set_interlock(true, "the door is open").await.unwrap(),
        StopCause::SourceLost => scene.kill_handlers(),
        StopCause::ServoLate => runtime.simulation().unwrap().delay_servo(GAP),
        StopCause::ClientLost => {
            drop(system.heartbeat(TTL).await.unwrap());
            scene.plc().sleep(TTL).await;
        }
        StopCause::BusLost => runtime.served_port().notice(ServerNotice::BusLink {
            connected: false,
            broker: None,
        }),
        StopCause::Alarm => system.raise_alarm(Alarm::user(1, "no air")).await.unwrap(),
        StopCause::Hold | StopCause::Stop | StopCause::Abort => {
            let commander = scene.cs(1);
            tokio::spawn(async move {
                match cause {
                    StopCause::Hold => commander.hold().await,
                    StopCause::Stop => commander.stop().await,
                    _ => commander.abort().await,
                }
            });
        }
    }
}

/// Waits until no axis moves and no transition is in progress. Returns the waiting time in s.
async fn until_rest(scene: &Scene, max_s: f64) -> f64 {
    let (plc, system) = (scene.plc(), scene.cs(1));
    let from_s = plc.now_s();
    let mut before = system.position().await.unwrap().machine;
    while plc.now_s() - from_s < max_s {
        plc.sleep(ms(1)).await;
        let now = system.position().await.unwrap().machine;
        let state = system.state().await.unwrap();
        let rests = !matches!(state.execution, Execution::Active | Execution::Wait);
        if now == before && state.transition.is_none() && rests {
            return plc.now_s() - from_s;
        }
        before = now;
    }
    f64::INFINITY
}

fn bench(motion: CellMotion, setpoints: &Setpoints) -> Bench {
    let sink = Arc::clone(setpoints);
    Bench::on_machine(machine())
        .serve(SequenceProgram::new().handler_id("door"))
        .subprogram(50, motion.program())
        .on_cycle(move |servo| {
            let channel = servo.channel(0);
            let [x, y, z, ..] = channel.setpoint().0;
            sink.lock().unwrap().push(Setpoint {
                at: [x, y, z],
                spindle_deg: channel.spindle_deg(),
            });
        })
}

/// Plays a motion that no cause stops, and returns its points.
fn undisturbed(motion: CellMotion) -> Vec<Setpoint> {
    let setpoints = Setpoints::default();
    let of_play = Arc::clone(&setpoints);
    let played = bench(motion, &setpoints).play(async move |scene: Scene, _| {
        let system = scene.cs(1);
        system.set_interlock_source("door", false, "").await.unwrap();
        begin(&scene, motion, 0, &of_play).await;
        until_rest(&scene, 60.0).await;
    });
    played.unwrap();
    points(&setpoints.lock().unwrap())
}

/// Setpoints of a play, from the detection of the cause to the rest, and before the motion is resumed.
struct Stop<'a> {
    cell: &'a str,
    motion: CellMotion,
    reaction: StopReaction,
    /// All setpoints of the motion up to the rest.
    setpoints: &'a [Setpoint],
    /// Index of the last setpoint before the cause.
    from: usize,
}

impl Stop<'_> {
    /// Checks that the motion rests within the time limit of its cell.
    fn check_time(&self, hold_slew_ms: f64) {
        let after = &self.setpoints[self.from.saturating_sub(1)..];
        let pairs = || after.windows(2).map(|pair| [&pair[0], &pair[1]]);
        let braking_s = pairs().map(speed).fold(0.0, f64::max) / ACCELERATION;
        let limit_s = self
            .reaction
            .limit_s(self.motion.column(), hold_slew_ms, braking_s);
        let cycles = pairs().rposition(has_moved).map_or(0, |last| last + 1);
        let took_s = cycles as f64 * PERIOD_S;
        if let Some(limit_s) = limit_s {
            assert!(
                took_s <= limit_s + STATE_S,
                "{}: {took_s} s, limit {limit_s} s",
                self.cell
            );
        }
    }

    /// Checks that each motor brakes at most at its maximum acceleration.
    fn check_braking(&self) {
        let after = &self.setpoints[self.from.saturating_sub(2)..];
        for triple in after.windows(3) {
            for axis in 0..3 {
                let [a, b, c] = [0, 1, 2].map(|n: usize| triple[n].at[axis]);
                let acceleration = (c - 2.0 * b + a).abs() / PERIOD_S.powi(2);
                assert!(
                    acceleration <= ACCELERATION * 1.001,
                    "{}: {acceleration}",
                    self.cell
                );
            }
        }
    }
}

/// Checks that each point is on the path, and that the spindle is in phase with Z in a thread.
fn check_path(cell: &str, motion: CellMotion, setpoints: &[Setpoint], undisturbed: &[Setpoint]) {
    let (pitch, r) = THREAD;
    let mut phase: Option<f64> = None;
    for point in setpoints {
        let off = motion.off_path(point.at, undisturbed);
        assert!(
            off < OFF_PATH_MAX_MM,
            "{cell}: {point:?} is {off} mm off its path"
        );
        if motion == CellMotion::Thread && point.at[2] < r {
            let turns_deg = (r - point.at[2]) / pitch * 360.0;
            let now = (point.spindle_deg - turns_deg).rem_euclid(360.0);
            let first = *phase.get_or_insert(now);
            let off_deg = (now - first + 180.0).rem_euclid(360.0) - 180.0;
            assert!(off_deg.abs() < 1e-6, "{cell}: {point:?} is {off_deg} degrees off");
        }
    }
}

fn play(cause: StopCause, motion: CellMotion, seed: u64, undisturbed: &[Setpoint]) {
    let reaction = cause.reaction(motion.column());
    let cell = format!("{cause:?} {motion:?} {seed}");
    let of_play = cell.clone();
    let (setpoints, expected) = (Setpoints::default(), undisturbed.to_vec());
    let trace = Arc::clone(&setpoints);
    let played = bench(motion, &setpoints).play(async move |owned: Scene, runtime| {
        let (cell, scene) = (of_play, &owned);
        let system = scene.cs(1);
        system.set_interlock_source("door", false, "").await.unwrap();
        let jogs = begin(scene, motion, seed, &trace).await;
        let hold_slew_ms = runtime.machine().coordinate_systems[0].settings.hold_slew_ms;
        raise(scene, runtime, cause).await;
        let from = trace.lock().unwrap().len() - 1;
        until_rest(scene, 30.0).await;
        let state = system.state().await.unwrap();
        let all = trace.lock().unwrap().clone();
        let stop = Stop {
            cell: &cell,
            motion,
            reaction,
            setpoints: &all,
            from,
        };
        stop.check_time(hold_slew_ms);
        if reaction == StopReaction::Brakes {
            stop.check_braking();
        } else {
            check_path(&cell, motion, &all, &expected);
        }
        let held = [Execution::FeedHold, Execution::Interrupted].contains(&state.execution);
        match reaction {
            StopReaction::Holds | StopReaction::HoldsInPhase | StopReaction::HoldsAfterThread => {
                assert!(held, "{cell}: {state:?}");
                if motion == CellMotion::Thread {
                    let is_out = at(&system, "Z").await >= THREAD.1 - 1e-9;
                    assert_eq!(is_out, reaction == StopReaction::HoldsAfterThread, "{cell}");
                }
                if reaction == StopReaction::HoldsAfterThread {
                    assert!(expected.starts_with(&points(&all)), "{cell}: as without a hold");
                }
                resume_and_check_end(scene, cause, motion, &cell).await;
                check_path(&cell, motion, &trace.lock().unwrap(), &expected);
            }
            StopReaction::EndsJog => check_ended_jog(scene, motion, &cell, &jogs).await,
            StopReaction::Stops | StopReaction::Brakes => {
                assert_eq!(state.execution, Execution::Stopped, "{cell}");
            }
            // after the thread the program waits for an M code, and the lost broker holds the run there
            StopReaction::Continues if motion == CellMotion::Thread => {
                assert!(at(&system, "Z").await >= THREAD.1 - 1e-9, "{cell}: {state:?}");
            }
            StopReaction::Continues => {
                assert_eq!(state.execution, motion.ends_in(), "{cell}");
                assert!(
                    points(&all) == expected,
                    "{cell}: the motion is as without the cause"
                );
            }
        }
        check_rest(scene, &trace, reaction, &cell).await;
    });
    played.unwrap_or_else(|error| panic!("{cell}: {error}"));
}

/// Checks that a motion that has ended does not start again.
async fn check_rest(scene: &Scene, trace: &Setpoints, reaction: StopReaction, cell: &str) {
    if matches!(
        reaction,
        StopReaction::EndsJog | StopReaction::Stops | StopReaction::Brakes
    ) {
        let before = trace.lock().unwrap().last().map(|last| last.at);
        scene.plc().sleep(ms(500)).await;
        let after = trace.lock().unwrap().last().map(|last| last.at);
        assert_eq!(after, before, "{cell}");
    }
}

/// Checks that a jog has ended within 200 ms, and that a jog with a distance reports the distance covered.
async fn check_ended_jog(scene: &Scene, motion: CellMotion, cell: &str, jogs: &JogOutcome) {
    let system = scene.cs(1);
    scene.plc().sleep(ms(200)).await;
    let state = system.state().await.unwrap();
    assert_eq!(state.execution, Execution::Ready, "{cell}");
    if motion == CellMotion::Jog {
        return;
    }
    let x = at(&system, "X").await;
    let outcome = jogs.lock().unwrap().take();
    match outcome {
        Some(Err(Error::CommandFailed { text, .. })) => {
            assert!(x > 0.0 && x < motion.end_x(), "{cell}: {x}");
            assert!(text.contains(&format!("X {x:.3}")), "{cell}: {text} {x}");
        }
        other => panic!("{cell}: {other:?}"),
    }
}

/// Ends the cause, resumes the motion and checks that it reaches its end.
async fn resume_and_check_end(scene: &Scene, cause: StopCause, motion: CellMotion, cell: &str) {
    let system = scene.cs(1);
    match cause {
        StopCause::Interlock => system.set_interlock(false, "").await.unwrap(),
        StopCause::SourceLost => {
            scene.serve(SequenceProgram::new().handler_id("door"));
            scene.plc().sleep(ms(100)).await;
            system.set_interlock_source("door", false, "").await.unwrap();
        }
        _ => {}
    }
    system
        .resume()
        .await
        .unwrap_or_else(|error| panic!("{cell}: {error}"));
    until_rest(scene, 60.0).await;
    let state = system.state().await.unwrap();
    assert_eq!(state.execution, motion.ends_in(), "{cell}");
    let x = at(&system, "X").await;
    assert!((x - motion.end_x()).abs() < 1e-9, "{cell}: {x}");
}

/// An operator's hold that waits for the end of a thread must not delay a cause that acts in the thread.
#[test]
fn p10_cause_that_acts_in_a_thread_overtakes_a_hold_that_waits() {
    let motion = CellMotion::Thread;
    let act = |cause: &StopCause| cause.reaction(motion.column()) == StopReaction::HoldsInPhase;
    for cause in StopCause::ALL.into_iter().filter(act) {
        let setpoints = Setpoints::default();
        let trace = Arc::clone(&setpoints);
        let played = bench(motion, &setpoints).play(async move |owned: Scene, runtime| {
            let (scene, system) = (&owned, owned.cs(1));
            system.set_interlock_source("door", false, "").await.unwrap();
            begin(scene, motion, 0, &trace).await;
            raise(scene, runtime, StopCause::Hold).await;
            scene.plc().sleep(ms(50)).await;
            assert_eq!(
                system.state().await.unwrap().execution,
                Execution::Active,
                "it waits"
            );
            raise(scene, runtime, cause).await;
            until_rest(scene, 30.0).await;
            let state = system.state().await.unwrap();
            let z = at(&system, "Z").await;
            assert!(z < -5.0, "{cause:?}: Z{z} {state:?}");
            let expected = match cause {
                StopCause::ServoLate => Some(Reason::ServoLate),
                StopCause::ClientLost => Some(Reason::ClientLost),
                _ => Some(Reason::Interlock),
            };
            assert_eq!(state.reason, expected, "{cause:?}");
            resume_and_check_end(scene, cause, motion, &format!("{cause:?}")).await;
        });
        played.unwrap_or_else(|error| panic!("{cause:?}: {error}"));
    }
}

macro_rules! cells {
    ($($name:ident = $motion:ident;)*) => {
        $(#[test]
        fn $name() {
            let undisturbed = undisturbed(CellMotion::$motion);
            for cause in StopCause::ALL {
                for seed in 0..SEEDS {
                    play(cause, CellMotion::$motion, seed, &undisturbed);
                }
            }
        })*
    };
}

cells! {
    p10_each_cause_stops_a_rapid_as_the_table_says = Rapid;
    p10_each_cause_stops_a_line_as_the_table_says = Line;
    p10_each_cause_stops_an_arc_as_the_table_says = Arc;
    p10_each_cause_stops_a_thread_as_the_table_says = Thread;
    p10_each_cause_stops_a_dwell_as_the_table_says = Dwell;
    p10_each_cause_stops_a_jog_as_the_table_says = Jog;
    p10_each_cause_stops_a_jog_with_distance_as_the_table_says = JogFar;
    p10_each_cause_stops_a_step_of_a_jog_as_the_table_says = JogStep;
    p10_each_cause_stops_homing_as_the_table_says = Home;
    p10_each_cause_stops_compensated_motion_as_the_table_says = Compensation;
    p10_each_cause_stops_at_a_rapid_reversal_as_the_table_says = RapidReversal;
    p10_each_cause_stops_at_a_line_reversal_as_the_table_says = LineReversal;
    p10_each_cause_stops_at_an_arc_reversal_as_the_table_says = ArcReversal;
}
