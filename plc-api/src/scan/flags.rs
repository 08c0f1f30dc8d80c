//! Outputs whose flags are on while a scan program works on them.

use std::sync::{Arc, Mutex};

use tokio::sync::oneshot;

use crate::alarm::Alarm;
use crate::handlers::AuxOutput;
use crate::lock::lock;
use crate::types::CoordinateSystemNumber;

/// Outputs that are on, and where their answers go.
#[derive(Clone, Default)]
pub(crate) struct Flags(Arc<Mutex<Vec<Flag>>>);

struct Flag {
    output: AuxOutput,
    answer: oneshot::Sender<std::result::Result<(), Alarm>>,
}

/// Takes a flag down when its output has ended, however it ended.
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
    /// The handler of every output of a scan program: on, until a scan answers.
    pub(crate) async fn on(self, output: AuxOutput) -> std::result::Result<(), Alarm> {
        let (answer, answered) = oneshot::channel();
        let _down = Down {
            key: key(&output),
            flags: self.clone(),
        };
        lock(&self.0).push(Flag { output, answer });
        match answered.await {
            Ok(answer) => answer,
            // the program has ended, and this future ends with it
            Err(_) => std::future::pending().await,
        }
    }

    /// The outputs that are on, in the order in which they were made.
    pub(super) fn outputs(&self) -> Vec<AuxOutput> {
        lock(&self.0).iter().map(|flag| flag.output.clone()).collect()
    }

    /// Gives an answer to the output that the image showed, and to no other.
    pub(super) fn answer(&self, output: &AuxOutput, how: std::result::Result<(), Alarm>) {
        let mut flags = lock(&self.0);
        if let Some(place) = flags.iter().position(|flag| key(&flag.output) == key(output)) {
            // cancelled meanwhile: nobody waits for the answer
            let _cancelled = flags.remove(place).answer.send(how);
        }
    }
}
