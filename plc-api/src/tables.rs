//! Tool table and work offsets, from the point of view of a sequence program.

use std::collections::BTreeMap;

use plc_protocol::error::Result;
use plc_protocol::types::data::{LastRun, ToolChange, ToolData, VariableArea, WorkOffsetTable};
use plc_protocol::types::request::typed::{self, Tools, WorkOffsets, WriteTools, WriteWorkOffsets};

use crate::coordinate_system::CoordinateSystem;
use crate::plc::Plc;
use crate::variables::Variables;

impl Plc {
    /// Returns a handle to the P variables, which all coordinate systems share.
    pub fn variables(&self) -> Variables {
        Variables::new(self.clone(), VariableArea::Global)
    }

    /// Returns the tool table, ascending by number.
    ///
    /// # Errors
    /// Fails if the machine cannot be reached, or the transport does not carry the tool table (MQTT).
    pub async fn tools(&self) -> Result<Vec<ToolData>> {
        Ok(self.request(Tools).await?.tools)
    }

    /// Adds or replaces a tool. G41 to G44 that are interpreted from now on use the new data (D16). The tool
    /// is on disk when this method returns.
    ///
    /// ```
    /// # #[tokio::main(flavor = "current_thread")] async fn main() -> plc_api::Result<()> {
    /// use plc_api::types::data::ToolData;
    /// let plc = plc_api::fake::FakePort::new([1]).plc();
    /// plc.set_tool(ToolData { id: 3, radius: 2.0, length: 41.25 }).await?;
    /// assert_eq!(plc.tools().await?[0].length, 41.25);
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// Fails if a number or dimension is out of range, the table is full, or the disk cannot be written. In
    /// these cases nothing has changed.
    pub async fn set_tool(&self, tool: ToolData) -> Result<()> {
        let change = ToolChange {
            tools: vec![tool],
            remove: Vec::new(),
        };
        self.change_tools(change).await
    }

    /// Changes several tools: all changes are applied, or none.
    ///
    /// # Errors
    /// Fails as [`Plc::set_tool`].
    pub async fn change_tools(&self, change: ToolChange) -> Result<()> {
        self.request(WriteTools(change)).await
    }
}

impl CoordinateSystem {
    /// Returns a handle to the Q variables of this coordinate system.
    pub fn variables(&self) -> Variables {
        Variables::new(self.plc().clone(), VariableArea::CoordinateSystem(self.number()))
    }

    /// Returns the state of the last run at the end of the previous boot of the runtime, or `None` if that
    /// boot had no run. A run that [is under way](LastRun::is_under_way) was interrupted by the end of the
    /// boot, and does not continue automatically.
    ///
    /// # Errors
    /// Fails if the coordinate system does not exist, or the transport does not carry this request (MQTT).
    pub async fn last_run(&self) -> Result<Option<LastRun>> {
        self.plc().request(typed::LastRun(self.number())).await
    }

    /// Returns the work offsets `G54` to `G59`, each with its value by axis letter, mm or degrees.
    ///
    /// # Errors
    /// Fails if the coordinate system does not exist, or the transport does not carry work offsets (MQTT).
    pub async fn work_offsets(&self) -> Result<BTreeMap<String, BTreeMap<String, f64>>> {
        let table = self.plc().request(WorkOffsets(self.number())).await?;
        Ok(table.work_offsets)
    }

    /// Sets axes of a work offset, `G54` to `G59`; other axes are unchanged. The change takes effect when a
    /// later block with `G54` to `G59` is interpreted (D16), and is on disk when this method returns.
    ///
    /// ```
    /// # #[tokio::main(flavor = "current_thread")] async fn main() -> plc_api::Result<()> {
    /// let plc = plc_api::fake::FakePort::new([1]).plc();
    /// plc.coordinate_system(1).set_work_offset("G54", [("X", 12.5)]).await?;
    /// assert_eq!(plc.coordinate_system(1).work_offsets().await?["G54"]["X"], 12.5);
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// Fails if the work offset, an axis or the coordinate system does not exist, a value is not a number, or
    /// the disk cannot be written. In these cases nothing has changed.
    pub async fn set_work_offset(
        &self,
        name: &str,
        axes: impl IntoIterator<Item = (&str, f64)>,
    ) -> Result<()> {
        let axes = axes.into_iter().map(|(axis, value)| (axis.to_owned(), value));
        let change = WorkOffsetTable {
            work_offsets: BTreeMap::from([(name.to_owned(), axes.collect())]),
        };
        let request = WriteWorkOffsets(self.number(), change);
        self.plc().request(request).await
    }
}
