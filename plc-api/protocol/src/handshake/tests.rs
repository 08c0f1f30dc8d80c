mod checkpoints;

use std::time::SystemTime;

use super::*;
use crate::types::ids::CLIENT_ID_MAX;
use crate::types::m_code::MCodeDeclaration;
use crate::types::output::{Params, ProgressReport, Timing};

fn now(monotonic_s: f64) -> Now {
    Now {
        monotonic_s,
        time: SystemTime::UNIX_EPOCH,
    }
}

fn boot() -> BootId {
    BootId("b1".into())
}

fn spec(m: u16) -> OutputSpec {
    OutputSpec {
        run_id: "r1".into(),
        m,
        params: Params::default(),
        timing: Timing::AfterMotion,
        program: 1,
        line: 3,
        timeout_s: None,
        redelivery: None,
    }
}

fn ledger() -> Ledger {
    Ledger::new(boot(), 1, 64)
}

fn made(ledger: &mut Ledger, m: u16) -> u64 {
    let seq = ledger.enqueue(now(0.0), spec(m)).unwrap();
    ledger.issue_output(now(0.0), seq);
    seq
}

/// Claims as the registered instance. If the handler is not registered, registers it first, without M codes.
fn claim(ledger: &mut Ledger, seq: u64, handler_id: &str) -> HandshakeStatus {
    if ledger.handlers.claimant(handler_id, None).is_err() && ledger.handlers.instance(handler_id).is_none() {
        let presence = HandlerPresence {
            online: true,
            ..HandlerPresence::default()
        };
        ledger.handler_online(now(0.0), handler_id, &presence);
    }
    let instance = ledger.handlers.instance(handler_id);
    claim_as(ledger, seq, handler_id, instance)
}

fn claim_as(ledger: &mut Ledger, seq: u64, handler_id: &str, instance: Option<String>) -> HandshakeStatus {
    let claim = Claim {
        boot_id: boot(),
        seq,
        handler_id: handler_id.into(),
        instance,
    };
    ledger.claim(now(0.0), None, &claim).status
}

fn reset_by(seq: u64, handler_id: &str) -> Reset {
    crate::handshake::reset_of(&boot(), seq, handler_id, None)
}

fn reset(ledger: &mut Ledger, seq: u64, handler_id: &str) -> HandshakeStatus {
    ledger.reset(now(0.0), None, &reset_by(seq, handler_id)).status
}

#[test]
fn h4_a_claim_needs_a_live_registration_and_its_instance() {
    let mut ledger = ledger();
    let seq = made(&mut ledger, 100);
    let by = |ledger: &mut Ledger, instance: Option<&str>| {
        claim_as(ledger, seq, "cell", instance.map(str::to_owned))
    };
    for instance in [None, Some("a")] {
        assert_eq!(
            by(&mut ledger, instance),
            HandshakeStatus::NotOwner,
            "no handler is registered"
        );
    }
    ledger.handler_online(now(0.0), "cell", &exclusive(1, Some("a")));
    for instance in [None, Some("b")] {
        assert_eq!(
            by(&mut ledger, instance),
            HandshakeStatus::NotOwner,
            "{instance:?}"
        );
    }
    assert_eq!(owner(&ledger, seq).0, OutputState::Output);
    for _ in 0..2 {
        assert_eq!(
            by(&mut ledger, Some("a")),
            HandshakeStatus::Accepted,
            "repeated, too"
        );
    }
    assert_eq!(
        reset(&mut ledger, seq, "cell"),
        HandshakeStatus::NotOwner,
        "the claim names no instance"
    );
    ledger.handler_lost(now(1.0), "cell", Some("a"));
    assert_eq!(
        by(&mut ledger, Some("a")),
        HandshakeStatus::NotOwner,
        "its registration has ended"
    );
    ledger.handler_online(now(2.0), "cell", &exclusive(1, Some("b")));
    assert_eq!(
        by(&mut ledger, Some("b")),
        HandshakeStatus::Withheld,
        "the redelivery decides"
    );
    ledger.handler_lost(now(3.0), "cell", Some("b"));
    ledger.handler_online(now(3.0), "cell", &exclusive(1, Some("a")));
    assert_eq!(
        by(&mut ledger, Some("a")),
        HandshakeStatus::Accepted,
        "the instance still works on the output"
    );
}

fn effects(ledger: &mut Ledger) -> Vec<Effect> {
    ledger.take_effects().collect()
}

