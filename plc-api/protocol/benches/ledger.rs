//! Benchmarks of the handshake ledger, in operations per second. Run them with `cargo bench -p plc-api`.
//!
//! One operation is one call of the ledger, which queues, issues, claims or resets an output. After each call
//! the benchmark takes the effects of the ledger, as the coordinator does.

use std::time::SystemTime;

use divan::Bencher;
use divan::counter::ItemsCount;
use plc_protocol::handshake::{Ledger, Now, OutputSpec};
use plc_protocol::types::BootId;
use plc_protocol::types::output::Params;
use plc_protocol::types::output::{Claim, HandlerPresence, Reset, ResetResult, Timing};

const NOW: Now = Now {
    monotonic_s: 0.0,
    time: SystemTime::UNIX_EPOCH,
};

fn main() {
    divan::main();
}

fn spec() -> OutputSpec {
    OutputSpec {
        run_id: "1-1".to_owned(),
        m: 100,
        params: Params::default(),
        timing: Timing::WithMotion,
        program: 1,
        line: 1,
        timeout_s: Some(30.0),
        redelivery: None,
    }
}

/// Measures one output from its creation to its reset: four operations, while `open` other outputs are open.
// one sample contains 100 outputs, because one output takes only as long as 20 ticks of the clock
#[divan::bench(args = [0, 8, 63], sample_size = 100)]
fn life_of_an_output(bencher: Bencher<'_, '_>, open: usize) {
    let boot_id = BootId("boot".to_owned());
    let mut ledger = Ledger::new(boot_id.clone(), 1, 64);
    let presence = HandlerPresence {
        online: true,
        ..HandlerPresence::default()
    };
    ledger.handler_online(NOW, "magazine", &presence);
    for _ in 0..open {
        let seq = ledger.enqueue(NOW, spec()).unwrap_or_default();
        ledger.issue_output(NOW, seq);
    }
    let mut effects = 0;
    bencher.counter(ItemsCount::new(4_usize)).bench_local(|| {
        let seq = ledger.enqueue(NOW, spec()).unwrap_or_default();
        effects += ledger.take_effects().count();
        ledger.issue_output(NOW, seq);
        effects += ledger.take_effects().count();
        let claim = Claim {
            boot_id: boot_id.clone(),
            seq,
            handler_id: "magazine".to_owned(),
            instance: None,
        };
        divan::black_box(ledger.claim(NOW, Some(100), &claim));
        effects += ledger.take_effects().count();
        let reset = Reset {
            boot_id: boot_id.clone(),
            seq,
            handler_id: "magazine".to_owned(),
            result: ResetResult::Ok,
            code: None,
            text: None,
            force: None,
            instance: None,
        };
        divan::black_box(ledger.reset(NOW, Some(100), &reset));
        effects += ledger.take_effects().count();
    });
    divan::black_box(effects);
}

/// Measures a claim of an output of an earlier boot, as a handler may send it after a reconnection.
#[divan::bench]
fn stale_claim(bencher: Bencher<'_, '_>) {
    let mut ledger = Ledger::new(BootId("boot".to_owned()), 1, 64);
    let claim = Claim {
        boot_id: BootId("before".to_owned()),
        seq: 7,
        handler_id: "magazine".to_owned(),
        instance: None,
    };
    bencher.counter(ItemsCount::new(1_usize)).bench_local(|| {
        divan::black_box(ledger.claim(NOW, Some(100), &claim));
        ledger.take_effects().count()
    });
}
