//! Conditions of commands over REST: a key, a revision.

use serde_json::json;

use super::served;
use crate::support::http::{Answer, request_with};
use crate::support::served::Served;

async fn post(served: &Served, path: &str, headers: &str) -> Answer {
    let path = format!("/api/v1{path}");
    request_with(&served.http, "POST", &path, "", "", headers).await
}

#[tokio::test]
async fn the_same_key_twice_is_one_effect_and_the_stored_reply() {
    let (_machine, served) = served();
    served.load(1, 50, "M30\n").await;
    let key = "Idempotency-Key: shift 2/1\r\n";
    let both = tokio::join!(
        post(&served, "/cs/1/start?wait=1", key),
        post(&served, "/cs/1/start?wait=1", key)
    );
    // the later request may receive 202, because the start is under way
    let done = if both.0.status == 200 { both.0 } else { both.1 };
    let first = done.expect(200).json();
    assert_eq!(
        (&first["command_id"], &first["status"]),
        (&json!("shift 2/1"), &json!("done"))
    );
    let run_id = served.execution(1, "PROGRAM_COMPLETED").await["run_id"].clone();
    // long after, and from a state in which a start would run it again
    let again = post(&served, "/cs/1/start?wait=1", key).await.expect(200);
    assert_eq!(again.json(), first);
    let accepted = post(&served, "/cs/1/start", key).await.expect(202);
    assert_eq!(
        accepted.header("location"),
        Some("/api/v1/commands/shift%202%2F1")
    );
    let status = served.get("/commands/shift%202%2F1").await.expect(200);
    assert_eq!(status.json(), first);
    assert_eq!(served.state(1).await["run_id"], run_id);
    // another key is another command
    post(&served, "/cs/1/start?wait=1", "Idempotency-Key: shift 2/2\r\n")
        .await
        .expect(200);
    let next = served.execution(1, "PROGRAM_COMPLETED").await;
    assert_ne!(next["run_id"], run_id);
}

#[tokio::test]
async fn who_sends_a_key_again_while_it_is_carried_out_waits_for_its_end_too() {
    let (_machine, served) = served();
    served.load(1, 50, "G01 X250 F600\nM30\n").await;
    served.command(1, "start").await;
    // the hold takes its slew time until the machine rests
    let hold = "/cs/1/hold?wait=1";
    let key = "Idempotency-Key: hold 1\r\n";
    let both = tokio::join!(post(&served, hold, key), post(&served, hold, key));
    assert_eq!(both.0.expect(200).json(), both.1.expect(200).json());
    assert_eq!(served.state(1).await["execution"], "FEED_HOLD");
}

#[tokio::test]
async fn a_refused_key_stays_refused_as_it_was() {
    let (_machine, served) = served();
    let key = "Idempotency-Key: early\r\n";
    let refused = post(&served, "/cs/1/start?wait=1", key).await.expect(409).json();
    served.load(1, 50, "M30\n").await;
    let again = post(&served, "/cs/1/start?wait=1", key).await.expect(409).json();
    assert_eq!(
        (&again["code"], &again["detail"]),
        (&refused["code"], &refused["detail"])
    );
    assert_eq!(served.state(1).await["execution"], "READY");
}

#[tokio::test]
async fn a_command_for_a_state_that_has_changed_is_412_and_does_nothing() {
    let (_machine, served) = served();
    let rev = async || {
        let state = served.get("/cs/1/state").await.expect(200);
        let tag = state.header("etag").expect("an ETag").to_owned();
        assert_eq!(tag, format!("\"{}\"", state.json()["rev"]));
        format!("If-Match: {tag}\r\n")
    };
    let before = rev().await;
    served.load(1, 50, "M100\nM30\n").await;
    let refused = post(&served, "/cs/1/start?wait=1", &before).await.expect(412);
    assert_eq!(refused.header("content-type"), Some("application/problem+json"));
    assert_eq!(refused.json()["code"], "precondition_failed");
    assert_eq!(served.state(1).await["execution"], "READY");
    post(&served, "/cs/1/start?wait=1", &rev().await)
        .await
        .expect(200);
    served.execution(1, "WAIT").await;
}
