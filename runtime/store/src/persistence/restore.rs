//! Merges the stored values with the configuration when the runtime starts.
//!
//! Variables and the tool in the spindle are restored as stored. For each tool and work offset, the newer of
//! the stored and the configured value is used. To find it, the store also holds the value that was
//! configured when the store was written. If the current configuration differs from that value, a person has
//! edited it later, and it takes precedence. Otherwise the stored value is restored. Lost values are restored
//! as lost.

use std::collections::{BTreeMap, BTreeSet};

use plc_protocol::types::CoordinateSystemNumber;
use plc_protocol::types::data::{ToolData, ToolTable};
use plc_protocol::types::io::{IoDeclarations, IoPoint, IoValue};
use plc_protocol::types::run::Production;
use serde::de::DeserializeOwned;
use tandem_model::lost::LOST;

use super::image::{Image, KeptRun, LastRuns, PRODUCTION_KEY, Page, RUN_KEYS, RUN_LINES_KEY};
use crate::runs::{ActiveRunRecord, KeptRuns, LinesIncluded};
use crate::tables::{
    KeptOffset, KeptValues, LOST_VALUE, StoredSetting, Tables, keep, tool_key, value_key, work_offset_key,
};

/// Restored data that does not belong to the tables of variables, tools and offsets.
#[derive(Debug, Default)]
pub struct RestoredState {
    /// Tool in the spindle by coordinate system; `None` if it is lost.
    pub tools_in_spindle: BTreeMap<CoordinateSystemNumber, Option<u16>>,
    /// The last run of each coordinate system, from an earlier start of the runtime.
    pub last_runs: LastRuns,
    /// Coordinate systems whose last run is lost.
    pub lost_runs: BTreeSet<CoordinateSystemNumber>,
    /// Restored runs and production counters.
    pub runs: KeptRuns,
    /// Last values of the plant outputs that are configured to start with them; `None` if a value is lost.
    pub outputs: BTreeMap<IoPoint, Option<IoValue>>,
}

/// Prefix of the names of stored output values.
const OUTPUT_KEYS: &str = "io/out/";

/// Result of reading a stored value.
enum StoredReading<T> {
    Never,
    Lost,
    Value(T),
}

/// Replaces the configured values in the tables by the stored values that take precedence.
pub fn restore(tables: &Tables, image: &Image) -> RestoredState {
    let mut restored = RestoredState::default();
    for ((area, place), page) in &image.pages {
        restore_page(tables, *area, *place, page);
    }
    restore_tools(tables, image);
    restored.runs = restore_runs(tables, image);
    for cs in tables.coordinate_systems() {
        restore_work_offsets(tables, cs, image);
        match read::<u16>(image, &value_key("tool", cs)) {
            StoredReading::Never => {}
            StoredReading::Lost => {
                restored.tools_in_spindle.insert(cs, None);
            }
            StoredReading::Value(id) => {
                restored.tools_in_spindle.insert(cs, Some(id));
            }
        }
        match read::<KeptRun>(image, &value_key("last_run", cs)) {
            StoredReading::Never => {}
            StoredReading::Lost => {
                restored.lost_runs.insert(cs);
            }
            StoredReading::Value(last_run) => {
                restored.last_runs.insert(cs, last_run);
            }
        }
    }
    restored
}

/// Returns the last values of the plant outputs that are configured to start with them.
pub fn restore_outputs(io: &IoDeclarations, image: &Image) -> BTreeMap<IoPoint, Option<IoValue>> {
    let points = io.points().map(|(point, _)| point);
    let kept = points.filter(|point| io.keeps_last(point)).filter_map(|point| {
        let last = match read::<Option<IoValue>>(image, &point.to_string()) {
            StoredReading::Never | StoredReading::Value(None) => return None,
            StoredReading::Lost => None,
            StoredReading::Value(last) => last,
        };
        Some((point, last))
    });
    kept.collect()
}

