//! Checks and converts `[input.interlock]` and `[input.start_lock]`.

use std::collections::BTreeMap;

use plc_protocol::lock_input::LockRules;
use plc_protocol::types::CoordinateSystemNumber;
use plc_protocol::types::ids::is_client_id;
use plc_protocol::types::lock::OnLoss;

use super::super::text::Problems;
use super::super::{CoordinateSystemConfig, InputConfig, LockConfig};

impl InputConfig {
    pub(super) fn check(&self, systems: &[CoordinateSystemConfig], problems: &mut Problems<'_>) {
        for (name, lock) in [("interlock", &self.interlock), ("start_lock", &self.start_lock)] {
            for (source, config) in &lock.source {
                let path = format!("input.{name}.source.{source}");
                let mut checked = problems.check_table(path.as_str(), format!("[{path}] "));
                if !is_client_id(source) {
                    checked.problem("", "write a source name of 1 to 64 characters without / + #");
                }
                for number in &config.coordinate_systems {
                    if !systems.iter().any(|system| system.number == *number) {
                        let text = format!("coordinate_systems: there is no coordinate system {number}");
                        checked.problem("coordinate_systems", text);
                    }
                }
            }
        }
    }

    /// Returns the rules for the interlock and the start lock of a coordinate system.
    pub(super) fn rules(&self, cs: CoordinateSystemNumber) -> [LockRules; 2] {
        [&self.interlock, &self.start_lock].map(|lock| lock.rules(cs))
    }
}

impl LockConfig {
    fn rules(&self, cs: CoordinateSystemNumber) -> LockRules {
        let of_system = self.source.iter().filter(|(_, config)| {
            config.coordinate_systems.is_empty() || config.coordinate_systems.contains(&cs)
        });
        let sources = of_system.map(|(name, config)| {
            let on_loss = config.on_loss.or(self.on_loss).unwrap_or(OnLoss::On);
            (name.clone(), on_loss)
        });
        LockRules {
            on_loss: self.on_loss.unwrap_or_default(),
            sources: sources.collect::<BTreeMap<_, _>>(),
        }
    }
}
