//! The stored values are merged with the configuration when the runtime starts.
//!
//! Variables and the tool in the spindle are restored as stored. Of tools and work offsets the newer value counts, one
//! by one: with each table the store keeps what was configured when it was written. A value that differs in
//! today's configuration was edited there since, and the configuration counts; every other value is restored.

use std::collections::{BTreeMap, BTreeSet};
use std::io;

use plc_api::types::CoordinateSystemNumber;
use plc_api::types::data::{ToolData, ToolTable, WorkOffsetTable};
use serde::de::DeserializeOwned;

use super::image::{Image, KeptRun, LastRuns, Page};
use crate::tables::{Kept, Tables, value_key};

/// What was kept and belongs to no table.
#[derive(Debug, Default)]
pub(crate) struct Restored {
    /// Tool in the spindle by coordinate system.
    pub tools_in_spindle: BTreeMap<CoordinateSystemNumber, u16>,
    /// The last runs, of an earlier start of the runtime.
    pub last_runs: LastRuns,
}

/// Fills the tables, which hold the configured values, with what was kept.
///
/// # Errors
/// A value is of a form that this version does not know.
pub(crate) fn restore(tables: &Tables, image: &Image) -> io::Result<Restored> {
    let mut restored = Restored::default();
    for ((area, place), page) in &image.pages {
        restore_page(tables, *area, *place, page);
    }
    if let Some(kept) = read::<Kept<ToolTable>>(image, "tools")? {
        let configured = by_id(&tables.configured_tools());
        let now = newer(&by_id(&kept.configured), &by_id(&kept.now), &configured);
        tables.restore_tools(now.into_values());
    }
    for cs in tables.coordinate_systems() {
        let key = value_key("work_offsets", cs);
        if let Some(kept) = read::<Kept<WorkOffsetTable>>(image, &key)? {
            let configured = by_axis(&tables.configured_work_offsets(cs));
            let now = newer(&by_axis(&kept.configured), &by_axis(&kept.now), &configured);
            tables.restore_work_offsets(cs, now.iter().map(|(key, value)| (&*key.0, &*key.1, *value)));
        }
        if let Some(id) = read::<u16>(image, &value_key("tool", cs))? {
            restored.tools_in_spindle.insert(cs, id);
        }
        if let Some(last_run) = read::<KeptRun>(image, &value_key("last_run", cs))? {
            restored.last_runs.insert(cs, last_run);
        }
    }
    Ok(restored)
}

fn restore_page(tables: &Tables, area: u8, place: u16, page: &Page) {
    if area == 0 {
        page.set(&tables.global(), place);
    } else if tables.coordinate_systems().any(|cs| cs == area) {
        page.set(&tables.variables(area).coordinate_system, place);
    }
}

fn read<T: DeserializeOwned>(image: &Image, key: &str) -> io::Result<Option<T>> {
    let Some(bytes) = image.values.get(key) else {
        return Ok(None);
    };
    serde_json::from_slice(bytes).map(Some).map_err(|error| {
        let text = format!("{key} is of another version ({error}); move the file away to begin anew");
        io::Error::new(io::ErrorKind::InvalidData, text)
    })
}

/// One by one the newer of what was kept and what is configured.
fn newer<K: Ord + Clone, V: PartialEq + Clone>(
    configured_then: &BTreeMap<K, V>,
    kept: &BTreeMap<K, V>,
    configured: &BTreeMap<K, V>,
) -> BTreeMap<K, V> {
    let mut now = kept.clone();
    let keys: BTreeSet<&K> = configured_then.keys().chain(configured.keys()).collect();
    for key in keys {
        let says = configured.get(key);
        if says == configured_then.get(key) {
            continue;
        }
        match says {
            Some(value) => now.insert(key.clone(), value.clone()),
            None => now.remove(key),
        };
    }
    now
}

fn by_id(table: &ToolTable) -> BTreeMap<u16, ToolData> {
    table.tools.iter().map(|tool| (tool.id, *tool)).collect()
}

fn by_axis(table: &WorkOffsetTable) -> BTreeMap<(String, String), f64> {
    let offsets = table.work_offsets.iter();
    let each = offsets.flat_map(|(name, axes)| axes.iter().map(move |axis| (name, axis)));
    each.map(|(name, (letter, value))| ((name.clone(), letter.clone()), *value))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table(values: &[(u16, i32)]) -> BTreeMap<u16, i32> {
        values.iter().copied().collect()
    }

    #[test]
    fn a_kept_value_counts_until_the_configuration_says_another() {
        let then = table(&[(1, 10), (2, 20), (3, 30), (4, 40)]);
        // since: 1 measured, 2 measured and then edited in the configuration, 3 taken out, 4 taken out of the
        // configuration, 5 added to the table, 6 added to the configuration
        let kept = table(&[(1, 11), (2, 22), (4, 40), (5, 50)]);
        let configured = table(&[(1, 10), (2, 25), (3, 30), (6, 60)]);
        let now = table(&[(1, 11), (2, 25), (5, 50), (6, 60)]);
        assert_eq!(newer(&then, &kept, &configured), now);
    }
}
