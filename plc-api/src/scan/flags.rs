//! M codes that are on for a scan program.

use std::sync::{Arc, Mutex, MutexGuard};

use tokio::sync::oneshot;

use crate::alarm::Alarm;
use crate::handlers::AuxOutput;
use crate::lock::lock;
use crate::types::CoordinateSystemNumber;

/// Outputs that are on, with the receivers of their answers.
#[derive(Clone, Default)]
pub(crate) struct Flags(Arc<Mutex<Vec<Flag>>>);

struct Flag {
    output: AuxOutput,
    answer: oneshot::Sender<std::result::Result<(), Alarm>>,
}

fn key(output: &AuxOutput) -> (CoordinateSystemNumber, u64) {
    (output.coordinate_system(), output.seq())
}

impl Flags {
    /// The handler of every output of a scan program: it is on until a scan answers.
    pub(crate) async fn on(self, output: AuxOutput) -> std::result::Result<(), Alarm> {
        let (answer, answered) = oneshot::channel();
        lock(&self.0).push(Flag { output, answer });
        match answered.await {
            Ok(answer) => answer,
            // the scan program has ended, and this future will be dropped
            Err(_) => std::future::pending().await,
        }
    }

    /// The outputs that are on, oldest first.
    pub(super) fn outputs(&self) -> Vec<AuxOutput> {
        self.on_now().iter().map(|flag| flag.output.clone()).collect()
    }

    /// Answers an output of the image, and no other.
    pub(super) fn answer(&self, output: &AuxOutput, how: std::result::Result<(), Alarm>) {
        let mut flags = self.on_now();
        if let Some(place) = flags.iter().position(|flag| key(&flag.output) == key(output)) {
            // the receiver is dropped if the output is cancelled meanwhile
            let _cancelled = flags.remove(place).answer.send(how);
        }
    }

    /// The flags without those whose handler has ended.
    fn on_now(&self) -> MutexGuard<'_, Vec<Flag>> {
        let mut flags = lock(&self.0);
        flags.retain(|flag| !flag.answer.is_closed());
        flags
    }
}
