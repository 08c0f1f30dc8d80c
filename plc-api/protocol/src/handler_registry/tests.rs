use std::time::UNIX_EPOCH;

use super::*;

fn presence(online: bool, instance: Option<&str>) -> HandlerPresence {
    HandlerPresence {
        online,
        handles: vec![HandledCode { cs: 1, m: 100 }],
        instance: instance.map(ToOwned::to_owned),
        ..HandlerPresence::default()
    }
}

fn set(
    handlers: &mut HandlerRegistry,
    id: &str,
    presence: &HandlerPresence,
) -> Result<PresenceEffect, Refusal> {
    handlers.set(id, presence, UNIX_EPOCH, 0.0)
}

const ONLINE: Result<PresenceEffect, Refusal> = Ok(PresenceEffect::Online {
    took_over: None,
    forgotten: None,
    has_returned: false,
});

const OFFLINE: PresenceEffect = PresenceEffect::Offline(Departure::Unannounced { until_s: 0.0 });

#[test]
fn a_lost_handlers_codes_wait_for_the_grace_time() {
    let mut handlers = HandlerRegistry::with_grace(2.0);
    let mut at = |now_s, said: HandlerPresence| handlers.set("cell", &said, UNIX_EPOCH, now_s);
    at(0.0, presence(true, Some("a"))).unwrap();
    let lost = PresenceEffect::Offline(Departure::Unannounced { until_s: 7.0 });
    for now_s in [5.0, 6.0] {
        let will = HandlerPresence::offline(Some("a".to_owned()));
        assert_eq!(at(now_s, will), Ok(lost.clone()), "a second will changes nothing");
    }
    assert_eq!(handlers.back_s(1, 100, 6.9), Some(7.0));
    assert_eq!(handlers.back_s(1, 100, 7.0), None);
    let back = handlers.set("cell", &presence(true, Some("b")), UNIX_EPOCH, 6.9);
    assert_eq!(back, ONLINE);
    assert_eq!(handlers.back_s(1, 100, 6.9), None);
}

#[test]
fn a_code_is_served_in_its_coordinate_system_while_its_handler_is_there() {
    let mut handlers = HandlerRegistry::default();
    assert_eq!(set(&mut handlers, "gripper", &presence(true, None)), ONLINE);
    assert!(handlers.serve(1, 100));
    assert!(!handlers.serve(2, 100) && !handlers.serve(1, 101));
    let gone = set(&mut handlers, "gripper", &presence(false, None));
    assert_eq!(gone, Ok(OFFLINE));
    assert!(!handlers.serve(1, 100) && !handlers.is_online("gripper") && !handlers.is_online("x"));
    assert_eq!(handlers.all().len(), 1);
}

#[test]
fn codes_of_a_returning_handler_are_awaited_until_return_or_deadline() {
    let mut handlers = HandlerRegistry::default();
    let mut at = |now_s, said: HandlerPresence| handlers.set("cell", &said, UNIX_EPOCH, now_s);
    let leaves = |ms| HandlerPresence {
        returns_within_ms: Some(ms),
        ..HandlerPresence::offline(Some("a".to_owned()))
    };
    for wrong in [
        leaves(0),
        leaves(3_600_001),
        HandlerPresence {
            online: true,
            ..leaves(9)
        },
    ] {
        let refusal = at(0.0, wrong).unwrap_err();
        assert!(refusal.text.contains("1 to 3600000"), "{refusal}");
    }
    at(0.0, presence(true, Some("a"))).unwrap();
    let announced = PresenceEffect::Offline(Departure::Announced { until_s: 6.0 });
    assert_eq!(at(1.0, leaves(5000)), Ok(announced.clone()));
    let will = HandlerPresence::offline(Some("a".to_owned()));
    assert_eq!(at(2.0, will), Ok(announced), "a last will changes nothing");
    assert!(!handlers.serve(1, 100));
    assert_eq!(handlers.back_s(1, 100, 2.0), Some(6.0));
    assert_eq!(handlers.back_s(1, 101, 2.0), None);
    assert_eq!(handlers.back_s(1, 100, 6.0), None, "its time has passed");
    handlers
        .set("cell", &presence(true, Some("b")), UNIX_EPOCH, 3.0)
        .unwrap();
    assert_eq!(handlers.back_s(1, 100, 3.0), None, "the handler has returned");
    assert!(handlers.serve(1, 100));
}