/// Deletes stored values of outputs that are not configured to start with them. Otherwise a later
/// configuration could restore an outdated value.
pub fn forget_outputs(io: &IoDeclarations, image: &Image) -> KeptValues {
    let names = image.values.keys().filter(|name| name.starts_with(OUTPUT_KEYS));
    let kept: BTreeSet<_> = io.points().map(|(point, _)| point).collect();
    let kept: BTreeSet<_> = (kept.iter().filter(|point| io.keeps_last(point)))
        .map(ToString::to_string)
        .collect();
    let mut forgotten = KeptValues::new();
    for name in names.filter(|name| !kept.contains(*name)) {
        keep(&mut forgotten, name.clone(), &None::<IoValue>);
    }
    forgotten
}

/// Restores the runs. A damaged run is omitted from the history; the other runs are restored.
fn restore_runs(tables: &Tables, image: &Image) -> KeptRuns {
    let value = |key: &str| match read(image, key) {
        StoredReading::Value(kept) => Some(kept),
        StoredReading::Never | StoredReading::Lost => None,
    };
    let open = tables.coordinate_systems();
    let open =
        open.filter_map(
            |cs| match read::<Option<ActiveRunRecord>>(image, &value_key("open_run", cs)) {
                StoredReading::Value(run) => run,
                StoredReading::Never | StoredReading::Lost => None,
            },
        );
    let production = match read::<Vec<Production>>(image, PRODUCTION_KEY) {
        StoredReading::Value(production) => production,
        StoredReading::Never | StoredReading::Lost => Vec::new(),
    };
    let ended = image.values.keys().filter(|name| name.starts_with(RUN_KEYS));
    let lines = match read::<LinesIncluded>(image, RUN_LINES_KEY) {
        StoredReading::Value(lines) => lines,
        StoredReading::Never if !image.has(PRODUCTION_KEY) => LinesIncluded::new(),
        // It is unknown which journal lines the counters include. No line is added, because it could count
        // twice.
        StoredReading::Never | StoredReading::Lost => {
            tables.coordinate_systems().map(|cs| (cs, u64::MAX)).collect()
        }
    };
    KeptRuns {
        lines,
        ended: ended.filter_map(|name| value(name)).collect(),
        open: open.collect(),
        production,
    }
}

fn restore_page(tables: &Tables, area: u8, place: u16, page: &Page) {
    if area == 0 {
        page.set(&tables.global(), place);
    } else if tables.coordinate_systems().any(|cs| cs == area) {
        page.set(&tables.variables(area).coordinate_system, place);
    }
}

fn restore_tools(tables: &Tables, image: &Image) {
    let configured = by_id(&tables.configured_tools());
    let mut tools: BTreeMap<u16, ToolData> = configured.clone();
    let ids = image
        .values
        .keys()
        .filter_map(|name| name.strip_prefix("tool_data/")?.parse().ok());
    for id in ids {
        let now = match read::<StoredSetting<Option<ToolData>>>(image, &tool_key(id)) {
            StoredReading::Never => continue,
            StoredReading::Lost => Some(lost_tool(id)),
            StoredReading::Value(kept) => newer(kept.configured, kept.now, configured.get(&id).copied()),
        };
        match now {
            Some(tool) => tools.insert(id, tool),
            None => tools.remove(&id),
        };
    }
    tables.restore_tools(tools.into_values());
}

fn lost_tool(id: u16) -> ToolData {
    ToolData {
        id,
        radius: LOST,
        length: LOST,
    }
}

fn restore_work_offsets(tables: &Tables, cs: CoordinateSystemNumber, image: &Image) {
    for (name, axes) in &tables.configured_work_offsets(cs).work_offsets {
        let kept = match read::<StoredSetting<KeptOffset>>(image, &work_offset_key(cs, name)) {
            StoredReading::Never => continue,
            StoredReading::Lost => None,
            StoredReading::Value(kept) => Some(kept),
        };
        let values = axes.iter().map(|(letter, configured)| {
            let value = match &kept {
                None => None,
                Some(kept) => {
                    let then = kept.configured.get(letter).copied();
                    newer(then, kept.now.get(letter).copied(), Some(Some(*configured))).flatten()
                }
            };
            (name.as_str(), letter.as_str(), value.unwrap_or(LOST))
        });
        tables.restore_work_offsets(cs, values);
    }
}