#[test]
fn h7_pending_is_published_before_the_output_itself() {
    let mut ledger = ledger();
    let seq = made(&mut ledger, 100);
    let effects = effects(&mut ledger);
    let [Effect::PendingChanged, Effect::Output(notice)] = effects.as_slice() else {
        panic!("{effects:?}");
    };
    assert_eq!(
        (notice.seq, notice.m, notice.attempt, notice.redelivered),
        (seq, 100, 1, false)
    );
}

#[test]
fn d33_seq_grows_and_stale_reset_never_frees_a_later_output_of_same_m() {
    let mut ledger = ledger();
    let first = made(&mut ledger, 100);
    assert_eq!(reset(&mut ledger, first, "h"), HandshakeStatus::Accepted);
    let second = made(&mut ledger, 100);
    assert!(second > first);
    assert_eq!(reset(&mut ledger, first, "h"), HandshakeStatus::Duplicate);
    assert!(ledger.is_open(100));
}

#[test]
fn h3_what_is_not_open_is_answered_duplicate_stale_or_unknown() {
    let mut ledger = ledger();
    let other_m = made(&mut ledger, 7);
    let cancelled = made(&mut ledger, 8);
    let queued = ledger.enqueue(now(0.0), spec(9)).unwrap();
    assert_eq!(reset(&mut ledger, queued, "h"), HandshakeStatus::Unknown);
    assert_eq!(
        ledger.reset(now(0.0), Some(8), &reset_by(other_m, "h")).status,
        HandshakeStatus::Unknown
    );
    ledger.cancel_all(now(0.0), CancelReason::Stop);
    assert_eq!(reset(&mut ledger, cancelled, "h"), HandshakeStatus::Stale);
    assert_eq!(reset(&mut ledger, queued, "h"), HandshakeStatus::Unknown);
    assert_eq!(reset(&mut ledger, queued + 1, "h"), HandshakeStatus::Unknown);
    assert_eq!(reset(&mut ledger, 0, "h"), HandshakeStatus::Unknown);
    let mut other_boot = reset_by(cancelled, "h");
    other_boot.boot_id = BootId("b0".into());
    assert_eq!(
        ledger.reset(now(0.0), None, &other_boot).status,
        HandshakeStatus::Stale
    );
}

#[test]
fn h5_only_the_owner_resets_and_force_tells_it() {
    let mut ledger = ledger();
    let seq = made(&mut ledger, 100);
    assert_eq!(claim(&mut ledger, seq, "a"), HandshakeStatus::Accepted);
    assert_eq!(claim(&mut ledger, seq, "a"), HandshakeStatus::Accepted);
    assert_eq!(claim(&mut ledger, seq, "b"), HandshakeStatus::NotOwner);
    assert_eq!(reset(&mut ledger, seq, "b"), HandshakeStatus::NotOwner);
    effects(&mut ledger);
    let mut force = reset_by(seq, "hmi");
    force.force = Some(true);
    let result = ledger.reset(now(0.0), None, &force);
    assert_eq!(result.status, HandshakeStatus::Accepted);
    let cancel = Cancel {
        seq,
        reason: CancelReason::Operator,
    };
    assert_eq!(
        effects(&mut ledger),
        [
            Effect::Cancel { m: 100, cancel },
            Effect::PendingChanged,
            Effect::Closed {
                seq,
                m: 100,
                how: OutputOutcome::Reset
            },
            Effect::Result { m: 100, result },
        ]
    );
}

#[test]
fn h6_a_fault_is_an_alarm_10000_plus_code_with_the_text_unchanged() {
    let mut ledger = ledger();
    let seq = made(&mut ledger, 100);
    effects(&mut ledger);
    let fault = crate::handshake::reset_of(&boot(), seq, "h", Some(Alarm::user(12, "door open")));
    ledger.reset(now(0.0), Some(100), &fault);
    let alarm = Alarm {
        number: 10_012,
        text: "door open".into(),
    };
    let closed = Effect::Closed {
        seq,
        m: 100,
        how: OutputOutcome::Failed { alarm },
    };
    assert!(effects(&mut ledger).contains(&closed));
    assert_eq!(reset(&mut ledger, seq, "h"), HandshakeStatus::Stale);
}

#[test]
fn fault_code_in_the_reserved_alarm_range_is_refused_and_output_stays() {
    let mut ledger = ledger();
    let seq = made(&mut ledger, 100);
    effects(&mut ledger);
    for (code, is_right) in [(10_000, false), (u16::MAX, false), (9_999, true)] {
        let mut fault = crate::handshake::reset_of(&boot(), seq, "h", Some(Alarm::user(0, "x")));
        fault.code = Some(code);
        let answer = ledger.execute_request(now(0.0), Some(100), &OutputRequest::Reset(fault));
        match answer {
            Ok(result) => assert!(is_right && result.status == HandshakeStatus::Accepted, "{code}"),
            Err(refusal) => {
                assert!(!is_right && refusal.text.contains(&code.to_string()), "{refusal}");
                assert_eq!(effects(&mut ledger), []);
            }
        }
    }
}

