//! Alarms that a sequence program raises.

use plc_api::fake::FakePort;
use plc_api::fake::OutputOutcome;
use plc_api::{Alarm, CancelReason, Execution, Params};

#[tokio::test]
async fn an_alarm_of_the_whole_machine_stops_all_and_a_reset_of_any_clears_it() {
    let fake = FakePort::new([1, 2]);
    let plc = fake.plc();
    let (first, second) = (plc.coordinate_system(1), plc.coordinate_system(2));
    let seq = fake.issue_output(2, 100, Params::default());
    plc.raise_alarm(Alarm::user(20, "low")).await.unwrap();
    assert_eq!(
        fake.closed(2, seq),
        Some(OutputOutcome::Cancelled(CancelReason::Alarm))
    );
    for system in [&first, &second] {
        let state = system.state().await.unwrap();
        assert_eq!((state.execution, state.alarm_count), (Execution::Stopped, 1));
        assert!(system.load(1).await.is_err(), "an alarm is active");
    }
    assert_eq!(plc.alarms().await.unwrap()[0].cs, None);
    first.reset().await.unwrap();
    assert_eq!(plc.alarms().await.unwrap(), []);
    let state = second.state().await.unwrap();
    assert_eq!((state.execution, state.alarm_count), (Execution::Stopped, 0));
    second.load(1).await.unwrap();
}

#[tokio::test]
async fn an_alarm_of_one_coordinate_system_leaves_the_others_alone() {
    let fake = FakePort::new([1, 2]);
    let plc = fake.plc();
    let seq = fake.issue_output(2, 100, Params::default());
    plc.coordinate_system(1)
        .raise_alarm(Alarm::user(21, "jam"))
        .await
        .unwrap();
    assert_eq!(fake.closed(2, seq), None);
    assert_eq!(plc.coordinate_system(2).state().await.unwrap().alarm_count, 0);
    assert!(
        plc.coordinate_system(3)
            .raise_alarm(Alarm::user(21, "jam"))
            .await
            .is_err()
    );
    assert!(plc.raise_alarm(Alarm::user(21, "")).await.is_err(), "no text");
}