fn read<T: DeserializeOwned>(image: &Image, key: &str) -> StoredReading<T> {
    match image.values.get(key) {
        None => StoredReading::Never,
        Some(bytes) if bytes == LOST_VALUE => StoredReading::Lost,
        Some(bytes) => serde_json::from_slice(bytes).map_or_else(
            |error| {
                tracing::warn!("{key} was written by another version ({error}) and is treated as lost");
                StoredReading::Lost
            },
            StoredReading::Value,
        ),
    }
}

/// Returns the newer of the stored and the configured value; `configured_then` was configured when the store
/// was written.
fn newer<V: PartialEq + Copy>(
    configured_then: Option<V>,
    kept: Option<V>,
    configured: Option<V>,
) -> Option<V> {
    if configured == configured_then {
        kept
    } else {
        configured
    }
}

fn by_id(table: &ToolTable) -> BTreeMap<u16, ToolData> {
    table.tools.iter().map(|tool| (tool.id, *tool)).collect()
}

#[cfg(test)]
mod tests {
    use plc_protocol::types::data::{ToolChange, VariableArea};
    use tandem_model::lost::is_lost;

    use super::*;
    use crate::tables::KeptValues;
    use crate::tables::tests::tables;

    #[test]
    fn a_kept_value_counts_until_the_configuration_says_another() {
        // In order: measured; measured, then edited in the configuration; removed from the table; removed
        // from the configuration; added to the table; added to the configuration.
        for (then, kept, configured, now) in [
            (Some(10), Some(11), Some(10), Some(11)),
            (Some(20), Some(22), Some(25), Some(25)),
            (Some(30), None, Some(30), None),
            (Some(40), Some(40), None, None),
            (None, Some(50), None, Some(50)),
            (None, None, Some(60), Some(60)),
        ] {
            assert_eq!(newer(then, kept, configured), now);
        }
    }

    /// Returns an image of this machine with two tools and all offsets.
    fn image() -> Image {
        let tables = tables();
        let tool = |id| ToolData {
            id,
            radius: 1.0,
            length: 2.0,
        };
        let change = ToolChange {
            tools: vec![tool(18), tool(19)],
            remove: Vec::new(),
        };
        let values: KeptValues = tables.kept(&tables.with_tools(&change).unwrap());
        Image {
            values,
            ..Image::default()
        }
    }

    #[test]
    fn what_is_lost_is_restored_as_lost_and_all_else_as_it_was() {
        let (tables, mut image) = (tables(), image());
        for name in ["tool_data/19", "work_offset/1/G54", "tool/1", "last_run/2", "p/3"] {
            image.lose(name);
        }
        let restored = restore(&tables, &image);
        let values = tables.read();
        assert!(is_lost(values.tool(19).unwrap().length) && !is_lost(values.tool(18).unwrap().length));
        let offsets = values.work_offsets(1).0;
        assert!(is_lost(offsets[0].0[0]) && !is_lost(offsets[1].0[0]));
        drop(values);
        assert!(
            !tables.tools().tools.iter().any(|tool| tool.id == 19),
            "it is not shown"
        );
        assert_eq!(restored.tools_in_spindle, [(1, None)].into());
        assert_eq!(restored.lost_runs, [2].into());
        assert!(tables.read_variables(VariableArea::Global, 383, 1).is_ok());
        assert!(tables.read_variables(VariableArea::Global, 383, 2).is_err());
        let told = tables.lost().join("; ");
        assert_eq!(told, "P384 to P511; tool 19; G54 X, Y, Z of coordinate system 1");
        // the value is stored as lost, and known after it is written
        let kept = tables.kept(&tables.read().clone());
        assert_eq!(kept["tool_data/19"], LOST_VALUE);
        let change = ToolChange {
            tools: vec![ToolData {
                id: 19,
                radius: 0.0,
                length: 1.0,
            }],
            remove: Vec::new(),
        };
        tables
            .change(|tables| tables.with_tools(&change), |_, _| Ok(()))
            .unwrap();
        tables
            .write_variables(VariableArea::Global, 384, &[1.0; 127])
            .unwrap();
        assert_eq!(
            tables.lost().join("; "),
            "P511; G54 X, Y, Z of coordinate system 1"
        );
    }
}