#[test]
fn h8_the_queue_is_bounded_and_takes_again_after_a_reset() {
    let mut ledger = Ledger::new(boot(), 1, 2);
    let first = made(&mut ledger, 1);
    made(&mut ledger, 2);
    assert_eq!(ledger.enqueue(now(0.0), spec(3)), Err(Full));
    reset(&mut ledger, first, "h");
    assert_eq!(ledger.enqueue(now(0.0), spec(3)), Ok(3));
}

#[test]
fn h11_a_lost_handler_resets_only_as_the_instance_that_worked() {
    for (instance, status) in [
        (Some("a"), HandshakeStatus::Accepted),
        (Some("b"), HandshakeStatus::Withheld),
        (None, HandshakeStatus::Withheld),
    ] {
        let mut ledger = ledger();
        let seq = made(&mut ledger, 100);
        let presence = HandlerPresence {
            online: true,
            instance: Some("a".to_owned()),
            ..HandlerPresence::default()
        };
        ledger.handler_online(now(0.0), "cell", &presence);
        claim_as(&mut ledger, seq, "cell", presence.instance);
        ledger.handler_lost(now(1.0), "cell", Some("a"));
        assert!(ledger.is_lost(seq) && ledger.handlers.instance("cell").is_none());
        let reset = Reset {
            instance: instance.map(str::to_owned),
            ..reset_by(seq, "cell")
        };
        let result = ledger.reset(now(2.0), None, &reset);
        assert_eq!(result.status, status, "{instance:?}");
    }
}

#[test]
fn h11_a_lost_owner_gives_its_claim_back() {
    let mut ledger = ledger();
    let seq = made(&mut ledger, 100);
    claim(&mut ledger, seq, "h");
    ledger.handler_lost(now(1.0), "other", None);
    assert!(!ledger.is_lost(seq));
    ledger.handler_lost(now(1.0), "h", None);
    assert!(ledger.is_lost(seq));
    let pending = &ledger.pending().outputs[0];
    assert_eq!((pending.state, pending.lost), (OutputState::Output, true));
    assert_eq!((pending.output.redelivered, &pending.handler_id), (true, &None));
    let redeliver = Redeliver {
        boot_id: boot(),
        seq,
        how: Redelivery::Verify,
    };
    effects(&mut ledger);
    assert_eq!(
        ledger.redeliver(now(2.0), None, &redeliver),
        HandshakeStatus::Accepted
    );
    assert_eq!(ledger.pending().outputs[0].how, Some(Redelivery::Verify));
    assert!(
        matches!(&effects(&mut ledger)[..], [Effect::PendingChanged, Effect::Output(notice)] if notice.attempt == 2)
    );
    claim(&mut ledger, seq, "h2");
    assert!(!ledger.is_lost(seq));
    assert_eq!(
        ledger.redeliver(now(2.0), None, &redeliver),
        HandshakeStatus::NotOwner
    );
}

#[test]
fn h12_republishing_is_for_unclaimed_outputs_of_the_named_codes() {
    let mut ledger = ledger();
    let (mine, claimed, other) = (made(&mut ledger, 1), made(&mut ledger, 2), made(&mut ledger, 3));
    claim(&mut ledger, claimed, "h");
    effects(&mut ledger);
    ledger.republish(now(0.0), |m| m < 3);
    let again: Vec<u64> = effects(&mut ledger)
        .iter()
        .filter_map(|effect| match effect {
            Effect::Output(notice) if notice.redelivered && notice.attempt == 2 => Some(notice.seq),
            _ => None,
        })
        .collect();
    assert_eq!(again, [mine]);
    assert!(!ledger.get(other).unwrap().notice.redelivered);
}

#[test]
fn d36_the_time_limit_counts_from_output_and_across_owners() {
    let mut ledger = ledger();
    let mut limited = spec(100);
    limited.timeout_s = Some(30.0);
    let seq = ledger.enqueue(now(0.0), limited).unwrap();
    assert_eq!(ledger.next_deadline_s(), None);
    ledger.issue_output(now(10.0), seq);
    claim(&mut ledger, seq, "h");
    ledger.handler_lost(now(20.0), "h", None);
    assert_eq!(ledger.next_deadline_s(), Some(40.0));
    ledger.expire(now(39.9));
    assert!(ledger.is_open(100));
    ledger.expire(now(40.0));
    assert!(ledger.is_empty());
    assert_eq!(
        effects(&mut ledger).last(),
        Some(&Effect::Closed {
            seq,
            m: 100,
            how: OutputOutcome::TimedOut
        })
    );
    assert_eq!(reset(&mut ledger, seq, "h"), HandshakeStatus::Stale);
}

