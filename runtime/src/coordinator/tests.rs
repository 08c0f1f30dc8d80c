//! Tests of the contents and order of the journal lines of a run.

use std::collections::BTreeMap;
use std::io;
use std::sync::OnceLock;
use std::sync::atomic::AtomicU64;
use std::sync::mpsc::sync_channel;
use std::time::SystemTime;

use parking_lot::Mutex;
use plc_protocol::types::state::{Execution, State};
use tandem_store::journal::{JournalWriter, Line, WriteAhead};

use super::*;
use crate::coordinate_system::View;
use crate::simulation::tests::play;

/// Journal sink that reads the published line number of a coordinate system before each of its lines is published.
#[derive(Debug, Default)]
struct ViewProbe {
    view: OnceLock<Arc<View>>,
    /// Number of each line, and the number of the last line published before it.
    seen: Mutex<Vec<(u64, u64)>>,
}

impl WriteAhead for ViewProbe {
    fn write(&self, n: u64, _: &Line, _: SystemTime) -> io::Result<()> {
        if let Some(view) = self.view.get() {
            self.seen.lock().push((n, view.published_line()));
        }
        Ok(())
    }

    fn close(&self, _: &Line) {}

    fn rest(&self, _: u8, _: u64, _: Option<&BTreeMap<u16, f64>>) -> io::Result<()> {
        Ok(())
    }
}

#[test]
fn the_line_of_an_output_does_not_count_as_published_before_the_output_is() {
    let look = Arc::<ViewProbe>::default();
    let (lines, _kept) = sync_channel(1000);
    let journal = Journal::to_disk(JournalWriter {
        lines,
        lost: Arc::default(),
        last: Arc::<AtomicU64>::default(),
        ahead: Some(Arc::<ViewProbe>::clone(&look)),
    });
    let of_run = Arc::clone(&look);
    let programs = [(50, "M03\nM05\nM03\nM30\n")];
    let published = play(journal, &programs, async move |runtime, plc| {
        let view = Arc::clone(&runtime.port.mailboxes[0].view);
        of_run.view.set(Arc::clone(&view)).unwrap();
        let cs = plc.coordinate_system(1);
        cs.load(50).await.unwrap();
        cs.start().await.unwrap();
        let is_completed = |state: &State| state.execution == Execution::ProgramCompleted;
        cs.wait_for(is_completed).await.unwrap();
        view.published_line()
    });
    let seen = look.seen.lock();
    // lines of the start, three outputs and the end
    assert_eq!(seen.len(), 5, "{seen:?}");
    assert!(seen.iter().all(|(line, published)| published < line), "{seen:?}");
    assert!(published > seen[3].0, "{seen:?}");
}