#[test]
fn p14_declarations_of_an_absent_handler_apply_while_it_may_return() {
    let declared = MCodeDeclaration {
        m: 100,
        name: Some("clamp".to_owned()),
        ..MCodeDeclaration::default()
    };
    let mut handlers = HandlerRegistry::with_grace(2.0);
    let online = HandlerPresence {
        m_codes: vec![declared.clone()],
        ..presence(true, Some("a"))
    };
    handlers.set("cell", &online, UNIX_EPOCH, 0.0).unwrap();
    let of_cell = [("cell".to_owned(), declared)];
    assert_eq!(handlers.declarations(1, 100, 0.0), of_cell);
    assert_eq!(handlers.next_absence_end_s(0.0), None);
    let will = HandlerPresence::offline(Some("a".to_owned()));
    for now_s in [5.0, 6.0] {
        handlers.set("cell", &will, UNIX_EPOCH, now_s).unwrap();
        assert_eq!(
            handlers.declarations(1, 100, 6.9),
            of_cell,
            "a second will changes nothing"
        );
    }
    assert_eq!(handlers.next_absence_end_s(6.9), Some(7.0));
    assert_eq!(handlers.declarations(1, 100, 7.0), []);
    assert_eq!(handlers.declarations(2, 100, 6.9), []);
    assert_eq!(handlers.next_absence_end_s(7.0), None);
}

#[test]
fn a_second_instance_is_refused_in_words_and_the_first_may_come_again() {
    let mut handlers = HandlerRegistry::default();
    set(&mut handlers, "cell", &presence(true, Some("a"))).unwrap();
    for other in [Some("b"), None] {
        let refusal = set(&mut handlers, "cell", &presence(true, other)).unwrap_err();
        assert_eq!(refusal.code, RefusalCode::HandlerTaken);
        for word in ["cell", "instance a", "1970-01-01", "take_over"] {
            assert!(refusal.text.contains(word), "{refusal}");
        }
    }
    assert_eq!(set(&mut handlers, "cell", &presence(true, Some("a"))), ONLINE);
    assert_eq!(set(&mut handlers, "other", &presence(true, Some("b"))), ONLINE);
}

#[test]
fn an_instance_that_has_gone_takes_nothing_from_the_one_that_is_there() {
    let mut handlers = HandlerRegistry::default();
    set(&mut handlers, "cell", &presence(true, Some("a"))).unwrap();
    for other in [Some("b"), None] {
        let said = set(&mut handlers, "cell", &presence(false, other));
        assert_eq!(said, Ok(PresenceEffect::Nothing));
        assert!(handlers.is_online("cell"));
    }
    let said = set(&mut handlers, "cell", &presence(false, Some("a")));
    assert_eq!(said, Ok(OFFLINE));
    assert_eq!(set(&mut handlers, "cell", &presence(true, Some("b"))), ONLINE);
}

#[test]
fn instance_that_does_not_confirm_its_presence_is_replaced_by_the_next() {
    let mut handlers = HandlerRegistry::default();
    let mut at =
        |now_s: f64, instance| handlers.set("cell", &presence(true, Some(instance)), UNIX_EPOCH, now_s);
    at(0.0, "a").unwrap();
    assert!(at(10.0, "b").is_err(), "a is asked");
    assert!(at(11.9, "b").is_err(), "instance a still has time to confirm");
    at(11.95, "a").unwrap();
    assert!(at(12.0, "b").is_err(), "a has confirmed; asked again");
    assert!(at(13.0, "c").is_err());
    let Ok(PresenceEffect::Online {
        took_over: Some(displaced),
        ..
    }) = at(14.0, "b")
    else {
        panic!("instance a has not confirmed");
    };
    let DisplacedInstance {
        presence,
        text,
        departure,
    } = *displaced;
    assert_eq!(presence.instance.as_deref(), Some("a"));
    assert_eq!(departure, Departure::Unannounced { until_s: 14.0 });
    assert!(text.contains("instance b") && text.contains("2 s"), "{text}");
    assert!(at(14.0, "a").is_err());
}

#[test]
fn repeated_presence_with_expiry_refreshes_and_confirms_the_instance() {
    let mut handlers = HandlerRegistry::default();
    let aging = |instance, expires_ms| HandlerPresence {
        expires_ms,
        ..presence(true, Some(instance))
    };
    let mut at = |now_s, said: HandlerPresence| handlers.set("cell", &said, UNIX_EPOCH, now_s);
    assert_eq!(at(0.0, aging("a", Some(900))), ONLINE);
    assert_eq!(at(0.3, aging("a", Some(900))), Ok(PresenceEffect::Refreshed));
    assert!(at(0.4, aging("b", None)).is_err());
    assert_eq!(at(2.3, aging("a", Some(900))), Ok(PresenceEffect::Refreshed));
    assert!(at(2.5, aging("b", None)).is_err(), "instance a has confirmed");
    assert_eq!(at(2.6, aging("a", Some(600))), ONLINE, "another presence");
    assert_eq!(at(2.7, aging("a", None)), ONLINE);
    assert_eq!(at(2.8, aging("a", None)), ONLINE, "a presence without an age");
    for wrong in [0, 299, 3_600_001] {
        let refusal = at(3.0, aging("a", Some(wrong))).unwrap_err();
        assert_eq!(refusal.code, RefusalCode::Invalid);
        assert!(refusal.text.contains("300 to 3600000"), "{refusal}");
    }
}

