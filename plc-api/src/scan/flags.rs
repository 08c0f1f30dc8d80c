//! M codes that are on for a scan program.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard};

use tokio::sync::oneshot;

use crate::alarm::Alarm;
use crate::handlers::AuxOutput;
use crate::lock::lock;
use crate::types::CoordinateSystemNumber;

/// Coordinate system and M number of a flag.
pub(super) type FlagPlace = (CoordinateSystemNumber, u16);

/// Sequence numbers of the outputs that were on in an image.
pub(super) type Shown = BTreeMap<FlagPlace, u64>;

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

    /// The outputs that are on, by coordinate system and M number: of several with the same number the oldest. Another one
    /// than in the image `before` comes into the next image only: a flag is off in between.
    pub(super) fn outputs(&self, before: &Shown) -> BTreeMap<FlagPlace, AuxOutput> {
        let mut on = BTreeMap::new();
        for Flag { output, .. } in self.on_now().iter() {
            on.entry((output.coordinate_system(), output.m()))
                .or_insert_with(|| output.clone());
        }
        on.retain(|place, output| before.get(place).is_none_or(|seq| *seq == output.seq()));
        on
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
