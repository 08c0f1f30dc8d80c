//! The scan-cycle style over the same handshake.

use std::sync::{Arc, Mutex};

use plc_api::fake::FakePort;
use plc_api::handshake::Closed;
use plc_api::scan::Image;
use plc_api::types::output::OutputState;
use plc_api::types::request::Request;
use plc_api::{Alarm, CancelReason, Params, Redelivery, SequenceProgram};

use crate::{ms, serve, va};

#[tokio::test]
async fn an_output_is_a_flag_with_parameters_and_a_reset_is_written_as_one() {
    let fake = FakePort::new([1, 2]);
    let seen = Arc::new(Mutex::new(Vec::new()));
    let noted = Arc::clone(&seen);
    let program = SequenceProgram::new().scan([20, 21], ms(10), move |image: &mut Image| {
        let flag = image.params(1, 20).and_then(Params::a);
        noted.lock().unwrap().push((image.time_s(), flag));
        if image.scans() >= 3 {
            image.reset(1, 20);
            image.fail(2, 21, Alarm::user(4, "jammed"));
        }
    });
    let _task = serve(&fake, program.handler_id("plc")).await;
    let (reset, failed) = (
        fake.put_out(1, 20, va(7.0)),
        fake.put_out(2, 21, Params::default()),
    );
    fake.advance(ms(25)).await;
    assert_eq!(fake.pending(1)[0].state, OutputState::Claimed);
    assert_eq!(fake.closed(1, reset), None);
    fake.advance(ms(15)).await;
    assert_eq!(fake.closed(1, reset), Some(Closed::Reset));
    let alarm = Alarm::user(4, "jammed");
    assert_eq!(fake.closed(2, failed), Some(Closed::Failed { alarm }));
    let seen = seen.lock().unwrap();
    let times: Vec<_> = seen.iter().map(|(time_s, _)| (time_s * 1000.0).round()).collect();
    assert_eq!(times, [0.0, 10.0, 20.0, 30.0, 40.0], "every 10 ms");
    let flags: Vec<_> = seen.iter().map(|(_, flag)| *flag).collect();
    assert_eq!(flags, [None, Some(7.0), Some(7.0), Some(7.0), None]);
}

#[tokio::test]
async fn a_cancelled_output_is_off_and_a_reset_reaches_no_later_one() {
    let fake = FakePort::new([1]);
    let program = SequenceProgram::new().scan(20, ms(10), |image: &mut Image| {
        // it has seen the first output only, and resets what it has seen
        if image.output(1, 20).is_some_and(|output| output.seq() == 1) {
            image.reset(1, 20);
        }
    });
    let _task = serve(&fake, program).await;
    let first = fake.put_out(1, 20, Params::default());
    fake.settle().await;
    fake.cancel(1, CancelReason::Stop);
    let second = fake.put_out(1, 20, Params::default());
    fake.advance(ms(100)).await;
    assert_eq!(fake.closed(1, first), Some(Closed::Cancelled(CancelReason::Stop)));
    assert_eq!(fake.closed(1, second), None);
}

#[tokio::test]
async fn what_a_scan_writes_is_carried_out_after_it() {
    let fake = FakePort::new([1]);
    let program = SequenceProgram::new().scan(20, ms(10), |image: &mut Image| {
        image.progress(1, 20, "the door closes", 50.0);
        if image.is_on(1, 20) && image.scans() == 1 {
            image.select_tool(1, 5);
            image.command(1, plc_api::types::command::Command::Hold);
        }
    });
    let _task = serve(&fake, program).await;
    fake.put_out(1, 20, Params::default());
    fake.advance(ms(15)).await;
    assert_eq!(
        fake.pending(1)[0].progress.as_ref().unwrap().text,
        "the door closes"
    );
    let requests = fake.requests();
    assert!(matches!(requests[0], Request::Tool(1, 5)), "{requests:?}");
    assert!(
        matches!(requests[1], Request::Command { cs: 1, .. }),
        "{requests:?}"
    );
    assert_eq!(requests.len(), 2);
}

#[tokio::test]
async fn a_scan_program_that_panics_gives_its_outputs_back() {
    let fake = FakePort::new([1]);
    let program = SequenceProgram::new().scan(20, ms(10), |image: &mut Image| {
        assert!(!image.is_on(1, 20), "not built for M20");
    });
    let task = serve(&fake, program.on_redelivery(Redelivery::Ask)).await;
    fake.put_out(1, 20, Params::default());
    fake.advance(ms(15)).await;
    let error = task.await.unwrap().unwrap_err().to_string();
    assert!(error.contains("not built for M20"), "{error}");
    assert!(fake.pending(1)[0].lost);
}

#[tokio::test]
async fn handlers_and_scans_share_a_sequence_program_and_no_code() {
    let both = || SequenceProgram::new().scan([20, 21], ms(10), |_: &mut Image| {});
    let nothing = async |_: plc_api::AuxOutput| Ok(());
    assert_eq!(both().on(22, nothing).check(), Ok(()));
    let twice = both().on(21, nothing).check().unwrap_err().to_string();
    assert!(twice.contains("M21 has two handlers"), "{twice}");
    let short = SequenceProgram::new().scan(20, std::time::Duration::ZERO, |_: &mut Image| {});
    assert!(short.check().is_err());
}

#[tokio::test]
async fn a_scan_of_one_coordinate_system_serves_no_other() {
    let fake = FakePort::new([1, 2]);
    let program = SequenceProgram::new().in_coordinate_system(2, |loader| {
        loader.scan(20, ms(10), |image: &mut Image| {
            image.reset(1, 20);
            image.reset(2, 20);
        })
    });
    let _task = serve(&fake, program).await;
    let (mill, loader) = (
        fake.put_out(1, 20, Params::default()),
        fake.put_out(2, 20, Params::default()),
    );
    fake.advance(ms(50)).await;
    assert_eq!(fake.closed(1, mill), None);
    assert_eq!(fake.pending(1)[0].state, OutputState::Output, "nobody claims it");
    assert_eq!(fake.closed(2, loader), Some(Closed::Reset));
}