#[test]
fn d34_a_cancel_tells_every_handler_once_and_queued_outputs_none() {
    let mut ledger = ledger();
    let first = made(&mut ledger, 1);
    let queued = ledger.enqueue(now(0.0), spec(2)).unwrap();
    effects(&mut ledger);
    ledger.cancel_all(now(0.0), CancelReason::Abort);
    let how = OutputOutcome::Cancelled(CancelReason::Abort);
    assert_eq!(
        effects(&mut ledger),
        [
            Effect::Cancel {
                m: 1,
                cancel: Cancel {
                    seq: first,
                    reason: CancelReason::Abort
                }
            },
            Effect::PendingChanged,
            Effect::Closed {
                seq: first,
                m: 1,
                how: how.clone()
            },
            Effect::Closed {
                seq: queued,
                m: 2,
                how
            },
        ]
    );
}

#[test]
fn h18_texts_and_ids_from_outside_are_limited() {
    let mut ledger = ledger();
    let seq = made(&mut ledger, 1);
    let long_id = "h".repeat(CLIENT_ID_MAX + 1);
    assert_eq!(claim(&mut ledger, seq, &long_id), HandshakeStatus::NotOwner);
    assert_eq!(claim(&mut ledger, seq, ""), HandshakeStatus::NotOwner);
    claim(&mut ledger, seq, "h");
    let report = ProgressReport {
        boot_id: boot(),
        seq,
        handler_id: "h".into(),
        text: "x".repeat(500),
        percent: Some(250.0),
        instance: None,
    };
    assert_eq!(
        ledger.progress(now(0.0), None, &report),
        HandshakeStatus::Accepted
    );
    let progress = ledger.get(seq).unwrap().progress().cloned().unwrap();
    assert_eq!(
        (progress.text.len(), progress.percent),
        (PROGRESS_TEXT_MAX, Some(100.0))
    );
}

#[test]
fn h13_lost_output_keeps_its_progress_until_the_next_claim() {
    let mut ledger = ledger();
    let seq = made(&mut ledger, 1);
    assert_eq!(claim(&mut ledger, seq, "h"), HandshakeStatus::Accepted);
    let report = ProgressReport {
        boot_id: boot(),
        seq,
        handler_id: "h".into(),
        text: "90 of 180 degrees".into(),
        percent: Some(50.0),
        instance: None,
    };
    ledger.progress(now(0.5), None, &report);
    ledger.handler_lost(now(1.0), "h", None);
    let kept = ledger.get(seq).unwrap().progress().cloned().unwrap();
    assert_eq!(
        (kept.text.as_str(), kept.percent),
        ("90 of 180 degrees", Some(50.0))
    );
    ledger.redeliver(
        now(2.0),
        None,
        &Redeliver {
            boot_id: boot(),
            seq,
            how: Redelivery::Redo,
        },
    );
    assert_eq!(claim(&mut ledger, seq, "h"), HandshakeStatus::Accepted);
    assert_eq!(ledger.get(seq).unwrap().progress(), None);
}

#[test]
fn h3_reset_beyond_the_closed_limit_is_stale_and_within_it_a_duplicate() {
    let mut ledger = ledger();
    let last = CLOSED_REMEMBERED as u64 + 1;
    for _ in 0..last {
        let seq = made(&mut ledger, 1);
        reset(&mut ledger, seq, "h");
        effects(&mut ledger);
    }
    assert_eq!(reset(&mut ledger, 1, "h"), HandshakeStatus::Stale);
    assert_eq!(reset(&mut ledger, 2, "h"), HandshakeStatus::Duplicate);
    assert_eq!(reset(&mut ledger, last, "h"), HandshakeStatus::Duplicate);
}

fn exclusive(m: u16, instance: Option<&str>) -> HandlerPresence {
    HandlerPresence {
        online: true,
        handles: vec![HandledCode { cs: 1, m }],
        instance: instance.map(str::to_owned),
        exclusive: true,
        ..HandlerPresence::default()
    }
}

