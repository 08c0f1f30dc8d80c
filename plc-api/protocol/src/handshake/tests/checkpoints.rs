use serde_json::{Value, json};

use super::*;
use crate::types::output::{CHECKPOINT_MAX, CheckpointReport};
use crate::types::refusal::RefusalCode;

fn checkpoint(
    ledger: &mut Ledger,
    seq: u64,
    handler_id: &str,
    checkpoint: Value,
) -> Result<HandshakeStatus, Refusal> {
    let report = CheckpointReport {
        boot_id: boot(),
        seq,
        handler_id: handler_id.into(),
        instance: None,
        checkpoint,
    };
    let said = OutputRequest::Checkpoint(report);
    ledger
        .execute_request(now(0.0), None, &said)
        .map(|result| result.status)
}

#[test]
fn h21_checkpoint_survives_loss_of_its_owner_until_replaced_or_removed() {
    let mut ledger = ledger();
    let seq = made(&mut ledger, 90);
    let noted = |ledger: &Ledger| ledger.pending().outputs[0].checkpoint.clone();
    let nobody = checkpoint(&mut ledger, seq, "washer", json!(1));
    assert_eq!((nobody, noted(&ledger)), (Ok(HandshakeStatus::NotOwner), None));
    claim(&mut ledger, seq, "washer");
    let owner = checkpoint(&mut ledger, seq, "washer", json!({"minute": 3}));
    assert_eq!(owner, Ok(HandshakeStatus::Accepted));
    let other = checkpoint(&mut ledger, seq, "clamp", json!(9));
    assert_eq!(other, Ok(HandshakeStatus::NotOwner));
    ledger.handler_lost(now(1.0), "washer", None);
    assert_eq!(noted(&ledger), Some(json!({"minute": 3})));
    let how = Redelivery::Redo;
    ledger.redeliver(
        now(2.0),
        None,
        &Redeliver {
            boot_id: boot(),
            seq,
            how,
        },
    );
    assert_eq!(claim(&mut ledger, seq, "washer"), HandshakeStatus::Accepted);
    assert_eq!(
        noted(&ledger),
        Some(json!({"minute": 3})),
        "the next owner has it, too"
    );
    checkpoint(&mut ledger, seq, "washer", json!({"minute": 4})).unwrap();
    assert_eq!(noted(&ledger), Some(json!({"minute": 4})));
    checkpoint(&mut ledger, seq, "washer", Value::Null).unwrap();
    assert_eq!(noted(&ledger), None);
}

#[test]
fn h21_a_checkpoint_that_is_too_long_is_refused_and_the_one_before_stays() {
    let mut ledger = ledger();
    let seq = made(&mut ledger, 90);
    claim(&mut ledger, seq, "washer");
    // the two quotation marks are part of the length
    let longest = "x".repeat(CHECKPOINT_MAX - 2);
    assert!(checkpoint(&mut ledger, seq, "washer", json!(longest)).is_ok());
    let refused = checkpoint(&mut ledger, seq, "washer", json!("y".repeat(CHECKPOINT_MAX - 1))).unwrap_err();
    assert_eq!(refused.code, RefusalCode::Invalid);
    assert!(
        refused.text.contains("4096") && refused.text.contains("4097"),
        "{refused}"
    );
    assert_eq!(ledger.pending().outputs[0].checkpoint, Some(json!(longest)));
}
