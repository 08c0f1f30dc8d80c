//! Publication of variables, tools and work offsets after each change.

use plc_protocol::types::data::{
    PublishedVariables, VariableArea, VariableValues, WorkOffsetTable, WorkOffsetValues,
};
use plc_protocol::types::message::Payload;
use plc_protocol::types::topic::{CsTopic, Topic};

use crate::shared::SharedState;

impl SharedState {
    /// Publishes the configured variables of each area in which one of them has changed.
    pub fn publish_variables(&self) {
        if !self.machine.published.is_empty() {
            self.publish_areas();
        }
    }

    /// In simulated time, publishes variables after each turn and write. Reason: simulated time has no publishing
    /// interval.
    pub fn publish_variables_simulated(&self) {
        if self.clock.is_simulated() {
            self.publish_variables();
        }
    }

    /// Publishes the configured variables of all areas, including areas without any. So a client that subscribes to
    /// another variable learns that the variable is not published.
    pub fn publish_areas(&self) {
        let of_systems = self.tables.coordinate_systems();
        let areas = of_systems.map(VariableArea::CoordinateSystem);
        let mut last = self.published_variables.lock();
        for area in std::iter::once(VariableArea::Global).chain(areas) {
            let ranges = self.machine.published.get(&area).map_or(&[][..], Vec::as_slice);
            let values = ranges.iter().zip(self.tables.ranges(area, ranges));
            let variables = values.map(|((from, _), values)| VariableValues::new(area.kind(), *from, values));
            let now = PublishedVariables {
                variables: variables.collect(),
            };
            if last.get(&area) == Some(&now) {
                continue;
            }
            last.insert(area, now.clone());
            let topic = match area.coordinate_system() {
                None => Topic::Variables,
                Some(cs) => Topic::cs(cs, CsTopic::Variables),
            };
            self.publish(topic, Payload::Variables(now));
        }
    }

    /// Publishes the tool table and the work offsets if they have changed.
    pub fn publish_tables(&self) {
        let _one_after_the_other = self.published_variables.lock();
        self.publish(Topic::Tools, Payload::Tools(self.tables.tools()));
        for cs in self.tables.coordinate_systems() {
            if let Ok(WorkOffsetTable { work_offsets }) = self.tables.work_offsets(cs) {
                let offsets = Payload::WorkOffsets(WorkOffsetValues { work_offsets });
                self.publish(Topic::cs(cs, CsTopic::WorkOffsets), offsets);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::{Arc, Mutex};
    use std::time::Duration;

    use plc_api::{Alarm, AuxOutput, Plc, SequenceProgram};
    use plc_protocol::types::data::{ToolData, VariableArea};
    use plc_protocol::types::topic::Topic;

    use tandem_testing::Bench;

    type ObservedValues = Arc<Mutex<Vec<Vec<f64>>>>;

    /// Returns a sequence program that stores each published value of P200 and P201, and works for a second on M20.
    fn follows(heard: &ObservedValues) -> SequenceProgram {
        let heard = Arc::clone(heard);
        let work = async |_output: AuxOutput, plc: Plc| -> Result<(), Alarm> {
            plc.sleep(Duration::from_secs(1)).await;
            plc.variables().set(201, 7.0).await?;
            Ok(())
        };
        SequenceProgram::new().on(20, work).task(move |plc| {
            let heard = Arc::clone(&heard);
            async move {
                let mut changes = plc.variables().changes(200, 2).await?;
                while let Some(values) = changes.next().await {
                    heard.lock().unwrap().push(values);
                }
                Ok(())
            }
        })
    }

    #[test]
    fn change_by_program_or_handler_published_once_same_value_not_at_all() {
        let heard = ObservedValues::default();
        let bench = Bench::new().publish_variables(VariableArea::Global, 200, 2);
        let text = "P200=1\nP202=5\nM20\nP200=1\nG01 X10 F600\nM20\nP200=P201+1\nM30";
        bench
            .serve(follows(&heard))
            .run(text)
            .unwrap()
            .completed()
            .unwrap();
        let published = [[0.0, 0.0], [1.0, 0.0], [1.0, 7.0], [8.0, 7.0]].map(Vec::from);
        assert_eq!(*heard.lock().unwrap(), published);
    }

    #[test]
    fn a_variable_that_is_no_number_is_published_once() {
        let bench = Bench::new().publish_variables(VariableArea::Global, 200, 2);
        let played = bench.play(async move |_, runtime| {
            let plc = Plc::in_process(runtime.port());
            let revision = async || plc.port().read(&Topic::Variables).await.unwrap().rev;
            let at_start = revision().await;
            plc.variables().set(200, f64::NAN).await.unwrap();
            let published = revision().await;
            assert!(published > at_start);
            plc.variables().set(500, 1.0).await.unwrap();
            plc.sleep(Duration::from_secs(1)).await;
            assert_eq!(revision().await, published);
        });
        played.unwrap();
    }

    #[test]
    fn subscription_to_undeclared_variables_fails_with_the_config_line() {
        let heard = ObservedValues::default();
        let failed = Bench::new().serve(follows(&heard)).run("M20\nM30").unwrap_err();
        let text = failed.to_string();
        assert!(
            text.contains("[[variables.published]] from = \"P200\", count = 2"),
            "{text}"
        );
    }

    #[test]
    fn q_variables_tools_and_offsets_are_published_of_their_coordinate_system() {
        let bench = Bench::new().publish_variables(VariableArea::CoordinateSystem(2), 3, 1);
        let played = bench.play(async move |_, runtime| {
            let plc = Plc::in_process(runtime.port());
            let (mill, loader) = (plc.coordinate_system(1), plc.coordinate_system(2));
            assert!(mill.variables().changes(3, 1).await.is_err());
            let mut changes = loader.variables().changes(3, 1).await.unwrap();
            let (mut tools, mut offsets) = (plc.tool_changes(), loader.work_offset_changes());
            assert_eq!(changes.next().await, Some(vec![0.0]));
            let (table, offsets_of_loader) = (tools.next().await.unwrap(), offsets.next().await.unwrap());
            assert_eq!(table, plc.tools().await.unwrap());
            assert_eq!(offsets_of_loader, loader.work_offsets().await.unwrap());
            mill.variables().set(3, 1.0).await.unwrap();
            loader.variables().set(3, 2.0).await.unwrap();
            assert_eq!(changes.next().await, Some(vec![2.0]));
            let (id, radius, length) = (99, 1.0, 7.5);
            plc.set_tool(ToolData { id, radius, length }).await.unwrap();
            let table = tools.next().await.unwrap();
            assert!(
                table
                    .iter()
                    .any(|tool| tool.id == 99 && tool.length.to_bits() == 7.5_f64.to_bits())
            );
            let axis = offsets_of_loader["G54"].keys().next().unwrap().clone();
            mill.set_work_offset("G54", [("X", 4.0)]).await.unwrap();
            loader
                .set_work_offset("G54", [(axis.as_str(), 3.0)])
                .await
                .unwrap();
            assert_eq!(
                offsets.next().await.unwrap()["G54"][&axis].to_bits(),
                3.0_f64.to_bits()
            );
        });
        played.unwrap();
    }
}
