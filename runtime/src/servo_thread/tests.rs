mod faults;

use super::*;

#[test]
fn a_cycle_that_is_not_finished_when_the_next_is_due_is_an_overrun() {
    let statistics = ServoStatistics::default();
    let (us, period) = (Duration::from_micros, Duration::from_millis(1));
    for (late, computing) in [(1, 999), (0, 1001), (600, 500), (70_000, 3)] {
        let late = us(late);
        statistics.count(Begin { late, missed: 0 }, us(computing), period);
    }
    let timing = statistics.timing(period);
    assert_eq!((timing.overruns, timing.missed), (3, 0));
    assert!((timing.period_s - 0.001).abs() < 1e-12);
    let in_buckets = |durations: &Durations| -> Vec<(f64, u64)> {
        durations
            .buckets
            .iter()
            .copied()
            .filter(|(_, count)| *count > 0)
            .collect()
    };
    // buckets: below 2 us, 512 to 1024 us, above 32.768 ms
    assert_eq!(
        in_buckets(&timing.lateness),
        [(2e-6, 2), (1024e-6, 1), (f64::INFINITY, 1)]
    );
    assert_eq!(
        in_buckets(&timing.computing),
        [(4e-6, 1), (512e-6, 1), (1024e-6, 2)]
    );
    assert_eq!(timing.lateness.buckets.len(), JITTER_BUCKETS);
    assert!((timing.lateness.sum_s - 0.070_601).abs() < 1e-12);
    assert!((timing.lateness.max_s - 0.07).abs() < 1e-12);
}

#[test]
fn every_cycle_that_is_left_out_is_counted_and_the_next_one_is_on_time() {
    let (start, period) = (Instant::now(), Duration::from_millis(1));
    let us = Duration::from_micros;
    let statistics = ServoStatistics::default();
    let mut timetable = Timetable { period, next: start };
    let mut cycles = 0;
    // cases: on time, delay compensated by the next cycle, omitted cycles
    for (at_us, missed) in [
        (0, 0),
        (1_400, 0),
        (3_900, 0),
        (3_950, 0),
        (4_000, 0),
        (30_005_000, 30_000),
        (30_006_000, 0),
        (30_009_300, 2),
        (30_010_000, 0),
    ] {
        let begin = timetable.begin_cycle(start + us(at_us));
        assert_eq!(begin.missed, missed, "at {at_us} us");
        statistics.count(begin, us(3), period);
        cycles += 1;
        let due = u64::try_from((timetable.next - start).as_millis()).unwrap();
        assert_eq!(
            cycles + statistics.timing(period).missed,
            due,
            "each due cycle was computed or counted"
        );
    }
    let timing = statistics.timing(period);
    assert_eq!((timing.missed, timing.overruns), (30_002, 30_005));
    assert_eq!(statistics.cycles.load(Ordering::Relaxed), cycles);
}