fn owner(ledger: &Ledger, seq: u64) -> (OutputState, Option<String>, Option<String>) {
    let pending = ledger.pending();
    let output = pending
        .outputs
        .iter()
        .find(|output| output.output.seq == seq)
        .unwrap();
    (output.state, output.handler_id.clone(), output.instance.clone())
}

#[test]
fn h20_output_of_one_exclusive_handler_is_claimed_when_issued() {
    let mut ledger = ledger();
    ledger.handler_online(now(0.0), "mill", &exclusive(100, Some("i1")));
    let seq = made(&mut ledger, 100);
    let of_mill = (
        OutputState::Claimed,
        Some("mill".to_owned()),
        Some("i1".to_owned()),
    );
    assert_eq!(owner(&ledger, seq), of_mill);
    let [Effect::PendingChanged, Effect::Output(notice)] = &effects(&mut ledger)[..] else {
        panic!("one pending and the output")
    };
    assert_eq!((notice.seq, notice.attempt), (seq, 1));
    assert_eq!(reset(&mut ledger, seq, "other"), HandshakeStatus::NotOwner);
    let by_mill = Reset {
        instance: Some("i1".to_owned()),
        ..reset_by(seq, "mill")
    };
    let status = ledger.reset(now(0.0), None, &by_mill).status;
    assert_eq!(status, HandshakeStatus::Accepted);
    let of_others = made(&mut ledger, 101);
    assert_eq!(owner(&ledger, of_others).0, OutputState::Output);
}

#[test]
fn h20_shared_uninstanced_or_duplicate_handler_claims_by_message() {
    let shared = HandlerPresence {
        exclusive: false,
        ..exclusive(100, Some("i1"))
    };
    let beside = [exclusive(100, Some("i1")), exclusive(100, Some("i2"))];
    for handlers in [
        &[shared][..],
        &[exclusive(100, None)],
        &[exclusive(100, Some("~17"))],
        &beside,
    ] {
        let mut ledger = ledger();
        for (place, presence) in handlers.iter().enumerate() {
            ledger.handler_online(now(0.0), &format!("h{place}"), presence);
        }
        let seq = made(&mut ledger, 100);
        assert_eq!(
            owner(&ledger, seq),
            (OutputState::Output, None, None),
            "{handlers:?}"
        );
    }
}

#[test]
fn h20_immediate_claim_is_lost_with_its_handler_and_never_repeated() {
    let mut ledger = ledger();
    let presence = exclusive(100, Some("i1"));
    ledger.handler_online(now(0.0), "mill", &presence);
    let seq = made(&mut ledger, 100);
    ledger.handler_lost(now(1.0), "mill", Some("i1"));
    assert!(ledger.is_lost(seq));
    let lost_instance = ledger.pending().outputs[0].lost_instance.clone();
    assert_eq!(
        lost_instance.as_deref(),
        Some("i1"),
        "the instance may start when it has returned"
    );
    ledger.handler_online(now(2.0), "mill", &exclusive(100, Some("i2")));
    assert_eq!(owner(&ledger, seq), (OutputState::Output, None, None));
    assert_eq!(claim(&mut ledger, seq, "mill"), HandshakeStatus::Withheld);
    ledger.handler_lost(now(3.0), "mill", None);
    let later = made(&mut ledger, 100);
    assert_eq!(owner(&ledger, later).0, OutputState::Output, "none is online");
}

#[test]
fn h11_redelivery_of_one_m_code_overrides_the_handler_default() {
    let of = |m, redelivery| MCodeDeclaration {
        m,
        redelivery: Some(redelivery),
        ..MCodeDeclaration::default()
    };
    let presence = HandlerPresence {
        online: true,
        handles: [10, 60, 95].map(|m| HandledCode { cs: 1, m }).to_vec(),
        redelivery: Some(Redelivery::Ask),
        m_codes: vec![of(60, Redelivery::Redo), of(95, Redelivery::Verify)],
        ..HandlerPresence::default()
    };
    for (m, status, how) in [
        (10, HandshakeStatus::Withheld, Redelivery::Ask),
        (60, HandshakeStatus::Accepted, Redelivery::Redo),
        (95, HandshakeStatus::Accepted, Redelivery::Verify),
    ] {
        let mut ledger = ledger();
        ledger.handler_online(now(0.0), "cell", &presence);
        let seq = made(&mut ledger, m);
        claim(&mut ledger, seq, "cell");
        ledger.handler_lost(now(1.0), "cell", None);
        assert_eq!(ledger.pending().outputs[0].redelivery, Some(how), "M{m}");
        ledger.handler_online(now(2.0), "cell", &presence);
        assert_eq!(claim(&mut ledger, seq, "cell"), status, "M{m}");
    }
}
