//! M codes that are on for a scan program.

use std::sync::{Arc, Mutex};

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

/// Removes a flag when its output has ended in any way.
struct Down {
    flags: Flags,
    key: (CoordinateSystemNumber, u64),
}

impl Drop for Down {
    fn drop(&mut self) {
        lock(&self.flags.0).retain(|flag| key(&flag.output) != self.key);
    }
}

fn key(output: &AuxOutput) -> (CoordinateSystemNumber, u64) {
    (output.coordinate_system(), output.seq())
}

impl Flags {
    /// The handler of every output of a scan program: it is on until a scan answers.
    pub(crate) async fn on(self, output: AuxOutput) -> std::result::Result<(), Alarm> {
        let (answer, answered) = oneshot::channel();
        let _down = Down {
            key: key(&output),
            flags: self.clone(),
        };
        lock(&self.0).push(Flag { output, answer });
        match answered.await {
            Ok(answer) => answer,
            // the scan program has ended, and this future will be dropped
            Err(_) => std::future::pending().await,
        }
    }

    /// The outputs that are on, oldest first.
    pub(super) fn outputs(&self) -> Vec<AuxOutput> {
        lock(&self.0).iter().map(|flag| flag.output.clone()).collect()
    }

    /// Answers an output of the image, and no other.
    pub(super) fn answer(&self, output: &AuxOutput, how: std::result::Result<(), Alarm>) {
        let mut flags = lock(&self.0);
        if let Some(place) = flags.iter().position(|flag| key(&flag.output) == key(output)) {
            // the receiver is gone if the output was cancelled meanwhile
            let _cancelled = flags.remove(place).answer.send(how);
        }
    }
}