#[test]
fn only_an_instance_that_names_itself_is_asked() {
    for (instance, asked) in [(Some("a"), Some("a")), (Some("~mqtt-a"), None), (None, None)] {
        let mut handlers = HandlerRegistry::default();
        set(&mut handlers, "cell", &presence(true, instance)).unwrap();
        assert_eq!(handlers.instance_to_confirm("cell"), None);
        set(&mut handlers, "cell", &presence(true, Some("b"))).unwrap_err();
        assert_eq!(handlers.instance_to_confirm("cell"), asked);
        let later = handlers.set("cell", &presence(true, Some("b")), UNIX_EPOCH, 100.0);
        assert_eq!(later.is_ok(), asked.is_some());
    }
}

#[test]
fn a_polling_instance_keeps_its_place_while_its_presence_lives() {
    let mut handlers = HandlerRegistry::default();
    let mut at = |now_s, presence: &HandlerPresence| {
        handlers.set_over(Reach::Polling, "cell", presence, (UNIX_EPOCH, now_s))
    };
    let aging = HandlerPresence {
        expires_ms: Some(30_000),
        ..presence(true, Some("a"))
    };
    at(0.0, &aging).unwrap();
    for now_s in [1.0, 5.0, 9.0] {
        let refusal = at(now_s, &presence(true, Some("b"))).unwrap_err();
        assert_eq!(refusal.code, RefusalCode::HandlerTaken);
    }
    at(30.0, &presence(false, Some("a"))).unwrap();
    assert_eq!(at(30.0, &presence(true, Some("b"))), ONLINE);
    assert_eq!(handlers.instance_to_confirm("cell"), None);
}

#[test]
fn one_that_is_to_take_over_takes_the_place_of_the_other() {
    let mut handlers = HandlerRegistry::default();
    set(&mut handlers, "cell", &presence(true, Some("a"))).unwrap();
    let new = HandlerPresence {
        take_over: true,
        ..presence(true, Some("b"))
    };
    let Ok(PresenceEffect::Online {
        took_over: Some(displaced),
        ..
    }) = set(&mut handlers, "cell", &new)
    else {
        panic!("the other instance has not taken over");
    };
    let (old, text) = (displaced.presence, displaced.text);
    assert_eq!(displaced.departure, Departure::TakenOver);
    assert_eq!(old.instance.as_deref(), Some("a"));
    assert!(text.contains("instance b") && text.contains("cell"), "{text}");
    let shown = handlers.all()["cell"].clone();
    assert_eq!((shown.instance.as_deref(), shown.take_over), (Some("b"), false));
}

#[test]
fn full_registry_evicts_an_offline_handler_and_never_an_online_one() {
    let mut handlers = HandlerRegistry::default();
    for n in 0..HANDLERS_MAX {
        set(&mut handlers, &n.to_string(), &presence(n != 7, None)).unwrap();
    }
    assert_eq!(
        set(&mut handlers, "0", &presence(true, None)),
        ONLINE,
        "known already"
    );
    let forgotten = Some("7".to_owned());
    let said = set(&mut handlers, "a", &presence(true, None));
    assert_eq!(
        said,
        Ok(PresenceEffect::Online {
            took_over: None,
            forgotten,
            has_returned: false,
        })
    );
    let refusal = set(&mut handlers, "b", &presence(true, None)).unwrap_err();
    assert_eq!(refusal.code, RefusalCode::Unavailable);
}

#[test]
fn instance_that_was_offline_has_returned_and_a_new_one_has_not() {
    let mut handlers = HandlerRegistry::default();
    for (online, instance, returned) in [
        (true, "a", Some(false)),
        (true, "a", Some(false)),
        (false, "a", None),
        (true, "a", Some(true)),
        (true, "a", Some(false)),
        (false, "a", None),
        (true, "b", Some(false)),
    ] {
        let said = set(&mut handlers, "cell", &presence(online, Some(instance))).unwrap();
        let has_returned = match said {
            PresenceEffect::Online { has_returned, .. } => Some(has_returned),
            _ => None,
        };
        assert_eq!(has_returned, returned, "{online} {instance}");
    }
}

#[test]
fn an_instance_is_one_level_of_a_topic() {
    let mut handlers = HandlerRegistry::default();
    for wrong in ["", "a/b", &"x".repeat(65)] {
        let refusal = set(&mut handlers, "cell", &presence(true, Some(wrong))).unwrap_err();
        assert_eq!(refusal.code, RefusalCode::Invalid, "{wrong}");
    }
}
